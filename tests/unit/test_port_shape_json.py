"""Shapes as text: what is read back is what was written."""

from __future__ import annotations

import json

import pytest

from controller.port_files import bundled_ports, load_port
from perception.port_shape_json import shape_from_json, shape_to_json


@pytest.mark.parametrize("name", bundled_ports())
def test_every_bundled_shape_survives_the_round_trip(name: str) -> None:
    shape = load_port(name).shape
    assert shape_from_json(shape_to_json(shape)) == shape


@pytest.mark.parametrize("text", ["{}", '{"type": "os.system"}', '{"type": "Disc", "diameter_m": 0.05}', "[]"])
def test_other_text_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"shape|part"):
        shape_from_json(json.dumps(json.loads(text)))
