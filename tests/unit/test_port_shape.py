"""Built meshes have the dimensions of their description: probed with rays, as a gauge would."""

from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest

from controller.port_files import bundled_ports, load_port
from perception.errors import MeshError
from perception.evaluation.built import TYPICAL, BuiltTolerance, built_variant
from perception.port_shape import Cavity, Common, Disc, Finish, Hull, PortShape, RoundedRect, outline_bounds
from perception.port_solid import PARTS, PortMesh, build_mesh, build_parts

MM = 1e-3


class Gauge:
    """Casts rays against a mesh, in millimetres."""

    def __init__(self, mesh: PortMesh) -> None:
        self.mesh = mesh
        self.scene = o3d.t.geometry.RaycastingScene()
        self.scene.add_triangles(
            o3d.core.Tensor.from_numpy(mesh.vertices.astype(np.float32)),
            o3d.core.Tensor.from_numpy(mesh.faces.astype(np.uint32)),
        )

    def _cast(self, origin_mm: tuple[float, float, float], direction: tuple[float, float, float]) -> tuple[float, int]:
        ray = np.array([[*(np.array(origin_mm) * MM), *direction]], dtype=np.float32)
        answer = self.scene.cast_rays(o3d.core.Tensor.from_numpy(ray))
        return float(answer["t_hit"].numpy()[0]) / MM, int(answer["primitive_ids"].numpy()[0])

    def depth(self, x: float, y: float) -> float:
        """Depth below the rim plane of what a ray from outside meets."""
        return self._cast((x, y, 50.0), (0.0, 0.0, -1.0))[0] - 50.0

    def part(self, x: float, y: float) -> str:
        return PARTS[self.mesh.part[self._cast((x, y, 50.0), (0.0, 0.0, -1.0))[1]]]

    def width(self, x: float, y: float, depth: float) -> float:
        """Free width along x around a point in the open, at a depth."""
        return sum(self._cast((x, y, -depth), (s, 0.0, 0.0))[0] for s in (-1.0, 1.0))


@pytest.fixture(scope="module")
def ccs2() -> Gauge:
    return Gauge(build_parts(load_port("ccs2").shape))


def is_closed(faces: np.ndarray) -> bool:
    """Every edge is used once in each direction."""
    edges = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward = {tuple(edge) for edge in edges.tolist()}
    return len(forward) == len(edges) and all((b, a) in forward for a, b in forward)


def test_depths_of_ccs2_are_those_of_the_drawing(ccs2: Gauge) -> None:
    assert ccs2.depth(0.0, 0.0) == pytest.approx(6.7, abs=0.01)  # PE's tip
    assert ccs2.depth(-13.5, -49.5) == pytest.approx(6.7, abs=0.01)  # DC+'s tip
    assert ccs2.depth(0.0, 17.5) == pytest.approx(2.0, abs=0.01)  # insert face
    assert ccs2.depth(5.0, 0.0) == pytest.approx(49.5, abs=0.01)  # floor of PE's well
    assert ccs2.depth(36.0, -49.5) == pytest.approx(0.0, abs=0.01)  # rim
    assert ccs2.depth(42.0, -22.0) == pytest.approx(6.5, abs=0.01)  # flange
    assert ccs2.depth(30.0, -25.0) == pytest.approx(49.5, abs=0.01)  # cavity floor beside the island


def test_widths_of_ccs2_are_those_of_the_drawing(ccs2: Gauge) -> None:
    taper = 20.0 * np.tan(np.deg2rad(0.25))
    around_pin = ccs2.width(4.0, 0.0, 2.0 + 20.0) + taper
    assert around_pin + 6.0 / 2 == pytest.approx(15.0 / 2, abs=0.03)  # pin 6.0 in a well of 15.0
    around_dc = ccs2.width(-13.5 + 6.0, -49.5, 2.0 + 20.0) + taper
    assert around_dc + 8.0 / 2 == pytest.approx(24.0 / 2, abs=0.03)  # pin 8.0 in a well of 24.0
    gap = ccs2.width(31.0, -49.5, 20.0) + 2 * taper
    assert gap == pytest.approx((68.9 - 55.7) / 2, abs=0.04)  # from the DC island to the cavity's wall


