"""A soak: worlds one after the other, in each a daemon's cell with its links kept open and a number of missions."""

from __future__ import annotations

import json
import logging
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from controller.assembly import assemble
from controller.calibrations.in_force import mock_names, on_mock_cell
from controller.config import SiteConfig
from controller.daemon.records import Recordings
from controller.faults import Outcome
from controller.mission import Mission
from controller.mock_calibrations import cell_name
from controller.mock_cell import MockCell
from controller.port_files import load_port
from controller.scenarios import draw_parking, draw_scenario
from controller.soak.desk import SoakDesk
from controller.soak.faults import NOTHING, Trouble, draw
from controller.soak.figures import Footprint, Growth, growth
from controller.soak.operator import power_on
from drivers.base import Clock

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Plan:
    """How long, and how rough."""

    missions: int
    end_s: float
    """No mission begins after this time of the monotonic clock."""
    seed: int
    fault_share: float
    missions_a_world: int
    pace: float
    scenario: str = "nominal"
    mock_cell: int | None = None
    """Whose calibration errors there are, and whose calibrations are used; None: the kept cell's where the site is
    built as the bundled one, else each world's own."""


@dataclass(frozen=True, slots=True)
class Line:
    """One mission of a soak."""

    number: int
    world: int
    trouble: str
    state: str
    outcome: str
    fault: str | None
    detail: str
    explained: bool
    duration_s: float
    rss_mb: float
    descriptors: int
    threads: int


@dataclass(slots=True)
class Soak:
    """What came out."""

    lines: list[Line] = field(default_factory=list)
    given_up: list[str] = field(default_factory=list)
    """Worlds whose cell could not be made ready again, and why."""

    @property
    def unexplained(self) -> list[Line]:
        """Missions that ended in a way that nothing explains."""
        return [line for line in self.lines if not line.explained]

    @property
    def growth(self) -> Growth | None:
        """Whether the process grew."""
        return growth([Footprint(line.rss_mb, line.descriptors, line.threads) for line in self.lines])


def run_soak(config: SiteConfig, plan: Plan, folder: Path, clock: Clock, tell: Callable[[Line], None]) -> Soak:
    """Run until the plan is fulfilled; each mission is one line of ``soak.jsonl`` as soon as it has ended."""
    soak, rng = Soak(), np.random.default_rng([plan.seed, 7])
    recording = config.recording.model_copy(update={"folder": str(folder / "runs")})
    site, world = config.model_copy(update={"recording": recording}), 0
    with (folder / "soak.jsonl").open("a", encoding="utf-8") as file:

        def keep(line: Line) -> None:
            soak.lines.append(line)
            file.write(json.dumps(asdict(line)) + "\n")
            file.flush()
            tell(line)

        while len(soak.lines) < plan.missions and clock.now_s() < plan.end_s:
            _World(site, plan, world, rng, clock, soak, keep).run()
            world += 1
    return soak


class _World:
    """One cell of mocks and some missions, each with the car parked elsewhere."""

    def __init__(
        self,
        site: SiteConfig,
        plan: Plan,
        number: int,
        rng: np.random.Generator,
        clock: Clock,
        soak: Soak,
        keep: Callable[[Line], None],
    ) -> None:
        self._site, self._plan, self._number, self._rng = site, plan, number, rng
        self._clock, self._soak, self._keep = clock, soak, keep
        self._trouble: Trouble = NOTHING
        self._state = self._planned_state = ""
        self._begun_s = clock.now_s()

    def run(self) -> None:
        """All missions of this world. Raises LinkOpenError when its mocks do not come up."""
        plan, seed = self._plan, self._plan.seed + self._number
        world = draw_scenario(plan.scenario, self._site, load_port(self._site.port.model), seed, plan.mock_cell)
        names = mock_names(cell_name(self._site, plan.scenario, seed, plan.mock_cell))
        with tempfile.TemporaryDirectory(prefix="portdock-soak-") as wires, ExitStack() as closing:
            cell = closing.enter_context(MockCell(Path(wires), self._site, world, seed, plan.pace))
            config = on_mock_cell(cell.config, names)
            records = Recordings(config, lambda event: None, lambda *_: None, reports=False)
            live = assemble(config, records, closing, pace=plan.pace, heartbeat_mode=1)
            closing.callback(records.close)
            records.attach(live.cell, live.model, Path(wires))
            mission = Mission(live.cell, config, live.T_port_tcp_mated, records, Path(wires))

            def make_trouble(source: str, event: str, target: str) -> None:
                if target == self._state and self._trouble is not NOTHING and mission.now.outcome is None:
                    self._state = ""
                    self._trouble.make(cell, live.cell.supervisor)

            records.on_transition = make_trouble
            left = min(plan.missions_a_world, plan.missions - len(self._soak.lines))

            def repair() -> None:
                cell.repair()
                power_on(cell.config.arm.host)

            desk = SoakDesk(
                left, self._ended, repair, lambda: self._clock.now_s() > plan.end_s, lambda: self._begin(cell, mission)
            )
            mission.serve(desk)
            if desk.given_up:
                self._soak.given_up.append(f"world {self._number}: {desk.given_up}")

    def _begin(self, cell: MockCell, mission: Mission) -> None:
        """Another car, unless the arm still stands before the port of the last one; and what this mission meets with.

        Resets and undocks between two missions are left alone.
        """
        if mission.task.plan is None:
            rng = np.random.default_rng([self._plan.seed, len(self._soak.lines), 3])
            cell.park(draw_parking(self._site, rng))
        self._trouble, self._state = draw(self._rng, self._plan.fault_share)
        self._planned_state, self._begun_s = self._state, self._clock.now_s()

    def _ended(self, outcome: Outcome) -> None:
        made = self._trouble is not NOTHING and self._state == ""
        trouble, footprint = self._trouble if made else NOTHING, Footprint.now()
        self._keep(
            Line(
                number=len(self._soak.lines),
                world=self._number,
                trouble=trouble.name,
                state=self._planned_state if made else "",
                outcome=outcome.kind,
                fault=None if outcome.fault is None else outcome.fault.code.value,
                detail="" if outcome.fault is None else outcome.fault.detail,
                explained=trouble.explains(outcome),
                duration_s=round(self._clock.now_s() - self._begun_s, 2),
                rss_mb=round(footprint.rss_mb, 2),
                descriptors=footprint.descriptors,
                threads=footprint.threads,
            )
        )
        self._trouble, self._state = NOTHING, ""
