"""All checks in the order in which an engineer would make them."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from controller.calibrations.in_force import examine_calibrations
from controller.charger_config import check_can_protection
from controller.config import SiteConfig
from controller.doctor import devices, host
from controller.doctor.findings import Finding, fail, ok, warn
from controller.port_files import load_port
from controller.wiring import check_charger
from perception.errors import PortdockError


def examine(config: SiteConfig, with_devices: bool = True) -> Iterator[Finding]:
    """Findings one by one; nothing moves and nothing is written to a device."""
    yield host.python()
    yield from host.libraries()
    yield host.disk(Path(config.recording.folder), config.recording.keep_mb)
    yield host.scheduling()
    yield host.governor()
    yield host.clock()
    yield port(config)
    yield contract(config)
    yield from calibrations(config)
    if with_devices:
        yield from devices.scanner(config)
        yield from devices.charger(config)
        yield from devices.arm(config)


def port(config: SiteConfig) -> Finding:
    """Is the port known well enough to be docked at without teaching?"""
    name = config.port.model
    try:
        description = load_port(name)
    except PortdockError as error:
        return warn("port", error.cause, error.remedy)
    if description.teach_before_docking:
        return warn(
            "port",
            f"{name}: not every dimension is known to a tenth of a millimetre",
            "Check the model against a real inlet's CAD (`portdock locate --model FILE`) before docking.",
        )
    return ok("port", f"{name} is known to a tenth of a millimetre where contacts meet")


def contract(config: SiteConfig) -> Finding:
    """Can the charger be understood, and are its frames protected?"""
    site = config.charger
    try:
        check_charger(config)
        unprotected = check_can_protection(site)
    except PortdockError as error:
        return fail("charger", error.cause, error.remedy)
    if unprotected:
        return warn("charger", unprotected, "Set charger.protection, if the charger can: e2e-p11 is the default.")
    return ok(
        "charger", f"{site.dbc or 'the bundled DBC'} has what the contract wants, frames protected by {site.protection}"
    )


AGEING = 0.8
"""From this share of ``calibration.max_age_days`` on, a calibration is soon to be made again."""


def calibrations(config: SiteConfig, now: datetime | None = None) -> Iterator[Finding]:
    """Are the calibrations in force sound, of these devices, and young enough?"""
    now = now or datetime.now(UTC)
    found = examine_calibrations(config, now=now)
    if "hand-eye" not in {one.slot for one in found}:
        fix = "portdock calibrate hand-eye --target sphere; docs/calibration.md says how."
        yield warn("calibration", "hand-eye: none measured, the site file's T_flange_scanner is used", fix)
    for one in found:
        if one.problem is not None or one.calibration is None:
            problem = one.problem
            yield fail(
                "calibration", "" if problem is None else problem.cause, "" if problem is None else problem.remedy
            )
            continue
        age_days, limit_days = one.calibration.age_days(now), config.calibration.max_age_days
        text = f"{one.slot}: {age_days:.0f} days old, 1 sigma {one.calibration.sigma_mm:.2f} mm"
        if age_days > AGEING * limit_days:
            yield warn("calibration", f"{text}; refused from {limit_days:g} days on", "Calibrate again soon.")
        else:
            yield ok("calibration", text)
