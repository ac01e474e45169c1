"""The calibrations of the mock cell that stands for the bundled site, as the documented commands found them.

Scanner, plug, arm and clock of that cell are off what the site file says by more than a docking forgives
(``scenarios.draw_scenario``): a dry run docks because it uses these, as a robot docks because it was calibrated. How
they were made stands in docs/calibration.md ("From scratch"); age does not count for a cell that does not change.
"""

from __future__ import annotations

from importlib import resources

from controller.calibrations.in_force import with_calibrations
from controller.calibrations.record import Calibration, from_yaml
from controller.config import SiteConfig, load_config
from controller.scanner_config import ScannerConfig

CELL = 0
"""The mock cell that is calibrated."""
KEPT_NAME = "calibrated mock cell"
_FOLDER = "mock-cell"


def stands_for(site: SiteConfig) -> bool:
    """Whether the calibrated mock cell is built as this site is: another mounting or arm needs its own calibrations."""
    bundled = load_config()
    return (
        site.scanner.T_flange_scanner == bundled.scanner.T_flange_scanner
        and site.scanner.latency_ms == bundled.scanner.latency_ms
        and site.arm.T_flange_tcp == bundled.arm.T_flange_tcp
        and site.arm.errors == bundled.arm.errors
        and (site.arm.model, site.arm.payload_kg) == (bundled.arm.model, bundled.arm.payload_kg)
    )


def is_kept(site: SiteConfig, scenario: str, cell: int | None) -> bool:
    """Whether a world is that of the calibrated cell: no other is named, and the site is built as it is."""
    return scenario != "uncalibrated" and cell is None and stands_for(site)


def cell_name(site: SiteConfig, scenario: str, seed: int, cell: int | None) -> str:
    """One for each draw of a cell's errors: the calibrated cell is one, ``uncalibrated`` draws others than the rest."""
    if is_kept(site, scenario, cell):
        return KEPT_NAME
    number = seed if cell is None else cell
    return f"uncalibrated mock cell {number}" if scenario == "uncalibrated" else f"mock cell {number}"


def has_hidden_latency(scanner: ScannerConfig) -> bool:
    """Whether the mock scanner's clock is off by what no data sheet tells; other kinds and ways to the time are not."""
    return scanner.protocol == "framed" and scanner.sync in ("timestamp", "shared_clock")


def as_calibrated(site: SiteConfig) -> SiteConfig:
    """The site with the mock cell's calibrations. What is already taught at the site stays."""
    with_them = with_calibrations(site, (one for one in _kept() if one.port is None))
    if not has_hidden_latency(site.scanner):
        scanner = with_them.scanner.model_copy(update={"latency_ms": site.scanner.latency_ms})
        with_them = with_them.model_copy(update={"scanner": scanner})
    if site.port.T_port_tcp is None:
        with_them = with_calibrations(with_them, (one for one in _kept() if one.port == site.port.model))
    return with_them


def _kept() -> list[Calibration]:
    files = sorted((resources.files("config") / _FOLDER).iterdir(), key=lambda file: file.name)
    return [from_yaml(file.read_text("utf-8"), file.name) for file in files if file.name.endswith(".yaml")]
