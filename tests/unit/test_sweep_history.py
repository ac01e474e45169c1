"""How far back a sweep looks into the arm's samples: far where clocks are fitted, not to the sweep before for edges."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from controller.cell import Cell
from controller.config import SiteConfig, load_config
from controller.sweep import SweepError
from controller.sweeping import taken_moving
from perception.scan import Profile

NOW_S = 500.0


class OneProfile:
    """A cell whose arm has no samples and whose scanner gives one profile; notes how far back it is asked."""

    def __init__(self) -> None:
        self.asked_s: list[float] = []
        self.wall = SimpleNamespace(now_s=lambda: NOW_S)
        self.arm = SimpleNamespace(history=self.history)
        self.scanner = SimpleNamespace(take=lambda: [Profile(0, NOW_S, None, np.zeros((1, 2)))])
        self.supervisor = SimpleNamespace(wait=lambda until, timeout_s=None: until())
        self.time_scale, self.profile_latency_s, self.recorded_since_s = 1.0, 0.0, -np.inf

    def history(self, since_s: float) -> list[object]:
        self.asked_s.append(since_s)
        return []

    def do(self, command: object) -> None: ...
    def arm_state(self) -> None: ...


def with_sync(sync: str) -> SiteConfig:
    config = load_config()
    return config.model_copy(update={"scanner": config.scanner.model_copy(update={"sync": sync})})


@pytest.mark.parametrize(("sync", "least_s", "most_s"), [("timestamp", 30.0, 120.0), ("trigger", 0.001, 0.4)])
def test_a_sweep_takes_arm_samples_from_before_it_only_as_they_help(sync: str, least_s: float, most_s: float) -> None:
    cell = OneProfile()
    with pytest.raises(SweepError):
        taken_moving(cast(Cell, cell), with_sync(sync), [], lambda *_: None)
    assert least_s <= NOW_S - cell.asked_s[0] <= most_s
