"""``portdock calibrate tcp``: the plug's frame at the flange, from docks by force or from touches of one point."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from controller.calibrations.budget import OWN_SIGMA, TOOL_MM, TURN_DEG, assumed_hand_eye_covariance
from controller.calibrations.in_force import device_names, examine_calibrations, mock_names
from controller.calibrations.record import Calibration, DeviceNames, Kind, basis, versions_here
from controller.calibrations.store import CalibrationStore
from controller.calibrations.touches import read_touches
from controller.calibrations.words import pose_words
from controller.cli.scan import (
    ConfigOption,
    ErrorsOption,
    FastOption,
    MockCellOption,
    MockOption,
    SeedOption,
    cell_for,
    show_quarters,
)
from controller.config import SiteConfig, load_config
from controller.mock_calibrations import cell_name
from controller.port_files import load_port
from perception.calibration.tool import tool_point
from perception.errors import InputError
from perception.geometry import Array, Pose

if TYPE_CHECKING:
    from perception.calibration.mated_tool import MatedTool

REMADE: tuple[Kind, ...] = ("tool", "port")
"""What a new tool replaces or makes void need not be in order for it."""


def tcp(
    config: ConfigOption = None,
    docks: Annotated[int, typer.Option(min=1, max=10, help="So many docks, each looked at from all viewpoints.")] = 2,
    play_mm: Annotated[float, typer.Option(min=0, max=2, help="Of the mated plug across the port's axis, +-.")] = 0.2,
    play_deg: Annotated[float, typer.Option(min=0, max=3, help="And its tilt and roll, +-.")] = 0.3,
    touches: Annotated[
        Path | None, typer.Option(help="Instead of docking: a file of poses in which one fixed point was touched.")
    ] = None,
    mock: MockOption = False,
    seed: SeedOption = 0,
    scenario: ErrorsOption = "uncalibrated",
    mock_cell: MockCellOption = None,
    fast: FastOption = False,
) -> None:
    """Dock, back off, look from several sides, and store T_flange_tcp. The arm will move, but not with --touches.

    Mating gives place and rotation but not the tool's length; touching gives the place, length included.
    """
    site = load_config(config)
    devices = mock_names(cell_name(site, scenario, seed, mock_cell)) if mock else device_names(site)
    if touches is not None:
        if mock:
            raise InputError("touches need no mock devices", remedy="Leave out --mock, or --touches.")
        _store(_by_touching(site, touches, devices), site)
        return
    from controller.calibrations.tcp_session import calibrate_tcp  # devices take seconds to import
    from perception.calibration.mated_tool import Known

    port = load_port(site.port.model)
    with ExitStack() as closing:
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="portdock-tcp-")))
        hand_eye = _hand_eye(site, devices)
        cell, pace = cell_for(closing, site, mock, seed, scenario, fast, number=mock_cell, remade=REMADE)
        known = Known(
            T_port_tcp=port.T_port_tcp,
            T_flange_scanner=cell.scanner.T_flange_scanner.pose,
            scanner_covariance=_scanner_covariance(hand_eye, site),
            T_flange_tcp=cell.arm.T_flange_tcp.pose,
            length_sigma_m=TOOL_MM / 1e3,
            play_m=play_mm / 1e3,
            play_rad=float(np.deg2rad(play_deg)),
        )
        mode = 1 if mock else 3
        found = calibrate_tcp(cell, known, docks, folder, show_quarters, pace=pace, heartbeat_mode=mode)
    own = Calibration("tool", found.T_flange_tcp, found.own_covariance, devices, datetime.now(UTC))
    _store(_mated(found, own, docks, basis(hand_eye, None)), site)
    _say(found, own, hand_eye is not None)


def _mated(found: MatedTool, own: Calibration, docks: int, made_with: str) -> Calibration:
    """What is stored of a tool found by mating; ``own`` is the same without the hand-eye calibration's part."""
    residuals = (
        ("docks", float(docks)),
        ("spread_mm", 1e3 * found.spread_m),
        ("spread_deg", float(np.rad2deg(found.spread_rad))),
        ("pushed_deeper_mm", 1e3 * found.deeper_m),
        (OWN_SIGMA, own.sigma_mm),
        ("own_sigma_deg", own.sigma_deg),
    )
    return replace(own, covariance=found.covariance, residuals=residuals, made_with=made_with, versions=versions_here())


def _say(found: MatedTool, own: Calibration, hand_eye: bool) -> None:
    typer.echo(f"without the hand-eye's part, which cancels: {own.sigma_mm:.3f} mm, {own.sigma_deg:.4f} deg")
    typer.echo(f"all looks agree within {1e3 * found.spread_m:.3f} mm and {np.rad2deg(found.spread_rad):.3f} deg")
    typer.echo(f"pushed home {1e3 * found.deeper_m:.2f} mm deeper than the port's drawing: the tool keeps its length")
    if not hand_eye:
        typer.echo("no hand-eye calibration in force: its uncertainty is assumed; better `calibrate hand-eye` first")


def _hand_eye(site: SiteConfig, devices: DeviceNames) -> Calibration | None:
    """The hand-eye calibration that the looks will be taken with."""
    found = examine_calibrations(site, devices)
    return next((one.calibration for one in found if one.slot == "hand-eye" and one.problem is None), None)


def _scanner_covariance(hand_eye: Calibration | None, site: SiteConfig) -> Array:
    return assumed_hand_eye_covariance(site.scan.standoff_mm) if hand_eye is None else hand_eye.covariance


def _by_touching(site: SiteConfig, file: Path, devices: DeviceNames) -> Calibration:
    """The place by touching; the rotation is the site file's."""
    made = read_touches(file)
    found = tool_point(made.T_base_flange)
    turn = site.arm.T_flange_tcp.pose.rotation
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = found.covariance
    covariance[3:, 3:] = np.deg2rad(TURN_DEG) ** 2 * np.eye(3)
    worst_mm = 1e3 * float(found.residuals_m.max())
    typer.echo(f"{len(made.T_base_flange)} touches meet in one point within {worst_mm:.3f} mm")
    typer.echo("touching says nothing of the rotation: it is the site file's")
    residuals = (("touches", float(len(made.T_base_flange))), ("off_max_mm", worst_mm))
    pose = Pose(turn, found.in_flange - turn @ made.point)
    return Calibration("tool", pose, covariance, devices, datetime.now(UTC), residuals, versions=versions_here())


def _store(one: Calibration, site: SiteConfig) -> None:
    """Write the file and say what came out."""
    path = CalibrationStore(Path(site.calibration.folder)).add(one)
    off = site.arm.T_flange_tcp.pose
    typer.echo(f"T_flange_tcp: {pose_words(one.pose)}")
    turned_deg = np.rad2deg(off.angle_to(one.pose))
    typer.echo(f"  {1e3 * off.distance_to(one.pose):.2f} mm and {turned_deg:.2f} deg off what the site file says")
    typer.echo(f"1 sigma: {one.sigma_mm:.3f} mm, {one.sigma_deg:.4f} deg")
    typer.echo(f"in force: {path}; ports that were taught before are to be taught again")
