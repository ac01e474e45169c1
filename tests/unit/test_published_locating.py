"""The published method behind ``portdock locate``: accepted only where the fit earns it."""

import numpy as np
import pytest

from controller.port_models import port_model
from perception.estimate import Prior
from perception.geometry import Pose
from perception.published.pipeline import locate_published
from perception.scan import Cloud

TRUE = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.004, -0.012, 0.32])) @ Pose.from_rotvec([0.05, -0.04, 0.06])
PRIOR = Prior(Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, -0.02, 0.315])))


@pytest.fixture(scope="module")
def model():
    return port_model("ccs2")


def scan_of(points, seed=0):
    rng = np.random.default_rng(seed)
    return Cloud(TRUE.apply(points + rng.normal(0, 0.0001, points.shape)))


def surface(model):
    facing = model.surface.normals[:, 2] > 0.15  # what a scanner in front sees well
    return model.surface.points[facing]


def test_robust_finds_the_port_and_is_accepted(model):
    estimate = locate_published(scan_of(surface(model)), model, PRIOR, "robust")
    assert estimate.accepted, estimate.reasons
    assert estimate.T_ref_port.distance_to(TRUE) < 0.0005
    assert np.rad2deg(estimate.T_ref_port.angle_to(TRUE)) < 0.5
    assert [step for step, _ in estimate.timings_s] == ["prepare", "register", "judge", "total"]


@pytest.mark.parametrize("profile", ["literal", "faithful"])
def test_a_profile_without_dense_step_never_passes_on_a_pose_that_is_off(model, profile):
    estimate = locate_published(scan_of(surface(model)), model, PRIOR, profile)
    near = estimate.T_ref_port.distance_to(TRUE) < 0.001 and estimate.T_ref_port.angle_to(TRUE) < np.deg2rad(1.0)
    assert near or not estimate.accepted
    assert estimate.reasons
    if profile == "literal":
        assert not estimate.accepted
        assert "kappa" in estimate.reasons[0]


@pytest.mark.parametrize(
    "points",
    [
        np.c_[np.random.default_rng(1).uniform(-0.06, 0.06, (6000, 2)), np.zeros(6000)],
        np.random.default_rng(2).uniform(-0.05, 0.05, (6000, 3)),
        np.full((6000, 3), 1.0),
    ],
    ids=["panel", "clutter", "elsewhere"],
)
def test_what_is_no_port_is_refused_with_a_reason(model, points):
    estimate = locate_published(scan_of(points), model, PRIOR, "robust")
    assert not estimate.accepted
    assert estimate.reasons
