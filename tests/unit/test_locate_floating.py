"""Contacts float: which of a port's features are contacts, and how little they fix when many points see them."""

from __future__ import annotations

import numpy as np
import pytest

from controller.port_files import bundled_ports, load_port
from controller.port_models import port_model
from perception.flats import CELL_M, Flats
from perception.floating import FLOAT_M


@pytest.mark.parametrize("name", bundled_ports())
def test_every_free_standing_contact_floats_and_nothing_else_does(name: str) -> None:
    model, shape = port_model(name), load_port(name).shape
    contacts = np.array([contact.centre_m for contact in shape.contacts])
    numbers = model.floating.at(contacts)
    floating = set(numbers[numbers > 0].tolist())
    everywhere = set(np.unique(model.floating.number).tolist()) - {0}
    assert everywhere == floating, "keys, floors and screw holes do not"
    if model.front.bores == 0:
        i, j, _ = model.front.cells(contacts)
        assert (numbers[model.front.feature[i, j] > 0] > 0).all()


def test_points_on_one_contact_say_no_more_than_where_it_may_be() -> None:
    model = port_model("type2")
    (centre,) = [contact.centre_m for contact in load_port("type2").shape.contacts if contact.name == "PE"]
    for count in (10, 100_000):
        xy = np.tile([centre[0], centre[1] + 0.003], (count, 1))
        weight = np.full(count, 1e8)
        share = model.floating.shares(xy, np.ones(count), weight)
        told = 0.5 * float((share * weight).sum())
        assert told < FLOAT_M**-2
        assert told > 0.5 * min(FLOAT_M**-2, 0.5 * float(weight.sum()))


def test_what_lies_elsewhere_or_faces_along_the_axis_keeps_its_weight() -> None:
    model = port_model("type2")
    contact = np.array(load_port("type2").shape.contacts[0].centre_m)
    xy = np.array([contact, contact + np.array([0.0, 0.1])])
    assert model.floating.shares(xy, np.array([0.0, 1.0]), np.full(2, 1e12)) == pytest.approx([1.0, 1.0])


def test_a_scan_that_meets_no_surface_has_no_weights() -> None:
    empty = np.zeros(0)
    assert len(port_model("type2").floating.shares(np.zeros((0, 2)), empty, empty)) == 0


def test_lenient_edges_are_contradicted_only_by_more_than_the_tolerance() -> None:
    x = (np.arange(81) - 40) * CELL_M
    level = np.repeat(1e3 * np.abs(x)[:, None] - 2.0, 81, axis=1)[None].astype(np.float32)  # a strip of +-2 mm
    strict = Flats(np.full(2, -40.5 * CELL_M), np.zeros(1), level)
    lenient = strict.lenient(np.ones(strict.shape, dtype=np.bool_), 0.0003)
    zero, places = np.zeros(3, np.int64), np.array([[0.0, 0.0], [0.0021, 0.0], [0.0028, 0.0]])
    assert strict.beyond(zero, places) == pytest.approx([-0.002, 0.0001, 0.0008], abs=2e-5)
    assert lenient.beyond(zero, places) == pytest.approx([-0.0017, 0.0, 0.0005], abs=2e-5)
    untouched = strict.lenient(np.zeros(strict.shape, dtype=np.bool_), 0.0003)
    assert untouched.beyond(zero, places) == pytest.approx(strict.beyond(zero, places))
