"""A safety stop that ended the program is what commands are told from then on, not what ur_rtde makes of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.arm import messages as m
from drivers.arm.errors import ControlLinkLostError
from drivers.arm.links import Links
from drivers.arm.ur import UrArm
from drivers.base import MonotonicClock, NullSink, SafetyMode
from perception.geometry import Pose
from tests.arm_rig import settings


class Worker:
    """Answers, or is lost in a call, during which a safety stop may be heard of."""

    def __init__(self, lost: bool = False) -> None:
        self.lost = lost
        self.asked: list[m.Command] = []
        self.meanwhile = lambda: None

    def ask(self, command: m.Command, timeout_s: float) -> m.Reply:
        self.asked.append(command)
        self.meanwhile()
        if self.lost:
            raise ControlLinkLostError("kick has not returned for 0.5 s")
        return m.Reply(1)


def links(worker: Worker) -> Links:
    made = Links(settings("127.0.0.1"), NullSink(), MonotonicClock())
    made._worker = worker  # type: ignore[assignment]
    made._begin_to_end_program = lambda: None  # type: ignore[method-assign]
    return made


def heard(made: Links, mode: SafetyMode) -> None:
    state: Any = SimpleNamespace(safety=mode)
    made._on_state(state)


ZERO, STOP = m.ZeroForceSensor(), m.Stop(1.0, 0.0)


@pytest.mark.parametrize("mode", [mode for mode in SafetyMode if mode not in (SafetyMode.NORMAL, SafetyMode.REDUCED)])
def test_after_any_safety_stop_no_motion_is_passed_on_and_the_stop_is_named(mode: SafetyMode) -> None:
    worker = Worker()
    made = links(worker)
    heard(made, mode)
    reply = made.ask(ZERO, 1.0)
    assert reply.refusal == "program-stopped"
    assert mode.name in reply.detail
    assert not worker.asked


def test_a_motion_is_over_with_the_stop_although_the_worker_says_nothing_of_it() -> None:
    made = links(Worker())
    arm = UrArm(settings("127.0.0.1"), links=made)
    arm._tracker.begin(arm._tracker.next_id(), Pose.identity())
    heard(made, SafetyMode.VIOLATION)
    progress = arm.motion()
    assert progress.failed and not progress.running
    assert "VIOLATION" in progress.detail


def test_the_stop_is_still_named_when_it_is_released() -> None:
    made = links(Worker())
    heard(made, SafetyMode.VIOLATION)
    heard(made, SafetyMode.NORMAL)
    assert "VIOLATION" in made.ask(ZERO, 1.0).detail


def test_a_worker_that_is_lost_in_its_wait_for_the_ended_program_is_no_lost_link() -> None:
    worker = Worker(lost=True)
    made = links(worker)
    worker.meanwhile = lambda: heard(made, SafetyMode.VIOLATION)
    assert "VIOLATION" in made.ask(ZERO, 1.0).detail


def test_without_a_safety_stop_a_lost_link_is_named() -> None:
    with pytest.raises(ControlLinkLostError):
        links(Worker(lost=True)).ask(ZERO, 1.0)


def test_a_stop_is_passed_on_all_the_same_and_its_loss_is_told() -> None:
    worker = Worker()
    made = links(worker)
    heard(made, SafetyMode.PROTECTIVE_STOP)
    assert not made.ask(STOP, 1.0).refusal
    worker.lost = True
    with pytest.raises(ControlLinkLostError):
        made.ask(STOP, 1.0)
