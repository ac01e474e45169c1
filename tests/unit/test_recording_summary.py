"""The object that ``--json`` prints is a contract with scripts: its keys, order of states and nulls."""

import json
from pathlib import Path

import numpy as np

from controller.summary import ContactSummary, LocateSummary, MissionSummary


def full_summary() -> MissionSummary:
    return MissionSummary(
        outcome="charged",
        fault=None,
        remedy="",
        states=(("SELF_CHECK", 0.5), ("READY", 0.25)),
        attempts=2,
        locate=LocateSummary(True, 0.31, float("nan"), 1.5, ("all checks passed",)),
        contact=ContactSummary(0.2, 0.4, 0.1, 0.3, float(np.float64(61.0))),
        recording=Path("runs/one/mission.mcap"),
        report=None,
    )


def test_json_object_has_the_keys_of_the_interface_and_nothing_else() -> None:
    assert full_summary().to_json() == {
        "outcome": "charged",
        "fault": None,
        "states": [["SELF_CHECK", 0.5], ["READY", 0.25]],
        "attempts": 2,
        "locate": {
            "accepted": True,
            "error_mm": 0.31,
            "error_deg": None,
            "elapsed_s": 1.5,
            "reasons": ["all checks passed"],
        },
        "contact": {"along_mm": 0.2, "lateral_mm": 0.4, "roll_deg": 0.1, "tilt_deg": 0.3, "peak_force_n": 61.0},
        "recording": "runs/one/mission.mcap",
        "report": None,
    }


def test_json_object_is_strict_json_even_with_numbers_that_are_not_finite() -> None:
    text = json.dumps(full_summary().to_json(), allow_nan=False)
    assert json.loads(text)["locate"]["error_deg"] is None


def test_a_mission_that_never_scanned_has_no_locate_and_no_contact() -> None:
    values = MissionSummary("fault", "link-open", "Check the cable.", (), 0).to_json()
    assert values["locate"] is None
    assert values["contact"] is None
    assert values["states"] == []
