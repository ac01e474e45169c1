"""Which calibrations may be used, and the configuration with them: pure but for reading the folder."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from controller.arm_config import ArmErrorsConfig
from controller.calibrations.record import Calibration, CalibrationFileError, DeviceNames, Kind, basis, fits_basis
from controller.calibrations.store import CalibrationStore
from controller.config import SiteConfig
from controller.config_section import PoseConfig
from perception.calibration.errors import CalibrationError

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Examined:
    """A slot's calibration, and why it cannot be used if so."""

    slot: str
    calibration: Calibration | None
    problem: CalibrationError | None = None


def device_names(config: SiteConfig) -> DeviceNames:
    """The devices that a site's calibrations belong to. The driver refuses an arm with another serial number."""
    arm, scanner = config.arm, config.scanner
    return DeviceNames(arm.serial or f"at {arm.host}", scanner.serial or f"at {scanner.device}")


def mock_names(cell: str) -> DeviceNames:
    """The devices of the mock cell that bears this name (``mock_calibrations.cell_name``)."""
    return DeviceNames(cell, cell)


def basis_of(config: SiteConfig) -> str:
    """Names a cell's geometry as its effective configuration has it: device, mark of mounting and tool, mark of the
    port's taught pose. Docks at one port that are judged together share all three, docks at several the first two.
    """
    port = config.port.T_port_tcp
    arm = config.arm
    geometry = [config.scanner.T_flange_scanner.model_dump(), arm.T_flange_tcp.model_dump()]
    cell = _mark(geometry if arm.errors.errors is None else [*geometry, arm.errors.model_dump()])
    taught = _mark([None if port is None else port.model_dump()])
    return f"{config.scanner.serial or config.arm.serial or config.arm.host} {cell} {taught}"


def _mark(values: object) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()[:12]


def slots_of(config: SiteConfig) -> tuple[str, ...]:
    """What this site can use."""
    return "hand-eye", "tool", f"port-{Path(config.port.model).stem}"


def examine_calibrations(
    config: SiteConfig, devices: DeviceNames | None = None, now: datetime | None = None
) -> tuple[Examined, ...]:
    """The calibrations in force for this site, each with what speaks against it. Slots without one are left out."""
    store, now = CalibrationStore(Path(config.calibration.folder)), now or datetime.now(UTC)
    found = []
    for slot in slots_of(config):
        try:
            calibration = store.in_force(slot)
        except CalibrationFileError as error:
            found.append(Examined(slot, None, error))
            continue
        if calibration is not None:
            max_age_days = config.calibration.max_age_days
            problem = unfit(calibration, devices or device_names(config), now, max_age_days)
            found.append(Examined(slot, calibration, problem))
    judged: list[Examined] = []
    for one in found:  # in the order of ``slots_of``: each rests on those before it
        judged.append(_of_its_basis(one, judged))
    return tuple(judged)


def usable(found: Iterable[Examined]) -> dict[str, Calibration]:
    """Those that can be used, by slot."""
    return {one.slot: one.calibration for one in found if one.problem is None and one.calibration is not None}


def basis_in_force(found: Iterable[Examined]) -> str:
    """Names the hand-eye and tool calibrations among those that can be used."""
    used = usable(found)
    return basis(used.get("hand-eye"), used.get("tool"))


def _of_its_basis(one: Examined, before: Sequence[Examined]) -> Examined:
    """A tool or a port that was measured with other calibrations than those in force is to be measured again."""
    if one.calibration is None or one.calibration.made_with is None or one.problem is not None:
        return one
    used = usable(before)
    if fits_basis(one.calibration.made_with, used.get("hand-eye"), used.get("tool")):
        return one
    remedy = "`portdock teach` the port again." if one.calibration.kind == "port" else "`portdock calibrate tcp` again."
    cause = (
        f"the {one.slot} calibration was made with {one.calibration.made_with}; in force is {basis_in_force(before)}"
    )
    return Examined(one.slot, one.calibration, CalibrationFileError(cause, remedy=remedy))


def unfit(
    calibration: Calibration, devices: DeviceNames, now: datetime, max_age_days: float
) -> CalibrationFileError | None:
    """Why a sound calibration may not be used here and now, or None."""
    own = calibration.devices
    if own.arm != devices.arm:
        return CalibrationFileError(f"the {calibration.slot} calibration is of the arm {own.arm}, not {devices.arm}")
    if calibration.kind != "tool" and own.scanner != devices.scanner:
        return CalibrationFileError(
            f"the {calibration.slot} calibration is of the scanner {own.scanner}, not {devices.scanner}"
        )
    age_days = calibration.age_days(now)
    if age_days > max_age_days:
        return CalibrationFileError(
            f"the {calibration.slot} calibration is {age_days:.0f} days old (calibration.max_age_days:"
            f" {max_age_days:g})",
            remedy="Calibrate again; see docs/calibration.md.",
        )
    if age_days < -1.0:
        return CalibrationFileError(
            f"the {calibration.slot} calibration was measured {-age_days:.0f} days in the future",
            remedy="Set this computer's clock.",
        )
    return None


def with_calibrations(config: SiteConfig, calibrations: Iterable[Calibration]) -> SiteConfig:
    """The site's configuration with what the calibrations say instead of what the site file says. Pure."""
    for one in calibrations:
        pose = PoseConfig.of(one.pose)
        match one.kind:
            case "hand-eye":
                latency_ms = config.scanner.latency_ms if one.latency_ms is None else one.latency_ms
                update = {"T_flange_scanner": pose, "latency_ms": latency_ms}
                config = config.model_copy(update={"scanner": config.scanner.model_copy(update=update)})
                if one.arm_errors is not None:
                    errors = {"errors": ArmErrorsConfig.of(one.arm_errors)}
                    config = config.model_copy(update={"arm": config.arm.model_copy(update=errors)})
            case "tool":
                config = config.model_copy(update={"arm": config.arm.model_copy(update={"T_flange_tcp": pose})})
            case "port":
                config = config.model_copy(update={"port": config.port.model_copy(update={"T_port_tcp": pose})})
    return config


def calibrated(config: SiteConfig, remade: tuple[Kind, ...] = ()) -> SiteConfig:
    """The site as its calibrations have it. Raises what speaks against the first that cannot be used.

    :param remade: kinds that are about to be made anew: what cannot be used of them is left aside
    """
    used = []
    for one in examine_calibrations(config):
        if one.problem is None and one.calibration is not None:
            used.append(one.calibration)
        elif one.problem is not None and not one.slot.startswith(remade):
            raise one.problem  # the site file's own values may be as far off as a tape measure
    return with_calibrations(config, used)


def calibrated_as_far_as_fits(config: SiteConfig, devices: DeviceNames) -> tuple[SiteConfig, tuple[Examined, ...]]:
    """The site with those calibrations that can be used, for mock cells; and all that were looked at."""
    found = examine_calibrations(config, devices)
    fit = [one.calibration for one in found if one.calibration is not None and one.problem is None]
    return with_calibrations(config, fit), found


def on_mock_cell(site: SiteConfig, devices: DeviceNames) -> SiteConfig:
    """The site with the calibrations that belong to this mock cell; those of others and old ones are left aside."""
    site, found = calibrated_as_far_as_fits(site, devices)
    for one in found:
        if one.problem is not None:
            log.warning("not used: %s", one.problem.cause)
    return site.model_copy(update={"scanner": site.scanner.model_copy(update={"serial": devices.scanner})})
