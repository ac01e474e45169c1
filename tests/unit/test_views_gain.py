"""The table of ``evaluate views``: one row for each arm, integrity and way, counted from the trials."""

from __future__ import annotations

import numpy as np

from perception.evaluation.views_gain import ARMS, INTEGRITIES, WAYS, ViewsTrial, table


def trial(error_mm: float, error_deg: float, accepted: bool) -> ViewsTrial:
    return ViewsTrial("calibrated", 0.65, "ccs2", "registration", error_mm / 1e3, np.deg2rad(error_deg), accepted)


def test_success_is_a_millimetre_and_half_a_degree_whether_accepted_or_not() -> None:
    trials = [trial(0.9, 0.4, False), trial(1.1, 0.1, True), trial(0.1, 0.6, True), trial(0.2, 0.2, True)]
    rows = table(trials).splitlines()[2:]
    assert len(rows) == len(ARMS) * len(INTEGRITIES) * len(WAYS)
    (row,) = [row for row in rows if row.startswith("| calibrated | 65% | registration |")]
    assert "| 2/4 = 50.0% [6.8%, 93.2%] | 3 | 0.550 |" in row
    assert sum("| - | 0 |" in row for row in rows) == len(rows) - 1
