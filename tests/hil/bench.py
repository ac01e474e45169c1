"""The devices of a site file for the bench tests: real ones, or their mocks where the file says ``mock:``."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from controller.assembly import Assembly, assemble
from controller.cli.dry_run import FAST_FACTOR, for_mocks
from controller.config import SiteConfig, load_config
from controller.mock_cell import MockCell
from controller.port_files import load_port
from controller.scenarios import draw_scenario
from drivers.base import NullSink

MOCK = "mock:"
DEVICES = ("arm", "scanner", "charger")
ADDRESS = {"arm": "host", "scanner": "device", "charger": "channel"}


class NoEvidence(NullSink):
    """Bench tests record nothing; a docking does so by itself."""

    def command(self, name: str, detail: str, allowed: bool, reason: str) -> None:
        """Drop the decision."""


@dataclass(frozen=True)
class Bench:
    """What is on the bench."""

    config: SiteConfig
    mocked: frozenset[str]
    pace: float

    @property
    def all_mocked(self) -> bool:
        return self.mocked == set(DEVICES)

    @property
    def mixed(self) -> bool:
        """Some real, some mocked: they do not share a world, so that no plug is felt by both."""
        return bool(self.mocked) and not self.all_mocked

    def assemble(self, closing: ExitStack) -> Assembly:
        """Open all three devices; the supervisor ticks, the charger hears a robot in service mode."""
        return assemble(self.config, NoEvidence(), closing, pace=self.pace, heartbeat_mode=4)


def load_bench(path: Path, closing: ExitStack) -> Bench:
    """The site's bench; mocks are started for the devices that are ``mock:``."""
    site = load_config(path)
    mocked = frozenset(name for name in DEVICES if getattr(getattr(site, name), ADDRESS[name]) == MOCK)
    if not mocked:
        return Bench(site, mocked, 1.0)
    fast = mocked == set(DEVICES)
    wide = for_mocks(site, fast=fast)
    pace = FAST_FACTOR if fast else 1.0
    folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="portdock-hil-")))
    world = draw_scenario("nominal", wide, load_port(wide.port.model), 4)
    cell = closing.enter_context(MockCell(folder, wide, world, 4, pace))
    replaced = {name: getattr(cell.config, name) for name in mocked}
    return Bench(wide.model_copy(update=replaced), mocked, pace)
