"""``portdock calibrate hand-eye``: where the scanner sits on the flange, measured with a target that stands still."""

from __future__ import annotations

import enum
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import typer

from controller.calibrations.budget import LOCATED_SIGMA
from controller.calibrations.in_force import device_names, mock_names
from controller.calibrations.record import Calibration, DeviceNames, versions_here
from controller.calibrations.store import CalibrationStore
from controller.calibrations.words import arm_words, compared, pose_words
from controller.cli.dry_run import FAST_FACTOR, for_mocks
from controller.cli.scan import ConfigOption, ErrorsOption, FastOption, MockOption, SeedOption, show_quarters
from controller.config import SiteConfig, load_config
from controller.mock_calibrations import cell_name
from controller.port_files import load_port
from controller.scenarios import draw_scenario
from perception.calibration.errors import CalibrationError

if TYPE_CHECKING:
    from controller.calibrations.hand_eye_session import Calibrated, Planned, Wanted


class TargetName(enum.StrEnum):
    """What is swept."""

    SPHERE = "sphere"
    PLANES = "planes"
    PORT = "port"


def hand_eye(
    target: Annotated[TargetName, typer.Option(help="What stands where the car's port would be.")] = TargetName.SPHERE,
    diameter_mm: Annotated[float, typer.Option(min=10, max=200, help="Of the sphere, measured.")] = 50.8,
    plan: Annotated[bool, typer.Option("--plan", help="Only list the poses; nothing moves.")] = False,
    speed_scale: Annotated[
        bool, typer.Option("--speed-scale", help="Estimate a scale of the sweep's way too.")
    ] = False,
    sigma_mm: Annotated[float, typer.Option(min=0.01, max=5, help="Sweep until the position is this certain.")] = 0.2,
    sigma_deg: Annotated[float, typer.Option(min=0.005, max=2, help="And the rotation so.")] = 0.06,
    max_sweeps: Annotated[int, typer.Option(min=8, max=36)] = 20,
    ideal_arm: Annotated[
        bool, typer.Option("--ideal-arm", help="Take the arm at its word; else its own errors are estimated too.")
    ] = False,
    config: ConfigOption = None,
    mock: MockOption = False,
    seed: SeedOption = 0,
    scenario: ErrorsOption = "uncalibrated",
    mock_diameter_mm: Annotated[float | None, typer.Option(help="With --mock: what the sphere truly measures.")] = None,
    fast: FastOption = False,
) -> None:
    """Sweep a sphere (a box's corner, a port) from several poses and store T_flange_scanner. The arm will move."""
    from controller.calibrations.hand_eye_session import Wanted, calibrate_hand_eye, plan_hand_eye
    from perception.calibration.from_sweeps import TargetKind
    from perception.calibration.hand_eye import Asked

    site = load_config(config)
    kind = TargetKind(target.value, diameter_mm / 2000.0, site.port.model)
    sigma_rad = float(np.deg2rad(sigma_deg))
    asked = Asked(time_offset=site.scanner.sync != "stop_and_go", speed_scale=speed_scale)
    wanted = Wanted(kind, asked, sigma_mm / 1e3, sigma_rad, max_sweeps, ideal_arm)
    with ExitStack() as closing:
        truth_mm = diameter_mm if mock_diameter_mm is None else mock_diameter_mm
        cell = (site, 1.0) if not mock else _mock(closing, site, seed, scenario, target, truth_mm, fast)
        mode = 1 if mock else 3
        if plan:
            _show_plan(plan_hand_eye(cell[0], wanted, pace=cell[1], heartbeat_mode=mode))
            return
        found = calibrate_hand_eye(cell[0], wanted, show_quarters, typer.echo, pace=cell[1], heartbeat_mode=mode)
    _refuse_uncertain(found, wanted)
    _store(found, cell[0], mock_names(cell_name(site, scenario, seed, None)) if mock else device_names(site))


def _mock(
    closing: ExitStack, site: SiteConfig, seed: int, scenario: str, target: TargetName, diameter_mm: float, fast: bool
) -> tuple[SiteConfig, float]:
    """A mock cell with the target where its car would stand, and the pace."""
    import tempfile

    from controller.mock_cell import MockCell  # the world takes a second to import

    site, pace = for_mocks(site, fast), FAST_FACTOR if fast else 1.0
    world = draw_scenario(scenario, site, load_port(site.port.model), seed)
    world = replace(world, target=_IN_PLACE_OF_THE_CAR[target], sphere_radius_m=diameter_mm / 2000.0)
    wires = closing.enter_context(tempfile.TemporaryDirectory(prefix="portdock-"))
    return closing.enter_context(MockCell(Path(wires), site, world, seed, pace)).config, pace


