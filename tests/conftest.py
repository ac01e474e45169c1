"""What all tests share: those over real wires get a second and a third try.

They run real processes against real time-outs; on a shared machine a stall of a second is no defect. A test that fails
three times in a row fails. Pure tests get no second try. Hypothesis draws the same examples each time, so that a change
is judged by itself.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("portdock", derandomize=True, deadline=None)
settings.load_profile("portdock")

HERE = Path(__file__).parent
OVER_WIRES = ("contract", "faults", "system")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.relative_to(HERE).parts[0] in OVER_WIRES:
            item.add_marker(pytest.mark.flaky(reruns=2))
