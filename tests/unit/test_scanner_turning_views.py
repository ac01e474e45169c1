"""Turning range finders in the mock world: their ranges are those of the vehicle from where the arm truly was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller.port_files import load_port
from controller.scanner_files import load_scanner
from drivers.scanner.frame_parser import FrameParser
from drivers.scanner.scip_codec import ReplyReader, decode
from mocks.scanner import ld19, scip
from mocks.scanner.scip import ScipDevice
from mocks.scanner.turning_views import WorldView
from mocks.world.blackboard import Blackboard
from mocks.world.spec import WorldSpec
from perception.geometry import Pose
from tests.unit.test_scanner_scip_codec import Clock, Wire

T_BASE_PORT = Pose.from_vector([0.7, 0.2, 0.5, 1.2, -1.1, 1.3])
T_FLANGE_SCANNER = Pose.from_vector([0.05, 0.0, 0.08, 0.1, 0.0, 0.4])
DISTANCE_M = 0.4


def vector(pose: Pose) -> tuple[float, float, float, float, float, float]:
    x, y, z, rx, ry, rz = (float(v) for v in pose.vector)
    return x, y, z, rx, ry, rz


def world(folder: Path, **changes: object) -> Blackboard:
    """A plain panel; the second scanner is mounted like the first unless told otherwise."""
    none = vector(Pose.identity())
    spec = WorldSpec(3, "type2", vector(T_BASE_PORT), vector(T_FLANGE_SCANNER), none, none, panel="plain")
    spec = replace(spec, **({"T_flange_coarse": vector(T_FLANGE_SCANNER)} | changes))  # type: ignore[arg-type]
    spec.save(folder)
    spec.save_shape(folder, load_port("type2").shape)
    return Blackboard.create(folder)


def facing(distance_m: float) -> np.ndarray:  # type: ignore[type-arg]
    """T_base_flange with the scanner squarely before the port's origin."""
    T_port_scanner = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, distance_m]))
    return (T_BASE_PORT @ T_port_scanner @ T_FLANGE_SCANNER.inverse()).matrix


def view(folder: Path, **precision: float) -> WorldView:
    precision = {"noise_m": 0.0, "systematic_m": 0.0} | precision
    return WorldView(folder, scip.ANGLES_RAD, np.random.default_rng(0), coarse=True, **precision)


def test_a_panel_reads_its_distance_over_the_cosine_and_nothing_behind_the_edges(tmp_path: Path) -> None:
    board = world(tmp_path)
    seen = view(tmp_path)
    assert seen.scan(1, 0.1) is None, "the arm's pose is not known yet"
    board.put_arm(0.0, facing(DISTANCE_M))
    board.put_arm(0.2, facing(DISTANCE_M))
    scan = seen.scan(1, 0.1)
    assert scan is not None
    ranges, light = scan
    ahead = np.abs(scip.ANGLES_RAD) < np.radians(15)
    panel_m = ranges[ahead] * 1e-3 * np.cos(scip.ANGLES_RAD[ahead])
    assert np.ptp(panel_m) < 0.006, "a gently curved panel"
    assert 0.0 < DISTANCE_M - panel_m.mean() < 0.06, "it stands out before the rim plane"
    to_the_side = np.abs(scip.ANGLES_RAD) > np.radians(100)
    assert (ranges[to_the_side] < 20).all(), "no echo is an error code below DMIN"
    assert (light[to_the_side] == 0).all()


def test_noise_is_each_ranges_own_and_the_colours_error_is_shared(tmp_path: Path) -> None:
    board = world(tmp_path)
    board.put_arm(0.0, facing(DISTANCE_M))
    board.put_arm(9.9, facing(DISTANCE_M))
    ahead = np.abs(scip.ANGLES_RAD) < np.radians(15)

    def ranges(number: int, **precision: float) -> np.ndarray:  # type: ignore[type-arg]
        scan = view(tmp_path, **precision).scan(number, 1.0)
        assert scan is not None
        return scan[0][ahead]

    clean = ranges(1)
    noisy = ranges(1, noise_m=0.010) - clean
    assert noisy.std() == pytest.approx(10.0, rel=0.3)
    shifted = ranges(1, systematic_m=0.010) - clean
    assert np.ptp(shifted) <= 1
    assert abs(shifted.mean()) > 0.5


def test_the_newest_scan_whose_pose_is_known_is_sent_with_its_own_time(tmp_path: Path) -> None:
    board = world(tmp_path)
    board.put_arm(0.0, facing(DISTANCE_M))
    board.put_arm(0.32, facing(DISTANCE_M))
    wire, clock = Wire(), Clock()
    device = ScipDevice(wire, clock, view(tmp_path))  # type: ignore[arg-type]
    device.receive(b"MD0380038801000\n")
    wire.sent = b""
    clock.time_s = 0.47  # scan 4 is due, but the arm's pose is known up to scan 3 only
    device.collect()
    (reply,) = ReplyReader().feed(wire.sent)
    stamp, ranges = decode(reply.lines[:1], 4), decode(reply.lines[1:], 3)
    assert stamp is not None
    assert stamp.tolist() == [300]
    assert ranges is not None
    assert np.all(np.abs(ranges - ranges.mean()) < 5)
    wire.sent = b""
    device.collect()
    assert wire.sent == b""


def test_a_world_without_a_second_scanner_says_so(tmp_path: Path) -> None:
    world(tmp_path, T_flange_coarse=None)
    with pytest.raises(ValueError, match="no second scanner"):
        view(tmp_path)


def test_an_ld19_sees_the_panel_ahead_and_nothing_behind(tmp_path: Path) -> None:
    board = world(tmp_path)
    board.put_arm(0.0, facing(DISTANCE_M))
    board.put_arm(0.15, facing(DISTANCE_M))
    seen, wire, clock = view(tmp_path), Wire(), Clock()

    def sight(angles_deg: Sequence[float], time_s: float) -> ld19.Ranges | None:
        scan = seen.at(np.radians(angles_deg), time_s)
        return None if scan is None else scan[0]

    device = ld19.Ld19Device(wire, clock, sight)  # type: ignore[arg-type]
    clock.time_s = 0.2  # packets of the last 50 ms wait for the arm's pose
    device.collect()
    assert len(wire.sent) == 47 * int(0.15 * ld19.RATE_HZ)
    points = np.concatenate([p.points for p in FrameParser(load_scanner("ld19").layout).feed(wire.sent, 0)])
    ahead = points[np.abs(np.arctan2(points[:, 0], points[:, 1])) < np.radians(15)]
    assert len(ahead) > 20
    assert np.all(np.abs(ahead[:, 1] - (DISTANCE_M - 0.03)) < 0.03)
    assert np.all(points[:, 1] > 0.0), "there is no car behind the scanner"
