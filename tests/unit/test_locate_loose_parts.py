"""What the standard leaves to the makers (flange, floors) decides nothing about a type2 or ccs2."""

from __future__ import annotations

import numpy as np

from controller.port_files import bundled_ports, load_port
from controller.port_models import port_model
from perception.flats import Flats, near_any
from perception.port_model import PortModel
from perception.port_solid import build_mesh

FLANGE_M, BOLT_HOLES_M = -0.0065, -0.0105


def test_heights_are_told_apart_by_less_than_any_flats_differ() -> None:
    assert near_any(np.array([-0.0065, -0.0061, 0.0]), (-0.0065, -0.0495)).tolist() == [True, False, False]
    assert not near_any(np.array([0.0, -0.1]), ()).any()


def test_a_silent_level_tells_of_no_edge_and_does_not_silence_one_that_it_is_merged_with() -> None:
    distance = np.array([[[-1.0, -1.0], [1.0, 1.0]], [[1.0, -1.0], [1.0, -1.0]]], dtype=np.float16)
    flats = Flats(np.zeros(2), np.array([-0.0065, -0.006]), distance).without([-0.0065])
    assert np.isnan(flats.distance[0]).all() and (flats.distance[1] == distance[1]).all()
    assert (flats.merged(0.001).distance[0] == distance[1]).all()


def test_around_the_rim_a_loose_flat_belongs_to_the_port_no_more_and_within_it_all_stays() -> None:
    plain = PortModel.from_mesh("ccs2", *build_mesh(load_port("ccs2").shape))
    marked = port_model("ccs2")
    gone = np.isfinite(plain.front.highest) & ~np.isfinite(marked.front.highest)
    assert gone.sum() > 5000
    heights = np.column_stack([plain.front.highest[gone], plain.front.lowest[gone]])
    off_m = np.minimum(np.abs(heights - FLANGE_M), np.abs(heights - BOLT_HOLES_M))
    assert off_m.min(axis=1).max() < 3e-4
    assert not (gone & plain.front.inner).any()
    assert (plain.front.inner == marked.front.inner).all()


def test_samples_of_loose_flats_decide_nothing_and_all_others_do() -> None:
    model = port_model("ccs2")
    on_flange = (np.abs(model.surface.points[:, 2] - FLANGE_M) < 1e-4) & (model.surface.normals[:, 2] > 0.97)
    assert on_flange.sum() > 500
    assert not model.decides[on_flange].any()
    on_rim = np.abs(model.surface.points[:, 2]) < 1e-5
    assert model.decides[on_rim].all()


def test_every_bundled_port_keeps_enough_that_decides() -> None:
    for name in bundled_ports():
        model = port_model(name)
        assert model.decides.mean() > 0.4, name
        assert np.isfinite(model.front.highest).sum() * 0.0005**2 > 0.001, name
