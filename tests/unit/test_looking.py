"""A sweep that cannot be used is repeated from the same viewpoint, with the reason kept; then the next one is tried."""

from __future__ import annotations

import numpy as np
import pytest

from controller import looking
from controller.config import load_config
from controller.looking import MOST_SPOILED, Looking
from controller.sweep import SweepError
from perception.geometry import Pose
from perception.scan import Profile, Scan

GOOD = Scan((Profile(0, 0.0, 0.0, np.zeros((3, 2))),), (Pose.identity(),), Pose.identity())


def looking_with(monkeypatch: pytest.MonkeyPatch, results: list[Scan | Exception]) -> tuple[Looking, list[int]]:
    one = Looking(None, load_config())  # type: ignore[arg-type]
    views: list[int] = []

    def run(*_: object) -> Scan:
        views.append(one.scans_made)
        result = results.pop(0)
        if isinstance(result, Exception):
            raise result
        return result

    monkeypatch.setattr(looking, "run_sweep", run)
    return one, views


def test_too_many_lost_profiles_are_repeated_with_the_count_from_the_same_viewpoint(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lost = SweepError("52 of 400 profiles were lost (13%, at most 5% allowed)")
    one, views = looking_with(monkeypatch, [lost, GOOD])
    one.sweep(lambda *_: None)
    assert one.problem == "52 of 400 profiles were lost (13%, at most 5% allowed)"
    assert one.locate() is None
    one.sweep(lambda *_: None)
    assert views == [0, 0]
    assert one.problem == ""
    assert one.cloud is not None
    assert one.scans_made == 1


def test_sweeps_that_keep_failing_use_up_viewpoints_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    one, views = looking_with(monkeypatch, [SweepError("spoiled") for _ in range(MOST_SPOILED + 2)])
    for _ in range(MOST_SPOILED + 2):
        one.sweep(lambda *_: None)
    assert views == [0] * (MOST_SPOILED + 1) + [1]
