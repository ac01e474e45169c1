"""Capsule distances: against brute force, and on poses that anyone can see collide or not."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.arm.collision import Tool, clearance, intrusion, segment_box_distance, segment_distance
from drivers.arm.kinematics import MODELS, forward
from drivers.base import Box
from perception.geometry import Pose

UR10E = MODELS["ur10e"]
HOME = np.radians([20.0, -100.0, 110.0, -100.0, -90.0, 10.0])
TOOL = Tool((0.0, 0.0, 0.2))
coordinate = st.floats(-1.0, 1.0)
points = st.lists(coordinate, min_size=3, max_size=3).map(np.array)


def brute_segment(p1, q1, p2, q2) -> float:
    share = np.linspace(0, 1, 201)[:, None]
    first, second = p1 + share * (q1 - p1), p2 + share * (q2 - p2)
    return float(np.linalg.norm(first[:, None] - second[None], axis=2).min())


@given(points, points, points, points)
@settings(max_examples=150, deadline=None)
def test_segment_distance_is_the_smallest_between_any_two_points(p1, q1, p2, q2) -> None:
    exact = float(segment_distance(p1, q1, p2, q2))
    sampled = brute_segment(p1, q1, p2, q2)
    assert exact <= sampled + 1e-7
    assert sampled - exact < 0.02  # the sampling's own coarseness


@given(points, points)
@settings(max_examples=150, deadline=None)
def test_segment_box_distance_is_the_smallest_of_any_point(p, q) -> None:
    half = np.array([0.3, 0.2, 0.1])
    exact = float(segment_box_distance(p[None], q[None], half)[0])
    share = np.linspace(0, 1, 401)[:, None]
    line = p + share * (q - p)
    sampled = float(np.linalg.norm(np.maximum(np.abs(line) - half, 0), axis=1).min())
    assert abs(exact - sampled) < 0.01


def test_an_arm_at_work_is_clear_of_itself() -> None:
    for model in MODELS.values():
        assert clearance(model, HOME[None], Tool((0.0, 0.0, 0.1), 0.04)).distance_m > 0.0, model.name


def test_a_folded_arm_is_not() -> None:
    folded = HOME.copy()
    folded[2] = np.radians(175.0)  # the forearm back along the upper arm, the wrist into the shoulder
    found = clearance(UR10E, folded[None], TOOL)
    assert found.distance_m < 0.0


def test_the_worst_of_a_path_is_reported_with_its_place() -> None:
    folded = HOME.copy()
    folded[2] = np.radians(175.0)
    found = clearance(UR10E, np.stack([HOME, folded, HOME]), TOOL)
    assert found.sample == 1


def test_a_box_around_the_tip_is_met_by_the_tool_unless_it_may_touch() -> None:
    tip = forward(UR10E, HOME).moved(TOOL.tip)
    for may_touch, touches in ((False, True), (True, False)):
        panel = Box("panel", Pose(np.eye(3), tip.translation), (0.01, 0.01, 0.01), tool_may_touch=may_touch)
        found = clearance(UR10E, HOME[None], TOOL, (panel,))
        assert (found.what == "tool and panel") == touches
        assert (found.distance_m < 0.0) == touches


def test_distance_from_a_box_shrinks_as_the_box_comes_nearer() -> None:
    def gap(height: float) -> float:
        floor = Box("floor", Pose(np.eye(3), np.array([0.0, 0.0, height])), (2.0, 2.0, 0.01))
        found = clearance(UR10E, HOME[None], TOOL, (floor,))
        assert found.what.endswith("floor")
        return found.distance_m

    assert gap(0.05) > gap(0.08) > 0.0 > gap(0.3)


def test_bodies_too_near_already_excuse_no_others() -> None:
    tip = forward(UR10E, HOME).moved(TOOL.tip)
    around = Box("stand", Pose(np.eye(3), tip.translation), (0.02, 0.02, 0.02))
    turned = HOME + np.array([0.4, 0, 0, 0, 0, 0])
    ahead = Box("post", Pose(np.eye(3), forward(UR10E, turned).moved(TOOL.tip).translation), (0.01, 0.01, 0.01))
    path = HOME + np.linspace(0, 1, 40)[:, None] * (turned - HOME)
    assert intrusion(UR10E, path, TOOL, (around,), 0.0) is None, "it leaves what it overlaps"
    found = intrusion(UR10E, path, TOOL, (around, ahead), 0.0)
    assert found is not None and found.what == "tool and post"
    assert intrusion(UR10E, path[::-1], TOOL, (around,), 0.0) is not None


def test_a_whole_approach_takes_little_of_a_processor() -> None:
    joints = HOME + np.linspace(0, 0.5, 60)[:, None]
    boxes = tuple(Box(f"box {k}", Pose(np.eye(3), np.array([2.0, k, 0.0])), (0.3, 0.3, 0.3)) for k in range(3))
    clearance(UR10E, joints, TOOL, boxes)
    best = min(_timed(time.process_time, lambda: clearance(UR10E, joints, TOOL, boxes)) for _ in range(10))
    assert best < 0.02


def _timed(clock, action) -> float:
    begin = clock()
    action()
    return clock() - begin


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_model_has_a_shape(name) -> None:
    assert np.isfinite(clearance(MODELS[name], HOME[None], TOOL).distance_m)


def test_the_plug_passes_where_what_carries_it_would_not() -> None:
    """A wall beside the plug's last 50 mm, 40 mm off its axis; beside the wider part behind it the same wall is hit."""
    model, joints = MODELS["ur10e"], HOME[None]
    tool = Tool((0.0, 0.0, 0.2), radius=0.05, plug_length=0.06, plug_radius=0.03)
    T_base_flange = forward(model, HOME)

    def wall(from_m: float, to_m: float) -> Box:
        centre = Pose(np.eye(3), np.array([0.045, 0.0, (from_m + to_m) / 2]))
        return Box("wall", T_base_flange @ centre, (0.005, 0.05, (to_m - from_m) / 2))

    beside_plug = clearance(model, joints, tool, (wall(0.155, 0.205),))
    assert beside_plug.what == "plug and wall" and beside_plug.distance_m == pytest.approx(0.010, abs=1e-3)
    assert clearance(model, joints, tool, (wall(0.05, 0.09),)).distance_m == pytest.approx(-0.010, abs=1e-3)
    assert clearance(model, joints, Tool(tool.tip, tool.radius), (wall(0.155, 0.205),)).distance_m < 0.0
