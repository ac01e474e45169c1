"""What the mock scanner sees of the mock world."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller.port_files import load_port
from mocks.scanner.world_source import WorldSource
from mocks.world.blackboard import Blackboard
from mocks.world.spec import WorldSpec
from perception.geometry import Pose

T_BASE_PORT = Pose.from_vector([0.7, 0.2, 0.5, 1.2, -1.1, 1.3])
T_FLANGE_SCANNER = Pose.from_vector([0.05, 0.0, 0.08, 0.1, 0.0, 0.4])
FACING = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.29]))
"""The scanner squarely in front of the port's origin."""


def spec(**changes: object) -> WorldSpec:
    values = [tuple(float(v) for v in pose.vector) for pose in (T_BASE_PORT, T_FLANGE_SCANNER, Pose.identity())]
    world = WorldSpec(3, "type2", values[0], values[1], values[2], values[2])  # type: ignore[arg-type]
    return replace(world, **changes)  # type: ignore[arg-type]


def flange(T_port_scanner: Pose) -> Pose:
    return T_BASE_PORT @ T_port_scanner @ T_FLANGE_SCANNER.inverse()


def line_at(optics: WorldSource, time_s: float) -> np.ndarray | None:  # type: ignore[type-arg]
    lines = optics.lines(0, [time_s])
    return lines[0] if lines else None


def source(folder: Path, world: WorldSpec) -> tuple[WorldSource, Blackboard]:
    world.save(folder)
    world.save_shape(folder, load_port("type2").shape)
    board = Blackboard.create(folder)
    return WorldSource(folder, np.random.default_rng(0)), board


def test_a_profile_waits_for_the_arms_pose_at_its_own_time(tmp_path: Path) -> None:
    optics, board = source(tmp_path, spec())
    assert line_at(optics, 1.0) is None
    board.put_arm(0.9, flange(FACING).matrix)
    assert line_at(optics, 1.0) is None
    board.put_arm(1.1, flange(FACING).matrix)
    assert line_at(optics, 1.0) is not None


def test_the_inlet_is_seen_where_it_truly_is(tmp_path: Path) -> None:
    """Squarely and rolled half a turn, from 0.29 m and 0.25 m: the same face at the same place of the port frame."""
    optics, board = source(tmp_path, spec(profile_noise_m=0.0))
    views = [FACING, FACING.moved([0.0, 0.0, 0.04]) @ Pose.from_rotvec([0.0, 0.0, np.pi])]
    heights = []
    for number, T_port_scanner in enumerate(views):
        board.put_arm(float(number), flange(T_port_scanner).matrix)
        line = line_at(optics, float(number))
        assert line is not None
        points = T_port_scanner.apply(np.stack([line[:, 0], np.zeros(len(line)), line[:, 1]], axis=1))
        assert np.abs(points[:, 1]).max() < 1e-9
        heights.append(float(np.median(points[np.abs(points[:, 0]) < 0.002, 2])))
    assert heights[0] == pytest.approx(heights[1], abs=0.0003)
    assert abs(heights[0]) < 0.06


def test_profiles_cast_together_are_those_cast_one_by_one(tmp_path: Path) -> None:
    optics, board = source(tmp_path, spec(profile_noise_m=0.0))
    board.put_arm(0.0, flange(FACING).matrix)
    board.put_arm(1.0, flange(FACING.moved([0.0, 0.05, 0.01]) @ Pose.from_rotvec([0.0, 0.1, 0.2])).matrix)
    together = optics.lines(0, [0.0, 0.5, 1.0, 1.1])
    assert len(together) == 3
    for line, time_s in zip(together, (0.0, 0.5, 1.0), strict=True):
        alone = line_at(optics, time_s)
        assert alone is not None
        first, second = (np.interp(np.linspace(-0.05, 0.05, 200), *part.T) for part in (line, alone))
        assert np.median(np.abs(first - second)) < 2e-5


def test_a_plain_panel_has_no_depth(tmp_path: Path) -> None:
    depths = []
    for panel in ("port", "plain"):
        folder = tmp_path / panel
        folder.mkdir()
        optics, board = source(folder, spec(panel=panel, profile_noise_m=0.0))
        board.put_arm(0.0, flange(FACING).matrix)
        board.put_arm(1.0, flange(FACING).matrix)
        line = line_at(optics, 0.5)
        assert line is not None
        middle = line[np.abs(line[:, 0]) < 0.03]
        bend = np.polyval(np.polyfit(middle[:, 0], middle[:, 1], 2), middle[:, 0])
        depths.append(float(np.quantile(np.abs(middle[:, 1] - bend), 0.9)))
    assert depths[0] > 0.002 > depths[1]


def test_glare_blinds_the_first_sweeps_only_and_sweeps_are_counted(tmp_path: Path) -> None:
    optics, board = source(tmp_path, spec(glare_until_sweep=1))
    board.put_arm(0.0, flange(FACING).matrix)
    board.put_arm(1.0, flange(FACING).matrix)
    seen = []
    for sweep in (1, 2):
        optics.begin_sweep()
        assert board.sweep() == sweep
        line = line_at(optics, 0.5)
        assert line is not None
        seen.append(int((np.abs(line[:, 0]) < 0.04).sum()))
    assert seen[0] < 0.1 * seen[1]


def test_another_car_is_seen_where_it_has_parked(tmp_path: Path) -> None:
    optics, board = source(tmp_path, spec(profile_noise_m=0.0))
    board.put_arm(0.0, flange(FACING).matrix)
    board.put_arm(1.0, flange(FACING).matrix)
    here = line_at(optics, 0.5)
    board.put_car(tuple(float(v) for v in (T_BASE_PORT @ _OUT).vector))
    there = line_at(optics, 0.5)
    assert here is not None and there is not None
    nearer_m = np.interp(np.linspace(-0.05, 0.05, 200), *here.T) - np.interp(np.linspace(-0.05, 0.05, 200), *there.T)
    assert float(np.median(nearer_m)) == pytest.approx(0.02, abs=0.0005)


_OUT = Pose.from_rotvec([0.0, 0.0, 0.0], [0.0, 0.0, 0.02])
"""The car 20 mm nearer on its port's axis."""
