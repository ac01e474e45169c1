"""Moving clouds: many points as few."""

from __future__ import annotations

import numpy as np

from perception.geometry import PACKED_AT_MOST, Pose


def test_many_points_are_moved_as_few_are_and_fill_no_buffers_of_blas() -> None:
    """OpenBLAS never gives its buffers back; matrices of other sizes fill other parts of them."""
    rng = np.random.default_rng(0)
    pose = Pose.from_rotvec(rng.normal(size=3), rng.normal(size=3))
    points = rng.normal(size=(PACKED_AT_MOST + 1, 3))
    one_by_one = [pose.apply(point) for point in points[::5000]]
    np.testing.assert_allclose(pose.apply(points)[::5000], one_by_one, atol=1e-14)
    few = points[:PACKED_AT_MOST]
    np.testing.assert_allclose(pose.apply(points)[:PACKED_AT_MOST], pose.apply(few), atol=1e-14)
    np.testing.assert_allclose(pose.rotate(points)[-1], pose.rotate(points[-1]), atol=1e-14)
