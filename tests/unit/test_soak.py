"""The soak's bookkeeping: what counts as a leak, what explains an outcome, what an operator does after a fault."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from controller.cli import campaign
from controller.cli import soak as soak_command
from controller.config import load_config
from controller.config_section import ConfigError
from controller.faults import Fault, FaultCode, Outcome
from controller.soak.desk import MOST_RESETS, SoakDesk
from controller.soak.faults import NOTHING, TROUBLES, draw
from controller.soak.figures import Footprint, growth
from controller.soak.run import Plan, Soak, _World
from controller.states import State
from controller.task import Goal
from drivers.base import MonotonicClock
from perception.geometry import Pose


def desk(missions: int = 2) -> tuple[SoakDesk, list[Outcome]]:
    ended: list[Outcome] = []
    return SoakDesk(missions, ended.append, lambda: None, lambda: False), ended


def test_memory_that_grows_after_the_warm_up_is_seen_and_a_noisy_level_is_not() -> None:
    rng = np.random.default_rng(1)
    level = [Footprint(300.0 + rng.normal(0, 1), 40, 20) for _ in range(60)]
    leak = [Footprint(f.rss_mb + 0.5 * k, 40 + k // 20, 20) for k, f in enumerate(level)]
    flat, grown = growth(level), growth(leak)
    assert flat is not None and abs(flat.rss_mb) < 1.0 and flat.descriptors == 0.0
    assert grown is not None and grown.rss_mb > 10.0 and grown.descriptors >= 1.0


def test_what_is_allocated_once_in_the_warm_up_is_no_leak() -> None:
    begun = [Footprint(100.0 + 80.0 * k, 10 + k, 5) for k in range(3)] + [Footprint(400.0, 20, 10)] * 12
    measured = growth(begun)
    assert measured is not None and (measured.rss_mb, measured.descriptors, measured.threads) == (0.0, 0.0, 0.0)
    assert growth(begun[:5]) is None


def test_this_process_has_a_footprint() -> None:
    now = Footprint.now()
    assert now.rss_mb > 5.0 and now.descriptors >= 3 and now.threads >= 1


def test_a_mission_without_trouble_must_end_charged() -> None:
    assert NOTHING.explains(Outcome("charged"))
    assert not NOTHING.explains(Outcome("stopped"))
    assert not NOTHING.explains(Outcome.of(Fault(FaultCode.INSERTION_BLOCKED)))


def test_no_trouble_explains_a_defect_and_each_explains_something() -> None:
    for trouble in TROUBLES:
        assert not trouble.explains(Outcome.of(Fault(FaultCode.INTERNAL)))
        assert trouble.codes or trouble.kinds
        assert {State[name] for name in trouble.states}


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_share_of_troubled_missions_is_as_asked(share: float) -> None:
    rng = np.random.default_rng(3)
    drawn = [draw(rng, share) for _ in range(400)]
    troubled = [trouble for trouble, _ in drawn if trouble is not NOTHING]
    assert abs(len(troubled) / 400 - share) < 0.08
    assert all(state in trouble.states for trouble, state in drawn if trouble is not NOTHING)


def test_after_a_fault_the_desk_resets_undocks_and_goes_on() -> None:
    d, ended = desk(2)
    jobs = []
    answers = [
        Outcome.of(Fault(FaultCode.ABORTED)),  # the mission
        Outcome.of(Fault(FaultCode.PLUG_INSERTED_AT_START)),  # the reset
        Outcome("undocked"),
        Outcome("charged"),  # the second mission
    ]
    for answer in answers:
        jobs.append(d.take())
        d.answered(answer)
    assert jobs == [Goal.CYCLE, Goal.RESET, Goal.UNDOCK, Goal.CYCLE]
    assert d.leaving and not d.given_up and [o.kind for o in ended] == ["fault", "charged"]


def test_a_cell_that_cannot_be_made_ready_is_given_up_with_the_reason() -> None:
    d, _ = desk(5)
    for _ in range(MOST_RESETS + 1):
        d.take()
        d.answered(Outcome.of(Fault(FaultCode.ARM_LINK_LOST, "cut")))
    assert d.leaving and "arm-link-lost" in d.given_up


def test_a_blocked_port_is_an_outcome_in_ready_and_needs_no_reset() -> None:
    d, _ = desk(2)
    d.take()
    d.answered(Outcome("intervention-needed", Fault(FaultCode.INSERTION_BLOCKED)))
    assert d.pending is Goal.CYCLE


def test_the_begin_of_each_mission_is_told_and_that_of_no_reset_or_undock_in_between() -> None:
    begun: list[Goal | None] = []
    d = SoakDesk(2, lambda outcome: None, lambda: None, lambda: False)
    d.begins = lambda: begun.append(d._doing)
    for answer in (
        Outcome.of(Fault(FaultCode.ABORTED)),
        Outcome.of(Fault(FaultCode.PLUG_INSERTED_AT_START)),
        Outcome("undocked"),
        Outcome("charged"),
    ):
        d.take()
        d.answered(answer)
    assert begun == [Goal.CYCLE, Goal.CYCLE]


class Cell:
    """Where cars have parked."""

    def __init__(self) -> None:
        self.parked: list[Pose] = []

    def park(self, T_base_port: Pose) -> None:
        self.parked.append(T_base_port)


def test_a_car_parks_before_each_mission_unless_the_arm_stands_before_the_last_one() -> None:
    plan = Plan(9, np.inf, 1, 1.0, 9, 1.0)
    soak = Soak()
    world: Any = _World(load_config(), plan, 0, np.random.default_rng(1), MonotonicClock(), soak, soak.lines.append)
    cell: Any = Cell()
    for stands_before in (None, "a plan", None):
        world._begin(cell, SimpleNamespace(task=SimpleNamespace(plan=stands_before)))
        assert world._trouble is not NOTHING and world._state == world._planned_state, "drawn for this very mission"
        world._ended(Outcome("charged"))
        assert world._trouble is NOTHING and world._state == "", "none for what comes in between"
    assert len(cell.parked) == 2 and cell.parked[0].distance_to(cell.parked[1]) > 1e-4


def test_the_site_in_a_hurry_is_one_for_which_a_soak_may_hurry() -> None:
    hurried = load_config(Path("config/soak.yaml"))
    soak_command.check_site(hurried, 4.0)
    soak_command.check_site(load_config(), 3.0)
    with pytest.raises(ConfigError, match="too early"):
        soak_command.check_site(load_config(), 4.0)
    holding = hurried.mission.model_copy(update={"on_final_failure": "hold"})
    with pytest.raises(ConfigError, match="waits for nobody"):
        soak_command.check_site(hurried.model_copy(update={"mission": holding}), 1.0)


def test_a_campaigns_folder_is_of_one_site_and_pace(tmp_path: Path) -> None:
    campaign.check_site(load_config(), 2.0, tmp_path / "site.yaml")
    campaign.check_site(load_config(), 2.0, tmp_path / "site.yaml")
    for site, pace in ((load_config(), 3.0), (load_config(Path("config/soak.yaml")), 2.0)):
        with pytest.raises(ConfigError, match="another site or pace"):
            campaign.check_site(site, pace, tmp_path / "site.yaml")
