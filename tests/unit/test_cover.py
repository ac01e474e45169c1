"""The open charging cover: found where it is, as a box that holds it; nothing found where none is."""

import numpy as np
import pytest

from controller.port_files import load_port
from perception.cover import find_cover
from perception.estimate import PortEstimate
from perception.geometry import Pose
from perception.scan import Cloud
from tests.unit.cover_scene import sheet, vehicle


def estimate(pose: Pose, *, accepted: bool = True, ref: str = "scanner") -> PortEstimate:
    return PortEstimate("ccs2", pose, ref, np.eye(6) * 1e-8, 1e-4, 0.9, 0.5, accepted, (), ())  # type: ignore[arg-type]


@pytest.mark.parametrize("opening_deg", [95.0, 120.0, 150.0])
def test_side_and_angle_of_an_open_cover(opening_deg: float) -> None:
    found = find_cover(Cloud(vehicle(opening_deg)), estimate(Pose.identity()))
    assert found is not None
    assert found.side == "left"
    assert np.rad2deg(found.opening_rad) == pytest.approx(opening_deg, abs=2.0)


def test_the_box_holds_the_flap_and_reaches_beyond_what_is_seen() -> None:
    points = vehicle(120.0)
    found = find_cover(Cloud(points), estimate(Pose.identity()))
    assert found is not None
    flap = points[points[:, 2] > 0.03]
    inside = np.abs(found.T_ref_box.inverse().apply(flap)) < np.asarray(found.half_size_m)
    assert inside.all(axis=1).mean() > 0.98
    assert 2 * found.half_size_m[1] > 0.16
    assert found.corners.shape == (8, 3)


def test_the_cover_is_told_in_the_estimates_frame() -> None:
    T_ref_port = Pose.from_rotvec([2.0, 1.0, 0.5], [0.3, -0.2, 0.7])
    plain = find_cover(Cloud(vehicle(120.0)), estimate(Pose.identity()))
    moved = find_cover(Cloud(T_ref_port.apply(vehicle(120.0))), estimate(T_ref_port))
    assert plain is not None and moved is not None
    assert moved.T_ref_box.distance_to(T_ref_port @ plain.T_ref_box) < 1e-3


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_each_side_has_its_name(turns: int) -> None:
    turn = Pose.from_rotvec([0.0, 0.0, turns * np.pi / 2])
    found = find_cover(Cloud(turn.apply(vehicle(110.0))), estimate(Pose.identity()))
    assert found is not None
    assert found.side == ("left", "bottom", "right", "top")[turns]


def test_a_panel_alone_has_no_cover() -> None:
    points = vehicle(120.0)
    assert find_cover(Cloud(points[points[:, 2] < 0.025]), estimate(Pose.identity())) is None
    assert find_cover(Cloud(points[:10]), estimate(Pose.identity())) is None


def test_a_flap_across_the_inlet_is_no_open_cover() -> None:
    assert find_cover(Cloud(vehicle(120.0, hinge_x=0.0)), estimate(Pose.identity())) is None


def test_a_simulated_scan_with_a_cover_on_the_left() -> None:
    from perception.evaluation.scenes import simulate_scan

    scan = simulate_scan(load_port("nacs").shape, "nominal", np.random.default_rng([78, 0]))
    assert scan.cover_corners is not None
    found = find_cover(scan.cloud, estimate(scan.T_scanner_port))
    assert found is not None
    assert found.side == "left"


def test_the_pockets_wall_is_no_flap_where_a_narrow_scan_shows_no_panel() -> None:
    face = sheet((-0.04, 0.04), (-0.06, 0.06))
    floor = sheet((-0.06, 0.058), (-0.11, 0.06))
    wall = sheet((-0.06, 0.06), (-0.008, 0.035))
    sheets = [
        np.column_stack([face, np.full(len(face), -0.002)]),
        np.column_stack([floor, np.full(len(floor), -0.008)]),
        np.column_stack([np.full(len(wall), 0.058), wall]),
    ]
    assert find_cover(Cloud(np.vstack(sheets)), estimate(Pose.identity())) is None


