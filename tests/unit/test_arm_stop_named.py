"""A safety stop that takes the control link down with the program is what a command reports, not the link."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.arm.errors import ControlLinkLostError, ProgramStoppedError
from drivers.arm.ur import UrArm
from drivers.base import LinkLostError, SafetyMode
from tests.arm_rig import settings


class HungLinks:
    """A worker that is given up for hung, and what the state link heard last."""

    fresh = True

    def __init__(self, safety_stop: SafetyMode | None) -> None:
        self.safety_stop = safety_stop
        self.newest = SimpleNamespace(tcp_speed=np.zeros(6), moving=False)
        self.telemetry = SimpleNamespace(fresh=lambda _: self.newest)
        self.program_ended = False

    @property
    def worker(self) -> Any:
        raise ControlLinkLostError("kick has not returned for 0.5 s")

    def end_program(self) -> None:
        self.program_ended = True


def arm(links: HungLinks) -> UrArm:
    return UrArm(settings("127.0.0.1"), links=links)  # type: ignore[arg-type]


@pytest.mark.parametrize("mode", [SafetyMode.PROTECTIVE_STOP, SafetyMode.VIOLATION])
def test_a_command_names_the_safety_stop(mode: SafetyMode) -> None:
    with pytest.raises(ProgramStoppedError, match=mode.name):
        arm(HungLinks(mode)).zero_force_sensor()


def test_without_a_safety_stop_the_lost_link_is_named() -> None:
    with pytest.raises(ControlLinkLostError):
        arm(HungLinks(None)).zero_force_sensor()


def test_a_stop_still_ends_the_program_over_the_dashboard() -> None:
    links = HungLinks(SafetyMode.VIOLATION)
    arm(links).stop()
    assert links.program_ended


def test_a_lost_link_is_a_lost_link() -> None:
    assert issubclass(ControlLinkLostError, LinkLostError)
