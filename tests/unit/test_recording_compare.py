"""A replay is judged by the first difference: small enough numbers are the same, anything else is named."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from controller.cli.recording import app
from controller.recording.compare import first_difference
from controller.recording.reader import Recording, read_recording
from controller.recording.recorder import Recorder
from drivers.base import ArmCommandRecord
from perception.geometry import Pose
from tests.unit.recording_samples import ManualClock, estimate, new_recorder

Change = Callable[[Recorder], None]
MOVE = ArmCommandRecord(1.0, "moveL", (0.5, 0.1, 0.3, 0.0, 3.1, 0.0, 0.05, 0.2), "accepted")


def mission(
    path: Path, *, states: tuple[str, ...] = ("READY", "STAGING"), pose: Pose | None = None, **changes: object
) -> Recording:
    """A small mission on a clock of its own; what is given replaces the standard."""
    recorder = new_recorder(path, ManualClock(float(changes.get("start_s", 100.0))))  # type: ignore[arg-type]
    for before, after in pairwise(states):
        recorder.transition(before, "e", after, 0.0)
    located = estimate(accepted=bool(changes.get("accepted", True)))
    recorder.estimate(located if pose is None else replace(located, T_ref_port=pose))
    recorder.command("MoveL", "to A", bool(changes.get("allowed", True)), "too fast")
    command = changes.get("command", MOVE)
    assert isinstance(command, ArmCommandRecord)
    recorder.arm_command(command)
    recorder.close()
    return read_recording(path)


@pytest.fixture
def standard(tmp_path: Path) -> Recording:
    return mission(tmp_path / "standard.mcap")


def test_the_same_mission_at_another_time_is_the_same(standard: Recording, tmp_path: Path) -> None:
    assert first_difference(standard, mission(tmp_path / "m.mcap", start_s=5000.0)) is None


def moved(metres: float = 0.0, radians: float = 0.0) -> Pose:
    return estimate().T_ref_port @ Pose.from_vector([metres, 0, 0, radians, 0, 0])


@pytest.mark.parametrize("pose", [moved(0.9e-6), moved(radians=0.9e-6)])
def test_a_pose_within_a_micrometre_is_the_same(standard: Recording, tmp_path: Path, pose: Pose) -> None:
    assert first_difference(standard, mission(tmp_path / "m.mcap", pose=pose)) is None


@pytest.mark.parametrize("pose", [moved(1.2e-6), moved(radians=1.2e-6)])
def test_a_pose_beyond_a_micrometre_is_a_difference(standard: Recording, tmp_path: Path, pose: Pose) -> None:
    difference = first_difference(standard, mission(tmp_path / "m.mcap", pose=pose))
    assert difference is not None
    assert difference.what == "estimate"


def test_another_state_is_named_before_all_that_follows_from_it(standard: Recording, tmp_path: Path) -> None:
    other = mission(tmp_path / "m.mcap", states=("READY", "STAGING", "FAULT"), accepted=False, allowed=False)
    assert str(first_difference(standard, other)) == "state 2: expected nothing, got STAGING -> FAULT (e)"


def test_another_answer_of_the_gate_is_a_difference(standard: Recording, tmp_path: Path) -> None:
    other = mission(tmp_path / "m.mcap", allowed=False)
    assert str(first_difference(standard, other)) == ("decision 1: expected MoveL allowed, got MoveL refused: too fast")


@pytest.mark.parametrize(
    ("command", "same"),
    [
        (replace(MOVE, time_s=9.0), True),
        (replace(MOVE, arguments=(*MOVE.arguments[:-1], 0.2 + 5e-7)), True),
        (replace(MOVE, arguments=(*MOVE.arguments[:-1], 0.2 + 5e-6)), False),
        (replace(MOVE, arguments=MOVE.arguments[:-1]), False),
        (replace(MOVE, result="rejected"), False),
        (replace(MOVE, name="moveJ"), False),
    ],
)
def test_arm_commands_are_the_same_within_tolerance(
    standard: Recording, tmp_path: Path, command: ArmCommandRecord, same: bool
) -> None:
    difference = first_difference(standard, mission(tmp_path / "m.mcap", command=command))
    assert (difference is None) == same
    if difference is not None:
        assert difference.what == "arm command"


def test_commands_with_numbers_that_are_not_finite_can_be_compared(tmp_path: Path) -> None:
    command = replace(MOVE, arguments=(np.nan,))
    one, other = (mission(tmp_path / name, command=command) for name in ("a.mcap", "b.mcap"))
    assert first_difference(one, other) is None


def test_the_command_line_says_it_and_exits_accordingly(standard: Recording, tmp_path: Path) -> None:
    other = mission(tmp_path / "m.mcap", accepted=False)
    same = CliRunner().invoke(app, ["compare", str(standard.path), str(standard.path)])
    assert (same.exit_code, same.output.strip()) == (0, "no difference")
    different = CliRunner().invoke(app, ["compare", str(standard.path), str(other.path)])
    assert different.exit_code == 1
    assert different.output.startswith("estimate 1: expected ccs2 accepted (port) at (800.0000, 100.0000, 500.0000) mm")
