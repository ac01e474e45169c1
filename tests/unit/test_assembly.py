"""Which pose of the mated plug a mission docks to."""

from __future__ import annotations

import numpy as np

from controller.assembly import mated_pose
from controller.config import parse_config
from controller.port_files import load_port


def test_the_plug_mates_as_taught_at_the_site_else_as_the_port_is_described() -> None:
    assert mated_pose(parse_config({})).distance_to(load_port("ccs2").T_port_tcp) == 0.0
    taught = mated_pose(parse_config({"port": {"T_port_tcp": {"xyz_mm": [0.4, -0.2, -31.0]}}}))
    np.testing.assert_allclose(taught.translation, [0.0004, -0.0002, -0.031])
