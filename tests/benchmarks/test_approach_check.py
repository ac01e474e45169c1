"""How long it takes to check a whole approach before the arm sets out: reach, singularity and collision on the way."""

from __future__ import annotations

import logging
import statistics
import time

import pytest

from drivers.arm import validate
from drivers.base import Box
from tests.unit.test_arm_rules import make_settings, make_state

pytestmark = pytest.mark.benchmark_ratio
log = logging.getLogger(__name__)

AHEAD_M = 0.25
CHECKS = 50
ALLOWED_S = 0.020


def test_a_whole_approach_is_checked_within_20_ms() -> None:
    state, settings = make_state(), make_settings()
    goal = state.T_base_tcp.moved([0.0, 0.0, AHEAD_M])
    panel = Box("panel", state.T_base_tcp.moved([0.0, 0.0, AHEAD_M + 0.3]), (0.5, 0.5, 0.01), tool_may_touch=True)
    cover = Box("cover", state.T_base_tcp.moved([0.3, 0.0, AHEAD_M]), (0.01, 0.1, 0.1))
    times_s = []
    for _ in range(CHECKS):
        begun_s = time.perf_counter()
        validate.clear(validate.line(goal, state, settings), settings, (panel, cover))
        times_s.append(time.perf_counter() - begun_s)
    log.info("checked in %.1f ms (median of %d)", 1e3 * statistics.median(times_s), CHECKS)
    assert statistics.median(times_s) < ALLOWED_S
