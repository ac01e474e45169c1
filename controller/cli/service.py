"""``portdock run``: the daemon, on the site's devices or, to try it, on mocks."""

from __future__ import annotations

import logging
import os
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from controller.calibrations.in_force import calibrated
from controller.config import SiteConfig, load_config
from controller.config_section import ConfigError
from controller.precision import refuse_too_coarse
from controller.scenarios import SCENARIOS

if TYPE_CHECKING:
    from controller.daemon.life import Assemble

JOURNAL_LEVELS = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6), (0, 7))


def run(
    config: Annotated[Path | None, typer.Option(help="The site file; with --mock addresses are the mocks'.")] = None,
    mock: Annotated[bool, typer.Option("--mock", help="Run on mock devices: nothing real is opened.")] = False,
    fast: Annotated[bool, typer.Option("--fast", help="With --mock: wires and arm twice as fast.")] = False,
    scenario: Annotated[str, typer.Option(help="With --mock: one of " + ", ".join(SCENARIOS) + ".")] = "nominal",
    seed: Annotated[int, typer.Option(min=0, help="With --mock: where the car stands.")] = 0,
    pace: Annotated[float, typer.Option(hidden=True, min=1.0, max=8.0)] = 1.0,
) -> None:
    """Serve `portdock dock` and its siblings until SIGTERM. Nothing moves before the first job."""
    log_for_a_service()
    if mock:
        _run_on_mocks(load_config(config), config, fast, scenario, seed)
        return
    if config is None:
        raise ConfigError("no site file", remedy="Give --config SITE, or --mock to try it without hardware.")
    site = calibrated(load_config(config))
    if pace != 1.0 and not site.arm.host.startswith("127."):
        raise ConfigError("--pace is for mocks only", remedy="Leave it out.")
    refuse_too_coarse(site)
    from controller.daemon.life import Setting, run_daemon  # devices take seconds to import

    run_daemon(Setting(site, site.arm.host, config), assemble_at(pace, 2 if pace == 1.0 else 1))


def _run_on_mocks(site: SiteConfig, path: Path | None, fast: bool, scenario: str, seed: int) -> None:
    """The very daemon, with three mock processes at the far ends of its wires; its memory ends with their world."""
    from controller.calibrations.in_force import mock_names, on_mock_cell
    from controller.cli.dry_run import FAST_FACTOR, for_mocks
    from controller.daemon.life import Setting, run_daemon  # see above
    from controller.mock_calibrations import cell_name
    from controller.mock_cell import MockCell
    from controller.port_files import load_port
    from controller.scenarios import draw_scenario

    wide = for_mocks(site, fast)
    world = draw_scenario(scenario, wide, load_port(wide.port.model), seed)
    pace = FAST_FACTOR if fast else 1.0
    with tempfile.TemporaryDirectory(prefix="portdock-") as folder:
        service = wide.service.model_copy(update={"state_folder": folder})
        with MockCell(Path(folder), wide.model_copy(update={"service": service}), world, seed, pace) as cell:
            site = on_mock_cell(cell.config, mock_names(cell_name(wide, scenario, seed, None)))
            run_daemon(Setting(site, "mock", path), assemble_at(pace, 1))


def assemble_at(pace: float, heartbeat_mode: int) -> Assemble:
    """How a daemon puts its cell together."""
    from controller.assembly import Assembly, Evidence, assemble  # devices take seconds to import

    def assembled(config: SiteConfig, evidence: Evidence, closing: ExitStack, alive: Callable[[], None]) -> Assembly:
        return assemble(config, evidence, closing, pace=pace, heartbeat_mode=heartbeat_mode, alive=alive)

    return assembled


class JournalFormatter(logging.Formatter):
    """One line a record, with the journal's priority in front (sd-daemon(3)) and without a time: the journal has it."""

    def format(self, record: logging.LogRecord) -> str:
        priority = next(number for level, number in JOURNAL_LEVELS if record.levelno >= level)
        return f"<{priority}>{record.name}: " + super().format(record).replace("\n", "\\n")


def log_for_a_service() -> None:
    """Everything from INFO up to stderr: for the journal as it likes it, for a terminal with times."""
    root = logging.getLogger()
    root.setLevel(min(logging.INFO, root.level))
    for handler in root.handlers:
        if "JOURNAL_STREAM" in os.environ:
            handler.setFormatter(JournalFormatter())
    logging.captureWarnings(True)
    sys.stderr.flush()
