"""All checks in the order in which an engineer would make them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from controller.config import SiteConfig
from controller.doctor import devices, host
from controller.doctor.findings import Finding, ok, warn
from controller.port_files import load_port
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
