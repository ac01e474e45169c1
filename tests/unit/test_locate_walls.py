"""How noisy walls are is read off the scan: a gate too narrow for them throws good points away."""

from __future__ import annotations

import numpy as np
import pytest

from perception.matching import Matches
from perception.residuals import wall_scale


def walls(noise_m: float, count: int = 2000) -> Matches:
    rng = np.random.default_rng(3)
    normal = np.tile([0.0, 1.0, 0.0], (count, 1))
    zero = np.zeros((count, 3))
    number = np.arange(count)
    return Matches(zero, number, normal, noise_m * rng.standard_normal(count), number, zero, np.full(count, 0.15))


@pytest.mark.parametrize("share", [0.5, 0.85, 1.0])
def test_the_noise_of_walls_is_found_whatever_it_is_on_flats(share: float) -> None:
    assert wall_scale(walls(share * 1e-4), 1e-4) == pytest.approx(share * 1e-4, rel=0.06)


def test_mixed_pixels_do_not_make_walls_worse_than_flats_by_much() -> None:
    assert wall_scale(walls(4e-4), 1e-4) <= 1.2e-4


def test_few_points_are_taken_for_as_noisy_as_flats() -> None:
    assert wall_scale(walls(2e-5, count=10), 1e-4) == pytest.approx(1e-4)
