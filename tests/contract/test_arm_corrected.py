"""An arm whose errors are known, over the wire: the true TCP goes where it is wanted, the wire has the arm's word."""

from __future__ import annotations

import numpy as np
import pytest

from perception.evaluation.calibration_cells import Chain
from perception.geometry import Pose
from tests.arm_rig import T_FLANGE_TCP, Rig

LENGTHS_A, LENGTHS_D = [0, -2e-4, 1.5e-4, 0, 0, 0], [1e-4, 0, 0, -2e-4, 1e-4, 2e-4]
ZEROS, GIVE = [2e-4, 3e-4, -3e-4, 2e-4, -2e-4, 1e-4], 3e-6
ERRORS = np.array([*LENGTHS_A, *LENGTHS_D, *ZEROS, GIVE])
LOAD_KG = 3.0
"""As the simulated chain carries it."""


@pytest.fixture(scope="module")
def rig():
    made = Rig(errors=ERRORS, payload_kg=LOAD_KG)
    yield made
    made.close()


def true_tcp(rig: Rig) -> Pose:
    """By a chain that truly has these errors, at the joints that the emulated controller is at."""
    q = np.array(rig.mock.state()["q"])
    rows = Chain.nominal().rows.copy()
    rows[:, 0] += ERRORS[:6]
    rows[:, 2] += ERRORS[6:12]
    return Chain(rows).flange(q + ERRORS[12:18] + ERRORS[18] * Chain.nominal().torques(q)) @ T_FLANGE_TCP


@pytest.mark.parametrize("way", ["line", "joints"])
def test_the_true_tcp_ends_where_it_is_wanted_and_the_arm_is_told_another_pose(rig: Rig, way: str) -> None:
    target = rig.arm.state().T_base_tcp @ Pose.from_vector([0.02, 0.03, 0.04, 0.05, 0.0, 0.1])
    motion_id = rig.arm.move_linear(target, 0.2, 1.0) if way == "line" else rig.arm.move_joints(target, 0.8, 2.0)
    progress = rig.finish(motion_id)
    assert not progress.failed, progress.detail
    assert true_tcp(rig).distance_to(target) < 5e-5  # the emulated controller ends within 1e-4 of what it is told
    told = Pose.from_vector(rig.mock.state()["tcp"])
    assert told.distance_to(target) > 1e-4
    assert Pose.from_vector(rig.sink.commands[-1].arguments[:6]).distance_to(told) < 5e-5


def test_states_are_true_to_the_caller_and_as_read_in_the_recording(rig: Rig) -> None:
    state = rig.arm.state()
    assert state.T_base_tcp.distance_to(true_tcp(rig)) < 5e-6
    assert rig.arm.history(state.time_s - 1.0)[-1].T_base_tcp.distance_to(true_tcp(rig)) < 5e-6
    assert rig.sink.states[-1].T_base_tcp.distance_to(Pose.from_vector(rig.mock.state()["tcp"])) < 5e-6