def test_outer_size_of_ccs2() -> None:
    shape = load_port("ccs2").shape
    low_x, low_y, high_x, high_y = outline_bounds(shape.rim)
    assert (high_x - low_x, high_y - low_y) == pytest.approx((75.0 * MM, 102.0 * MM), abs=0.1 * MM)
    low_x, low_y, high_x, high_y = outline_bounds(shape.cavity.outline)
    assert (high_x - low_x, high_y - low_y) == pytest.approx((68.9 * MM, 97.1 * MM), abs=0.1 * MM)


def test_faces_know_their_part(ccs2: Gauge) -> None:
    assert ccs2.part(0.0, 0.0) == "pin"
    assert ccs2.part(5.0, 0.0) == "floor"
    assert ccs2.part(0.0, 17.5) == "insert"
    assert ccs2.part(36.0, -49.5) == "rim"
    assert ccs2.part(42.0, -22.0) == "flange"


@pytest.mark.parametrize("name", bundled_ports())
def test_every_bundled_port_is_a_closed_surface_with_all_its_contacts(name: str) -> None:
    shape = load_port(name).shape
    mesh = build_parts(shape)
    assert is_closed(mesh.faces)
    assert mesh.vertices[:, 2].max() == pytest.approx(0.0, abs=1e-9)
    gauge = Gauge(mesh)
    for contact in shape.contacts:
        at = gauge.depth(contact.centre_m[0] / MM, contact.centre_m[1] / MM)
        floor = (contact.floor_depth_m or shape.cavity.depth_m) if contact.kind == "socket" else contact.tip_depth_m
        assert at == pytest.approx(floor / MM, abs=0.01), contact.name


@pytest.mark.parametrize("name", bundled_ports())
def test_built_variants_are_closed_and_differ_from_the_drawing(name: str) -> None:
    shape = load_port(name).shape
    built = built_variant(shape, TYPICAL, np.random.default_rng(3))
    assert built != shape
    assert is_closed(build_parts(built).faces)


def test_no_tolerance_builds_the_drawing_itself() -> None:
    shape = load_port("type2").shape
    assert built_variant(shape, BuiltTolerance.none(), np.random.default_rng(0)) == shape


def test_outward_faces_enclose_a_positive_volume() -> None:
    vertices, faces = build_mesh(load_port("type2").shape)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6 > 1e-5


def test_curved_walls_keep_the_chord_error() -> None:
    shape = PortShape("round", Disc(0.08), Cavity(Disc(0.07), 0.03))
    mesh = build_parts(shape)
    wall = mesh.part == PARTS.index("cavity")
    ends = mesh.vertices[mesh.faces[wall]]
    middles = (ends + np.roll(ends, 1, axis=1))[..., :2].reshape(-1, 2) / 2
    assert 0.035 - np.linalg.norm(middles, axis=1).min() < 0.021 * MM


def test_draft_narrows_the_cavity_and_edges_are_rounded() -> None:
    shape = PortShape("round", Disc(0.08), Cavity(Disc(0.07), 0.04), finish=Finish(np.deg2rad(1.0), 0.0005))
    gauge = Gauge(build_parts(shape))
    assert gauge.width(0.0, 0.0, 1.0) - gauge.width(0.0, 0.0, 39.0) == pytest.approx(
        2 * 38 * np.tan(np.deg2rad(1)), abs=0.05
    )
    assert 0.0 < gauge.depth(35.2, 0.0) < 0.5


def test_outlines_combine() -> None:
    both = (Disc(0.04, (-0.01, 0.0)), Disc(0.04, (0.01, 0.0)))
    assert outline_bounds(Hull(both)) == pytest.approx((-0.03, -0.02, 0.03, 0.02), abs=1e-6)
    low_x, _, high_x, high_y = outline_bounds(Common(both))
    assert (low_x, high_x) == pytest.approx((-0.01, 0.01), abs=1e-6)
    assert high_y == pytest.approx(np.sqrt(0.02**2 - 0.01**2), abs=1e-4)
    assert outline_bounds(Disc(0.04, (0.0, 0.01), flat_top_m=0.012))[3] == pytest.approx(0.022, abs=1e-9)
    assert outline_bounds(RoundedRect(0.05, 0.03, 0.01, (0.0, -0.01))) == pytest.approx(
        (-0.025, -0.025, 0.025, 0.005), abs=1e-6
    )


@pytest.mark.parametrize("diameter", [0.0, -0.01])
def test_a_circle_without_size_is_refused(diameter: float) -> None:
    with pytest.raises(MeshError, match="no size"):
        build_mesh(PortShape("none", Disc(0.05), Cavity(Disc(diameter), 0.03)))