def _upright(at: float, along: tuple[float, float], up: tuple[float, float], *, across_x: bool) -> np.ndarray:
    """A wall at x (or y) = ``at``."""
    found = sheet(along, up)
    columns = [np.full(len(found), at), found[:, 0], found[:, 1]]
    return np.column_stack(columns if across_x else [columns[1], columns[0], columns[2]])


def _flat(x: tuple[float, float], y: tuple[float, float], z: float) -> np.ndarray:
    found = sheet(x, y)
    return np.column_stack([found, np.full(len(found), z)])


def test_the_walls_of_a_pocket_whose_floor_shows_more_than_the_skin_around_it_are_no_flaps() -> None:
    skin = _flat((-0.085, 0.085), (-0.12, 0.085), 0.028)
    skin = skin[(np.abs(skin[:, 0]) > 0.075) | (skin[:, 1] < -0.11) | (skin[:, 1] > 0.075)]
    walls = [
        *(_upright(x, (-0.11, 0.075), (0.008, 0.028), across_x=True) for x in (-0.075, 0.075)),
        *(_upright(y, (-0.075, 0.075), (0.008, 0.028), across_x=False) for y in (-0.11, 0.075)),
    ]
    pocket = [_flat((-0.075, 0.075), (-0.11, 0.075), -0.002), *walls, skin]
    assert find_cover(Cloud(np.vstack(pocket)), estimate(Pose.identity())) is None
    assert find_cover(Cloud(np.vstack(pocket[:3])), estimate(Pose.identity())) is None, "two walls and no skin in sight"


def test_above_the_skin_an_open_cover_is_found_though_the_pockets_floor_shows_more() -> None:
    skin = _flat((-0.10, 0.10), (-0.12, 0.10), 0.028)
    skin = skin[(np.abs(skin[:, 0]) > 0.075) | (skin[:, 1] < -0.11) | (skin[:, 1] > 0.075)]
    flap = _upright(-0.08, (-0.06, 0.06), (0.03, 0.075), across_x=True)
    scene = np.vstack([_flat((-0.075, 0.075), (-0.11, 0.075), -0.002), skin, flap])
    found = find_cover(Cloud(scene), estimate(Pose.identity()))
    assert found is not None
    assert found.side == "left"


def test_a_trim_beside_the_pocket_is_no_flap_also_where_its_top_is_larger_than_its_wall() -> None:
    panel = vehicle(120.0)
    panel = panel[panel[:, 2] < 0.025]
    wall = _upright(0.08, (-0.05, 0.05), (0.02, 0.038), across_x=True)
    top = _flat((0.08, 0.11), (-0.05, 0.05), 0.038)
    assert find_cover(Cloud(np.vstack([panel, wall, top])), estimate(Pose.identity())) is None


def test_a_pockets_wall_is_no_flap_where_an_askew_scan_shows_the_skin_at_two_sides_only() -> None:
    """As a mock cell's scanner saw it: the wall at the right leans too much for a flap, the one below does not."""
    floor = _flat((-0.08, 0.063), (-0.107, 0.07), -0.002)
    below = _upright(-0.107, (-0.055, 0.075), (-0.002, 0.034), across_x=False)
    leaning = sheet((-0.107, 0.07), (-0.002, 0.034))
    right = np.column_stack([0.064 + 0.32 * leaning[:, 1], leaning])
    strips = [_flat((0.075, 0.086), (-0.107, 0.07), 0.033), _flat((-0.055, 0.086), (-0.112, -0.107), 0.033)]
    assert find_cover(Cloud(np.vstack([floor, below, right, *strips])), estimate(Pose.identity())) is None


@pytest.mark.parametrize(("half_width", "height"), [(0.06, 0.012), (0.018, 0.04)])
def test_what_is_too_low_or_too_narrow_for_a_flap_is_none(half_width: float, height: float) -> None:
    panel = vehicle(120.0)
    panel = panel[panel[:, 2] < 0.025]
    box = _upright(0.08, (-half_width, half_width), (0.02, 0.02 + height), across_x=True)
    assert find_cover(Cloud(np.vstack([panel, box])), estimate(Pose.identity())) is None
