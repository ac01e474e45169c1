"""The inlet from separate code that the locator is evaluated on beside the bundled ports."""

from __future__ import annotations

import numpy as np
import pytest

from perception.estimate import Prior
from perception.evaluation import other_family
from perception.evaluation.built import TYPICAL, BuiltTolerance
from perception.evaluation.families import OTHERS, built_part, drawn_mesh
from perception.evaluation.locate_cases import make_scan, negative_cases, positive_cases
from perception.evaluation.scene import is_mirror_symmetric
from perception.locate import locate
from perception.port_model import PortModel
from perception.port_solid import PARTS, PortMesh

SHAPE = OTHERS[other_family.NAME]


def heights(mesh: PortMesh, part: str) -> np.ndarray:  # type: ignore[type-arg]
    return mesh.vertices[np.unique(mesh.faces[mesh.part == PARTS.index(part)]), 2]


def test_its_drawing_is_a_closed_surface_with_every_part() -> None:
    mesh = other_family.drawing()
    edges = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert set(mesh.part) == set(range(len(PARTS)))
    assert mesh.vertices[:, 2].max() == pytest.approx(0.0, abs=1e-9), "the rim plane"


def test_what_the_vehicle_is_told_of_it_is_what_the_drawing_has() -> None:
    mesh = other_family.drawing()
    assert heights(mesh, "floor").min() == pytest.approx(-SHAPE.cavity.depth_m, abs=1e-5)
    assert heights(mesh, "pin").max() == pytest.approx(-SHAPE.contacts[0].tip_depth_m, abs=1e-5)
    assert heights(mesh, "insert").max() == pytest.approx(-SHAPE.inserts[0].face_depth_m, abs=1e-5)
    assert not is_mirror_symmetric(SHAPE)


def test_its_key_stands_at_the_wall_and_fills_no_well() -> None:
    mesh = other_family.drawing()
    key = mesh.vertices[np.unique(mesh.faces[mesh.part == PARTS.index("key")])] * 1e3
    assert key[:, 0].max() < -other_family.FACE_RADIUS_MM, "beside the carrier"
    assert np.ptp(key[:, 2]) > 10.0


def test_a_built_part_differs_from_its_drawing_as_much_as_it_may_and_the_same_seed_gives_the_same_part() -> None:
    nominal = other_family.drawing()
    first, again, other = (built_part(SHAPE, TYPICAL, np.random.default_rng(k), contacts=True) for k in (1, 1, 2))
    np.testing.assert_array_equal(first.vertices, again.vertices)
    tips = [heights(mesh, "pin").max() for mesh in (nominal, first, other)]
    assert len(set(tips)) == 3 and np.ptp(tips) < 1e-3
    exact = other_family.built(BuiltTolerance.none(), np.random.default_rng(3))
    np.testing.assert_allclose(exact.vertices, nominal.vertices, atol=1e-12)


def test_a_part_without_contacts_has_its_wells_and_no_pin() -> None:
    bare = built_part(SHAPE, TYPICAL, np.random.default_rng(4), contacts=False)
    assert PARTS.index("pin") not in bare.part and PARTS.index("well") in bare.part


def test_it_is_drawn_by_its_own_code_also_in_another_process() -> None:
    import pickle

    copied = pickle.loads(pickle.dumps(SHAPE))
    np.testing.assert_array_equal(drawn_mesh(copied)[0], other_family.drawing().vertices)


def test_only_of_it_there_are_mirrored_negatives() -> None:
    assert any(case.kind == "mirrored" for case in negative_cases(22, {SHAPE.name: SHAPE}))


def test_the_locator_finds_it_by_its_mesh_alone() -> None:
    (case,) = positive_cases(1, [SHAPE.name], ("nominal",))
    scan = make_scan(case, 5, {SHAPE.name: SHAPE})
    found = locate(scan.cloud, PortModel.from_mesh(SHAPE.name, *drawn_mesh(SHAPE)), Prior(scan.prior.T_ref_port))
    assert found.accepted and scan.T_scanner_port is not None
    assert found.T_ref_port.distance_to(scan.T_scanner_port) < 0.0005
    assert found.T_ref_port.angle_to(scan.T_scanner_port) < np.deg2rad(0.5)
