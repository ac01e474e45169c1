"""A sweep that cannot be used is repeated from the same viewpoint, with the reason kept; then the next one is tried."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from controller import looking
from controller.config import SiteConfig, load_config
from controller.config_section import PoseConfig
from controller.looking import MOST_SPOILED, Looking
from controller.rough_look import CoarseStage, NoRoughPlaceError, RoughLook
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


class StandInRough:
    """A coarse stage that sees the port, or does not, as listed."""

    def __init__(self, seen: list[bool]) -> None:
        self.seen = seen

    def passes(self) -> str:
        return "coarse passes"

    def sweep(self, report: object) -> None: ...

    def aimed(self, config: SiteConfig) -> SiteConfig:
        if not self.seen.pop(0):
            raise NoRoughPlaceError("the coarse scan shows no port")
        port = config.port.model_copy(update={"T_base_port": PoseConfig(xyz_mm=(1.0, 2.0, 3.0))})
        return config.model_copy(update={"port": port})


def rough_then_precise(seen: list[bool]) -> Looking:
    one = Looking(None, load_config(scanner="scip_profiler"))  # type: ignore[arg-type]
    one._rough = StandInRough(seen)  # type: ignore[assignment]
    return one


def test_the_coarse_scan_aims_the_precise_one_and_accepts_nothing() -> None:
    one = rough_then_precise([True])
    assert one.passes() == "coarse passes"
    one.sweep(lambda *_: None)
    assert one.locate() is None
    assert one.may_look_again(1)
    aimed = load_config().port.model_copy(update={"T_base_port": PoseConfig(xyz_mm=(1.0, 2.0, 3.0))})
    expected = looking.plan_view(load_config().model_copy(update={"port": aimed}), 0)
    for ours, theirs in zip(one.passes(), expected, strict=True):
        assert ours.T_base_tcp_start.distance_to(theirs.T_base_tcp_start) < 1e-9


def test_a_coarse_scan_without_a_port_is_made_again_a_few_times_and_then_the_reason_stands() -> None:
    one = rough_then_precise([False] * (MOST_SPOILED + 1))
    for _ in range(MOST_SPOILED + 1):
        assert one.may_look_again(1)
        one.sweep(lambda *_: None)
        assert one.locate() is None
    assert not one.may_look_again(1)
    assert one.problem == "the coarse scan shows no port"


def test_the_coarse_sweep_covers_everywhere_that_the_port_may_be() -> None:
    site = load_config(scanner="scip_profiler")
    assert site.coarse is not None
    rough = RoughLook(Bare(), site, site.coarse, CoarseStage(None, lambda *_: None))  # type: ignore[arg-type]
    (only,) = rough.passes()
    way_m = only.T_base_tcp_start.distance_to(only.T_base_tcp_end)
    assert way_m > 2 * site.coarse.lateral_mm / 1000.0 + 0.05


@dataclass
class Bare:
    """Just enough of a cell to be copied."""

    scanner: object = None
    profile_latency_s: float = 0.0
