"""The mock world seen by the laser: profiles ray-cast from where the arm truly was at the moment of exposure.

The vehicle, its paint and its inlet within moulding tolerance come from the world's seed: the controller's port model
is the drawing, not this part; all cars of one world are this one, parked elsewhere. A profile waits until the arm mock
has published its pose for that very time.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mocks.scanner.calibration_targets import target_scene
from mocks.scanner.emulated_clock import EmulatedClock
from mocks.world.blackboard import Blackboard
from mocks.world.spec import WorldSpec
from perception.evaluation.scene import Negative, SceneSpec, build_scene
from perception.evaluation.sensor import SensorModel, cast_profile, cast_sweep
from perception.geometry import Array, Pose

GLARE = 0.98
"""Share of the returns near the port that sun glare takes."""
ATTACH_S = 10.0
NARROW = SensorModel(
    points_per_profile=832, window_m=0.03, standoff_m=0.10, near_m=0.07, far_m=0.13, baseline_m=-0.04, outliers=0.002
)
"""Optics like those of a Profiler 2: about 30 mm wide, some 56 mm deep."""


class VehicleSeen:
    """The world's vehicle, and where one of the arm's scanners is before it."""

    def __init__(self, folder: Path, *, coarse: bool = False) -> None:
        """``coarse``: the second scanner, on a mount of its own. Raises ValueError where the world has none."""
        self.spec = WorldSpec.load(folder)
        self.board = _attach(folder)
        vehicle_rng = np.random.default_rng(self.spec.seed)
        negative: Negative | None = "plain" if self.spec.panel == "plain" else None
        shape = WorldSpec.load_shape(folder)
        if self.spec.panel in ("sphere", "corner"):
            self.scene = target_scene(self.spec.panel, self.spec.sphere_radius_m, shape)
        else:
            self.scene = build_scene(SceneSpec(shape, negative), vehicle_rng)
        mount = self.spec.T_flange_coarse if coarse else self.spec.T_flange_scanner
        if mount is None:
            raise ValueError(f"the world in {folder} has no second scanner")
        self._T_flange_scanner = Pose.from_vector(mount)

    @property
    def clock(self) -> EmulatedClock:
        """The world's time."""
        return EmulatedClock(self.board.world_time_s, self.board.time_scale)

    def T_port_scanner(self, time_s: float) -> Pose | None:
        """Where the scanner was; None as long as the arm mock has not published its pose for that time."""
        matrix = self.board.arm_pose_at(time_s)
        if matrix is None:
            return None
        parked = self.board.car()
        T_base_port = self.spec.port_pose if parked is None else Pose.from_vector(parked)
        return T_base_port.inverse() @ Pose.from_matrix(matrix) @ self._T_flange_scanner


class WorldSource:
    """``Source`` on the mock world in a run's folder."""

    def __init__(self, folder: Path, rng: np.random.Generator, optics: SensorModel | None = None) -> None:
        self._seen = VehicleSeen(folder)
        self._spec, self._board, self._scene = self._seen.spec, self._seen.board, self._seen.scene
        self._rng = rng
        self._sensor = replace(optics or SensorModel(), noise_m=self._spec.profile_noise_m)
        self._glaring = False
        cast_profile(self._scene, Pose.identity(), self._sensor, np.random.default_rng(0))  # builds the ray-caster

    @property
    def clock(self) -> EmulatedClock:
        """The world's time."""
        return self._seen.clock

    def edges(self, output: int, after: int) -> list[tuple[int, float]]:
        """(number, world time) of the rising edges of one of the arm's digital outputs after a number."""
        return [(number, time_s) for number, time_s, which in self._board.edges(after) if which == output]

    def begin_sweep(self) -> None:
        """Counts the sweep in the world; the first ones may be blinded by glare."""
        sweep = self._board.sweep() + 1
        self._board.put_sweep(sweep)
        self._glaring = sweep <= self._spec.glare_until_sweep

    def lines(self, first: int, times_s: Sequence[float]) -> list[Array]:
        """Points (M, 2) measured at each time, valid ones only, up to the first whose pose is not published yet."""
        poses = list(_known(self._seen.T_port_scanner(time_s) for time_s in times_s))
        sensor = replace(self._sensor, glare=GLARE if self._glaring else 0.0)
        if len(poses) < 2:
            return [cast_profile(self._scene, pose, sensor, self._rng) for pose in poses]
        sweep = cast_sweep(self._scene, poses, sensor, self._rng)  # together they cost half as much
        points = sweep.T_port_scanner.apply(sweep.cloud.points)
        return [pose.inverse().apply(points[sweep.profile == k])[:, [0, 2]] for k, pose in enumerate(poses)]


def _known(poses: Iterable[Pose | None]) -> Iterator[Pose]:
    """Poses up to the first that is not known."""
    for pose in poses:
        if pose is None:
            return
        yield pose


def _attach(folder: Path) -> Blackboard:
    """The blackboard, which whoever started the world may still be making."""
    deadline = time.monotonic() + ATTACH_S
    while True:
        try:
            return Blackboard.attach(folder)
        except FileNotFoundError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.02)
