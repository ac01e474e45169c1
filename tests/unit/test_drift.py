"""The drift chart: silent while nothing changes, quick when something does, and which of the causes it names."""

from __future__ import annotations

import numpy as np
import pytest

from perception.calibration.drift import ChartSettings, Dock, chart, warnings

SIGMA = np.array([0.15e-3] * 3 + [np.deg2rad(0.08)] * 3)
BUMP = np.array([0.5e-3, 0.0, 0.0, 0.0, np.deg2rad(0.3), 0.0])
"""A scanner that was knocked by 0.5 mm and 0.3 deg."""


def docks(count: int, port: str = "ccs2", bumped_from: int | None = None, seed: int = 0) -> list[Dock]:
    rng = np.random.default_rng(seed)
    constant = rng.normal(0, 3, 6) * SIGMA
    return [
        Dock(
            port,
            constant + rng.normal(0, 1, 6) * SIGMA + (BUMP if bumped_from is not None and n >= bumped_from else 0.0),
        )
        for n in range(count)
    ]


def test_no_false_alarm_in_500_good_docks_in_19_of_20_cells() -> None:
    alarmed = sum(bool(chart(docks(520, seed=seed)).alarms.any()) for seed in range(20))
    assert alarmed <= 1


def test_a_slow_drift_is_warned_of_though_the_standard_grows_with_it() -> None:
    """Of a standard deviation in 30 docks: the standard must not swallow it."""
    creeping = [
        Dock("ccs2", dock.offset + n / 30.0 * SIGMA * np.eye(6)[0]) for n, dock in enumerate(docks(200, seed=4))
    ]
    found = chart(creeping)
    assert found is not None
    assert found.alarms[-1]
    assert found.shifted[-1].tolist() == [True, False, False, False, False, False]


def test_the_standard_grows_to_a_hundred_docks_and_not_over_an_alarm() -> None:
    assert [chart(docks(n)).standard for n in (21, 40, 300)] == [20, 29, 100]
    found = chart(docks(90, bumped_from=40, seed=2))
    assert found is not None
    assert found.alarms[-1]
    assert found.standard < 40


def test_a_bump_is_reported_within_five_docks() -> None:
    for seed in range(20):
        found = chart(docks(60 + 5, bumped_from=60, seed=seed))
        assert found is not None
        assert found.alarms[-5:].any(), seed


def test_before_the_standard_is_complete_nothing_is_judged() -> None:
    assert chart(docks(ChartSettings().baseline)) is None
    assert warnings(docks(ChartSettings().baseline)) == ()


def test_a_warning_names_axes_shift_and_since_when() -> None:
    (drift,) = warnings(docks(70, bumped_from=60, seed=3))
    assert {"x", "tilt about y"} <= set(drift.axes)
    assert drift.shift[0] == pytest.approx(0.5e-3, abs=0.25e-3)
    assert 4 <= drift.docks_ago <= 9


def test_all_ports_off_alike_points_at_hand_eye_one_port_off_at_its_teaching() -> None:
    both = docks(70, "ccs2", 60) + docks(70, "type2", 60, seed=1)
    assert {drift.cause for drift in warnings(both)} == {"hand-eye or tool"}
    one = docks(70, "ccs2", 60) + docks(70, "type2", seed=1)
    (drift,) = warnings(one)
    assert (drift.port, drift.cause) == ("ccs2", "teaching of this port")
