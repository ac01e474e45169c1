"""Peers get of the CAD what a scan shows of it, and no pairs that no pose of the prior brings together."""

from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest

from controller.port_files import load_port
from perception.estimate import Prior
from perception.evaluation.locate_peer_cad import cloud_of, peer_cad
from perception.evaluation.locate_peer_matches import _allowed
from perception.geometry import Array, Pose
from perception.port_model import PortModel
from perception.port_solid import build_mesh


def facing(cloud: o3d.geometry.PointCloud) -> Array:
    return np.asarray(cloud.normals)[:, 2]


def test_the_walls_that_no_sweep_shows_are_in_the_samples_and_not_in_what_is_seen() -> None:
    cad = peer_cad(PortModel.from_mesh("type2", *build_mesh(load_port("type2").shape)))
    assert (facing(cad.samples) < 0.5).mean() > 0.4
    assert (facing(cad.seen) < 0.5).mean() < 0.2
    assert (facing(cad.seen) > 0).mean() > 0.99
    away = cad.tree.query(np.asarray(cad.seen.points))[0]
    assert np.quantile(away, 0.95) < 0.002


@pytest.mark.parametrize(
    ("off", "normal", "kept"),
    [
        ([0.03, 0.0, 0.02], [0.0, 0.0, 1.0], True),
        ([0.06, 0.0, 0.0], [0.0, 0.0, 1.0], False),
        ([0.0, 0.0, 0.06], [0.0, 0.0, 1.0], False),
        ([0.03, 0.0, 0.0], [0.0, 1.0, 0.0], False),
    ],
)
def test_a_pair_is_kept_only_where_the_prior_lets_it_meet(off: list[float], normal: list[float], kept: bool) -> None:
    here = np.array([[0.01, 0.0, 0.0]])
    source, target = cloud_of(here, np.array([[0.0, 0.0, 1.0]])), cloud_of(here + off, np.array([normal]))
    pairs = np.array([[0, 0]])
    assert _allowed(source, target, pairs, Prior(Pose.identity(), 0.04, 0.03)).tolist() == [kept]
