"""What all tests share: those over real wires get a second and a third try.

They run real processes against real time-outs; on a shared machine a stall of a second is no defect. A test that fails
three times in a row fails. Pure functions get no second try. Hypothesis draws the same examples each time, so that a
change is judged by itself.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("portdock", derandomize=True, deadline=None)
settings.load_profile("portdock")

HERE = Path(__file__).parent
OVER_WIRES = ("contract", "faults", "system")
IN_REAL_TIME = (
    "test_mission.py",
    "test_undocking.py",
    "test_daemon.py",
    "test_daemon_cli.py",
    "test_arm_worker.py",
    "test_arm_telemetry.py",
    "test_recorder.py",
    "test_charger_driver.py",
)
"""Unit tests of things with threads and deadlines."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.relative_to(HERE).parts[0] in OVER_WIRES or item.path.name in IN_REAL_TIME:
            item.add_marker(pytest.mark.flaky(reruns=2))
            item.add_marker(pytest.mark.real_time)
        if item.path.relative_to(HERE).parts[0] == "system" or item.path.name == "test_campaign_subset.py":
            item.add_marker(pytest.mark.whole_cell)
