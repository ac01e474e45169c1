"""Where a port's flats end holds it sideways and in roll: the maps of its edges, and what is done with them."""

from __future__ import annotations

import numpy as np
import pytest

from controller.port_models import port_model
from perception.flats import REACH_M, Flats, build_flats
from perception.geometry import Array, Pose
from perception.matching import Measured
from perception.sideways import settle_sideways


def block(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[Array, Array]:
    """The top and bottom faces of a box: vertices (8, 3) and faces (4, 3)."""
    corners = [(x, y, z) for z in (low[2], high[2]) for x, y in ((low[0], low[1]), (high[0], low[1]), high[:2])]
    corners += [(low[0], high[1], low[2]), (low[0], high[1], high[2])]
    faces = [(0, 1, 2), (0, 2, 6), (3, 4, 5), (3, 5, 7)]
    return np.array(corners), np.array(faces)


@pytest.fixture(scope="module")
def steps() -> Flats:
    """A plate of 40 by 40 mm with a block of 10 by 10 mm on it, 2 mm high."""
    plate, plate_faces = block((-0.02, -0.02, -0.004), (0.02, 0.02, -0.002))
    pin, pin_faces = block((-0.005, -0.005, -0.002), (0.005, 0.005, 0.0))
    return build_flats(np.vstack([plate, pin]), np.vstack([plate_faces, pin_faces + len(plate)]))


def test_each_height_is_a_level(steps: Flats) -> None:
    assert np.allclose(steps.heights, [-0.002, 0.0], atol=1e-5)


def test_the_distance_to_an_edge_is_negative_on_the_flat_and_its_gradient_leads_away(steps: Flats) -> None:
    level, xy = np.array([1, 1]), np.array([[0.004, 0.0], [0.0, 0.0062]])
    assert np.allclose(steps.beyond(level, xy), [-0.001, 0.0012], atol=1e-4)
    assert np.allclose(steps.outward(level, xy), [[1.0, 0.0], [0.0, 1.0]], atol=0.05)


def test_beside_the_port_nothing_is_known(steps: Flats) -> None:
    assert np.isnan(steps.beyond(np.array([0, 0]), np.array([[0.021, 0.0], [1.0, 1.0]]))).all()


def test_levels_that_noise_hides_are_one_whose_edges_are_those_of_both(steps: Flats) -> None:
    one = steps.merged(0.003)
    assert len(one.heights) == 1
    assert one.beyond(np.array([0]), np.array([[0.0062, 0.0]]))[0] < -REACH_M / 4


@pytest.mark.parametrize("roll_deg", [-12.0, 7.0])
def test_a_port_seen_straight_on_is_moved_and_rolled_to_where_its_edges_are(roll_deg: float) -> None:
    model = port_model("type2")
    # The floor is left out: most of it lies in the shadow of rim and pins for who looks straight on.
    flat = (model.surface.normals[:, 2] > 0.97) & (model.surface.points[:, 2] > -0.012)
    points, normals = model.surface.points[flat], model.surface.normals[flat]
    measured = Measured(points, normals, np.tile([0.0, 0.0, 0.3], (len(points), 1)))
    start = Pose.from_rotvec([0.0, 0.0, np.deg2rad(roll_deg)], [0.0008, -0.0006, 0.0])
    settled = settle_sideways(start, measured, model, 0.0001)
    assert settled.distance_to(Pose.identity()) < 0.0001
    assert np.rad2deg(settled.angle_to(Pose.identity())) < 0.5
