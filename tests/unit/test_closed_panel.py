"""What a refusal finds instead of an inlet: a closed cover by the groove around it, plain skin, or nothing certain."""

from __future__ import annotations

import numpy as np
import pytest

from controller.port_files import load_port
from controller.port_models import port_model
from perception.closed_panel import closed_panel
from perception.estimate import Prior
from perception.evaluation.scenes import simulate_scan
from perception.geometry import Array, Pose
from perception.locate import locate
from perception.scan import Cloud

PRIOR = Prior(Pose.identity(), lateral_m=0.02)
REF = Prior(Pose.from_rotvec([0.5, -1.0, 2.0], [0.2, 0.1, 0.6]), lateral_m=0.02)


def skin(noise_m: float = 1e-4, step_m: float = 0.0009) -> Array:
    """(N, 3) a slightly curved panel of 26 cm, port frame."""
    rng = np.random.default_rng(8)
    grid = np.arange(-0.13, 0.13, step_m)
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
    x, y = x + rng.uniform(-2e-4, 2e-4, x.shape), y + rng.uniform(-2e-4, 2e-4, y.shape)
    return np.column_stack([x, y, 0.02 + 0.4 * x * x - 0.2 * x * y + rng.normal(0.0, noise_m, x.shape)])


def square_distance(points: Array) -> Array:
    """(N,) half the side of the square around the origin on which each point lies."""
    return np.abs(points[:, :2]).max(axis=1)


def grooved(points: Array, half_m: float = 0.06, width_m: float = 0.003, share: float = 1.0) -> Array:
    """A closed cover: half of the groove's points are missing, the others lie 6 mm deeper."""
    from_hinge = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5 < share
    inside = (np.abs(square_distance(points) - half_m) < width_m / 2) & from_hinge
    deeper = points - np.array([0.0, 0.0, 0.006]) * inside[:, None]
    return deeper[~inside | (np.arange(len(points)) % 2 == 0)]


def opened(points: Array, half_m: float = 0.045) -> Array:
    """A recess of 30 mm."""
    return points - np.array([0.0, 0.0, 0.03]) * (square_distance(points) < half_m)[:, None]


@pytest.mark.parametrize("prior", [PRIOR, REF], ids=["at the origin", "in the scanner's frame"])
def test_skin_with_a_groove_around_is_a_closed_cover_and_without_is_no_port(prior: Prior) -> None:
    to_ref = prior.T_ref_port.apply
    assert closed_panel(to_ref(grooved(skin())), prior) == "closed-cover"
    assert closed_panel(to_ref(skin()), prior) == "no-port"


@pytest.mark.parametrize("noise_m", [1e-4, 3e-4, 6e-4])
def test_noise_alone_makes_no_groove(noise_m: float) -> None:
    assert closed_panel(skin(noise_m), PRIOR) == "no-port"


def test_a_recess_is_neither() -> None:
    assert closed_panel(opened(skin()), PRIOR) is None
    assert closed_panel(grooved(opened(skin()), 0.09), PRIOR) is None


def test_a_line_along_one_side_is_a_gap_of_the_body_and_no_cover() -> None:
    assert closed_panel(grooved(skin(), share=0.25), PRIOR) != "closed-cover"


def test_few_points_or_no_sheet_say_nothing() -> None:
    assert closed_panel(skin()[:50], PRIOR) is None
    cloud = np.random.default_rng(0).uniform(-0.1, 0.1, (3000, 3)) * [1, 1, 0.8]
    assert closed_panel(cloud, PRIOR) is None


@pytest.mark.parametrize(("kind", "said"), [("closed-cover", "a closed charging cover"), ("plain", "nothing opens")])
def test_the_locator_says_so_in_verdict_and_reasons(kind: str, said: str) -> None:
    scan = simulate_scan(load_port("type2").shape, "easy", np.random.default_rng([7, 1]), negative=kind)  # type: ignore[arg-type]
    estimate = locate(scan.cloud, port_model("type2"), scan.prior)
    assert not estimate.accepted
    assert estimate.verdict == {"plain": "no-port"}.get(kind, kind)
    assert said in estimate.reasons[0]
    assert sum(s for step, s in estimate.timings_s if step != "total") == pytest.approx(estimate.elapsed_s, rel=0.05)
    nothing = locate(Cloud(scan.cloud.points[:20]), port_model("type2"), scan.prior)
    assert nothing.verdict == "no-port" and said not in nothing.reasons[0]
