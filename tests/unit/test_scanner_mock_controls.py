"""Faults of the mock scanner's line can be switched while it runs."""

from __future__ import annotations

import io
import time

import numpy as np
import pytest

from mocks.scanner.controls import changed, listen
from mocks.scanner.wire_faults import FaultRates, WireFaults


def test_a_line_changes_what_it_names_and_nothing_else() -> None:
    assert changed(FaultRates(lost=0.1), '{"flipped": 0.5}') == FaultRates(lost=0.1, flipped=0.5)


@pytest.mark.parametrize("line", ["", "[]", '{"melted": 1}', "{"])
def test_a_line_that_is_none_is_refused(line: str) -> None:
    with pytest.raises((ValueError, TypeError)):
        changed(FaultRates(), line)


def test_lines_reach_the_wire_and_a_bad_one_harms_nothing() -> None:
    faults = WireFaults(FaultRates(), np.random.default_rng(1))
    listen(faults, io.StringIO('nonsense\n{"flipped": 1.0}\n'))
    end_s = time.monotonic() + 10.0
    while faults.rates.flipped == 0.0 and time.monotonic() < end_s:
        time.sleep(0.001)
    assert faults.spoil(b"\x00" * 100, 0.0, False).count(0) == 0
