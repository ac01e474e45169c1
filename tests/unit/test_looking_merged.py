"""The second rung: scans of one port are asked about together; the last rung trusts nothing that was seen before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from types import SimpleNamespace

import numpy as np
import pytest

from controller import looking
from controller.config import load_config
from controller.looking import Looking
from perception.estimate import PortEstimate, Prior
from perception.geometry import Pose
from perception.scan import Cloud, Profile, Scan


def scan_of(points: int) -> Scan:
    return Scan((Profile(0, 0.0, 0.0, np.zeros((points, 2))),), (Pose.identity(),), Pose.identity())


class Asked:
    """Notes the clouds of each question by their sizes; answers by a rule."""

    def __init__(self, accepts: Callable[[list[int]], bool]) -> None:
        self.questions: list[list[int]] = []
        self._accepts = accepts

    def submit(self, clouds: Sequence[Cloud], prior: Prior) -> Future[PortEstimate]:
        sizes = [len(cloud.points) for cloud in clouds]
        self.questions.append(sizes)
        answer: Future[PortEstimate] = Future()
        accepted = self._accepts(sizes)
        reasons = () if accepted else ("no rim",)
        answer.set_result(
            PortEstimate(
                "type2", Pose.identity(), "base", np.eye(6) * 1e-9, 1e-4, 0.9, float(len(sizes)), accepted, reasons, ()
            )
        )
        return answer


def looks(monkeypatch: pytest.MonkeyPatch, asked: Asked, *points: int) -> Looking:
    """Sweeps that give these many points, in this order."""
    scans = [scan_of(n) for n in points]
    monkeypatch.setattr(looking, "run_sweep", lambda *_: scans.pop(0))
    cell = SimpleNamespace(locator=asked, supervisor=SimpleNamespace(wait=lambda done: done()), T_base_port=None)
    return Looking(cell, load_config())  # type: ignore[arg-type]


def sweep_and_locate(one: Looking) -> PortEstimate | None:
    one.sweep(lambda *_: None)
    return one.locate()


def test_a_second_scan_is_merged_with_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = Asked(lambda sizes: len(sizes) == 2)
    one = looks(monkeypatch, asked, 3, 5)
    first, second = sweep_and_locate(one), sweep_and_locate(one)
    assert first is not None and not first.accepted
    assert second is not None and second.accepted
    assert asked.questions == [[3], [3, 5]]


def test_a_bad_first_scan_does_not_spoil_a_good_second_one(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = Asked(lambda sizes: sizes == [5])
    one = looks(monkeypatch, asked, 3, 5)
    sweep_and_locate(one)
    second = sweep_and_locate(one)
    assert second is not None and second.accepted
    assert asked.questions == [[3], [3, 5], [5]]


def test_where_both_are_refused_the_reasons_of_the_merged_scans_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    one = looks(monkeypatch, Asked(lambda sizes: False), 3, 5)
    sweep_and_locate(one)
    second = sweep_and_locate(one)
    assert second is not None and not second.accepted
    assert second.runner_up_margin == 2.0  # of both scans


def test_the_last_rung_asks_about_the_fresh_scan_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = Asked(lambda sizes: True)
    one = looks(monkeypatch, asked, 3, 5, 7)
    for _ in range(2):
        sweep_and_locate(one)
    one.forget_scans()
    sweep_and_locate(one)
    assert asked.questions[-1] == [7]