_IN_PLACE_OF_THE_CAR: dict[TargetName, Literal["sphere", "corner"] | None] = {
    TargetName.SPHERE: "sphere",
    TargetName.PLANES: "corner",
    TargetName.PORT: None,
}


def _show_plan(planned: list[Planned]) -> None:
    for number, one in enumerate(planned, 1):
        view = one.view
        foretold = "" if number == 1 else f"  after it {1e3 * one.sigma_m:.3f} mm, {np.rad2deg(one.sigma_rad):.4f} deg"
        typer.echo(
            f"{number:2}  pitch {view.pitch_deg:+6.1f}  yaw {view.yaw_deg:+6.1f}  roll {view.roll_deg:+6.1f} deg"
            f"  nearer {view.nearer_mm:+4.0f}  aside {view.aside_mm:+4.0f} mm{foretold}"
        )


def _refuse_uncertain(found: Calibrated, wanted: Wanted) -> None:
    """Twice as uncertain as was wanted is no calibration; between once and twice it is stored, and says so."""
    from perception.calibration.foresight import spread

    sigma_m, sigma_rad = spread(found.solved.hand_eye.covariance[:6, :6])
    if sigma_m > 2.0 * wanted.sigma_m or sigma_rad > 2.0 * wanted.sigma_rad:
        raise CalibrationError(
            f"after {found.sweeps} sweeps the mounting is uncertain by {1e3 * sigma_m:.2f} mm and"
            f" {np.rad2deg(sigma_rad):.3f} deg",
            remedy="Fix target and scanner tightly, sweep more slowly, or allow more with --sigma-mm and --sigma-deg.",
        )


def _store(found: Calibrated, site: SiteConfig, devices: DeviceNames) -> None:
    """Write the file, the picture beside it, and say what came out."""
    from controller.calibrations.pictures import residual_picture

    solved = found.hand_eye
    offset_ms = 1e3 * solved.mounting.time_offset_s * found.time_scale
    off = site.scanner.T_flange_scanner.pose
    new = solved.mounting.T_flange_scanner
    one = Calibration(
        kind="hand-eye",
        pose=new,
        covariance=solved.covariance[:6, :6],
        devices=devices,
        measured=datetime.now(UTC),
        residuals=(
            ("sweeps", found.sweeps),
            ("points", len(solved.residuals_m)),
            ("rms_mm", 1e3 * solved.rms_m),
            ("left_out_median_mm", 1e3 * float(np.median(found.left_out_m))),
            ("left_out_max_mm", 1e3 * float(found.left_out_m.max())),
            ("time_offset_ms", offset_ms),
            ("time_offset_sigma_ms", 1e3 * float(np.sqrt(solved.covariance[6, 6])) * found.time_scale),
            ("speed_scale", solved.mounting.speed_scale),
            *_arm_residuals(found),
        ),
        latency_ms=site.scanner.latency_ms - offset_ms,
        arm_errors=None if found.arm is None else found.arm.errors,
        versions=versions_here(),
    )
    store = CalibrationStore(Path(site.calibration.folder))
    before = _readable(store)
    path = store.add(one)
    residual_picture(found.solved, found.left_out_m, path.with_suffix(".png"))
    typer.echo(f"T_flange_scanner: {pose_words(new)}")
    turned_deg = np.rad2deg(off.angle_to(new))
    typer.echo(f"  {1e3 * off.distance_to(new):.1f} mm and {turned_deg:.2f} deg off what the site file says")
    typer.echo(f"1 sigma: {one.sigma_mm:.3f} mm, {one.sigma_deg:.4f} deg; latency_ms {one.latency_ms:.2f}")
    residuals = dict(one.residuals)
    if one.arm_errors is not None:
        typer.echo(f"the arm: {arm_words(one.arm_errors)}")
        typer.echo(f"  a port seen square on here is located to {residuals[LOCATED_SIGMA]:.2f} mm (1 sigma)")
    typer.echo(
        f"{found.sweeps} sweeps, residuals {residuals['rms_mm']:.3f} mm rms;"
        f" a sweep left out is foretold within {residuals['left_out_max_mm']:.2f} mm"
    )
    if before is not None and before.devices == devices:
        for line in compared(before, one):
            typer.echo(f"against the one before: {line}")
    typer.echo(f"in force: {path}")


def _arm_residuals(found: Calibrated) -> Iterator[tuple[str, float]]:
    if found.arm is not None and found.located_sigma_m is not None:
        yield "sweep_shift_mm", 1e3 * found.arm.shift_m
        yield LOCATED_SIGMA, 1e3 * found.located_sigma_m


def _readable(store: CalibrationStore) -> Calibration | None:
    try:
        return store.in_force("hand-eye")
    except CalibrationError:
        return None
