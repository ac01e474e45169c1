"""A model that is right in plan and wrong in depth is refused: its flats lie elsewhere, each against the others."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from controller.port_files import load_port
from controller.port_models import port_model
from perception.covariance import BUILT_M
from perception.depths import FLOOR_M, depth_dispute
from perception.evaluation.locate_cases import make_scan, positive_cases
from perception.gate import MAX_DEPTH_DISPUTE_M
from perception.geometry import Array, Pose
from perception.locate import locate
from perception.matching import Measured
from perception.port_model import PortModel
from perception.port_shape import PortShape
from perception.port_solid import build_mesh, loose_heights_m

SHAPE = load_port("ccs2").shape
POSE = Pose.from_rotvec([0.1, -0.05, 0.2], [0.01, -0.02, 0.005])
NOISE_M = 0.0001


@lru_cache
def model() -> PortModel:
    return PortModel.from_mesh("ccs2", *build_mesh(SHAPE))


def dispute(change: Array, seen: Array | None = None, of: PortModel | None = None) -> float:
    """In a scan that is the model's own samples, moved along the axis by ``change`` (M,)."""
    surface = model().surface
    points = surface.points + np.column_stack([np.zeros((len(change), 2)), change])
    chosen = np.ones(len(points), dtype=bool) if seen is None else seen
    normals = POSE.rotate(surface.normals[chosen])
    measured = Measured(POSE.apply(points[chosen]), normals, np.zeros((int(chosen.sum()), 3)))
    return depth_dispute(POSE, measured, (of or model()).flats, NOISE_M)


def on_rim() -> Array:
    return np.abs(model().surface.points[:, 2]) < 1e-5


def test_a_port_as_drawn_and_noise_are_no_dispute() -> None:
    noise = np.random.default_rng(1).normal(0.0, NOISE_M, len(model().surface))
    assert dispute(np.zeros(len(noise))) == pytest.approx(0.0, abs=1e-5)
    assert abs(dispute(noise)) < 0.5 * NOISE_M


@pytest.mark.parametrize("off_m", [-0.002, 0.0015])
def test_a_rim_that_lies_elsewhere_is_told_with_its_sign(off_m: float) -> None:
    assert dispute(np.where(on_rim(), off_m, 0.0)) == pytest.approx(off_m, abs=1e-4)


def test_a_flat_that_every_make_has_elsewhere_is_no_dispute() -> None:
    port = load_port("ccs2")
    assert {-0.0065, -0.0495} <= set(loose_heights_m(port)), "flange and floor"
    assert not {0.0, -0.002} & set(loose_heights_m(port)), "rim and insert"
    assert port_model("ccs2").loose_heights_m == loose_heights_m(port)
    on_flange = np.abs(model().surface.points[:, 2] + 0.0065) < 1e-5
    lower = np.where(on_flange, -0.0015, 0.0)
    assert dispute(lower) == pytest.approx(-0.0015, abs=1e-4)
    assert dispute(lower, of=port_model("ccs2")) == pytest.approx(0.0, abs=1e-4)


def test_how_deep_a_floor_lies_is_no_dispute() -> None:
    on_floor = model().surface.points[:, 2] < -FLOOR_M
    assert on_floor.sum() > 1000
    assert dispute(np.where(on_floor, -0.0015, 0.0)) == pytest.approx(0.0, abs=1e-4)


def test_a_little_of_a_flat_and_what_is_not_even_tell_nothing() -> None:
    x, y, _ = model().surface.points.T
    patch = on_rim() & (np.hypot(x - x[on_rim()].max(), y) < 0.004)
    assert dispute(np.where(patch, -0.002, 0.0), ~on_rim() | patch) == pytest.approx(0.0, abs=1e-4)
    uneven = np.random.default_rng(2).uniform(-0.003, 0.003, len(x))
    assert dispute(np.where(on_rim(), uneven, 0.0)) == pytest.approx(0.0, abs=1e-4)


def deeper(shape: PortShape, by_m: float) -> PortShape:
    """All but the rim."""
    assert shape.flange is not None
    return replace(
        shape,
        flange=replace(shape.flange, front_depth_m=shape.flange.front_depth_m + by_m),
        cavity=replace(shape.cavity, depth_m=shape.cavity.depth_m + by_m),
        inserts=tuple(replace(insert, face_depth_m=insert.face_depth_m + by_m) for insert in shape.inserts),
        contacts=tuple(replace(contact, tip_depth_m=contact.tip_depth_m + by_m) for contact in shape.contacts),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("by_m", "accepted"), [(0.002, False), (0.0004, True)])
def test_a_template_whose_depths_are_wrong_is_refused_or_as_uncertain_as_it_is_wrong(
    by_m: float, accepted: bool
) -> None:
    case = next(case for case in positive_cases(8, ["ccs2"], ("nominal",)))
    scan = make_scan(case, 12, {"ccs2": SHAPE})
    wrong = PortModel.from_mesh("ccs2", *build_mesh(deeper(SHAPE, by_m)))
    found = locate(scan.cloud, wrong, scan.prior)
    assert found.accepted is accepted
    if not accepted:
        assert any("than the model has it: check its depths" in reason for reason in found.reasons)
        return
    assert by_m < MAX_DEPTH_DISPUTE_M
    off_m = abs((scan.T_scanner_port.inverse() @ found.T_ref_port).translation[2])  # type: ignore[union-attr]
    assert off_m < 3.0 * float(np.sqrt(found.covariance[2, 2]))
    assert np.sqrt(found.covariance[2, 2]) > 0.8 * (by_m - BUILT_M)


@pytest.mark.slow
@pytest.mark.parametrize("by_m", [0.0035, -0.0025])
def test_another_makes_flange_neither_refuses_the_port_nor_moves_it(by_m: float) -> None:
    assert SHAPE.flange is not None
    other = replace(SHAPE, flange=replace(SHAPE.flange, front_depth_m=SHAPE.flange.front_depth_m + by_m))
    case = positive_cases(16, ["ccs2"], ("nominal",))[1]
    scan = make_scan(case, 12, {"ccs2": other})
    found = locate(scan.cloud, port_model("ccs2"), scan.prior)
    assert scan.T_scanner_port is not None
    assert found.accepted, found.reasons
    assert found.T_ref_port.distance_to(scan.T_scanner_port) < 0.00015
