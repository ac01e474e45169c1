"""The mock world seen by the laser: profiles ray-cast from where the arm truly was at the moment of exposure.

The vehicle, its paint and its inlet within moulding tolerance come from the world's seed: the controller's port model
is the drawing, not this part. A profile waits until the arm mock has published its pose for that very time.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from mocks.scanner.emulated_clock import EmulatedClock
from mocks.world.blackboard import Blackboard
from mocks.world.spec import WorldSpec
from perception.evaluation.scene import Negative, SceneSpec, build_scene
from perception.evaluation.sensor import SensorModel, cast_profile
from perception.geometry import Array, Pose

GLARE = 0.98
"""Share of the returns near the port that sun glare takes."""
ATTACH_S = 10.0
NARROW = SensorModel(
    points_per_profile=832, window_m=0.03, standoff_m=0.10, near_m=0.07, far_m=0.13, baseline_m=-0.04, outliers=0.002
)
"""Optics like those of a Profiler 2: about 30 mm wide, some 56 mm deep."""


class WorldSource:
    """``Source`` on the mock world in a run's folder."""

    def __init__(self, folder: Path, rng: np.random.Generator, optics: SensorModel | None = None) -> None:
        self._spec = WorldSpec.load(folder)
        self._board = _attach(folder)
        self._rng = rng
        vehicle_rng = np.random.default_rng(self._spec.seed)
        negative: Negative | None = "plain" if self._spec.panel == "plain" else None
        self._scene = build_scene(SceneSpec(WorldSpec.load_shape(folder), negative), vehicle_rng)
        self._sensor = replace(optics or SensorModel(), noise_m=self._spec.profile_noise_m)
        self._glaring = False
        self._T_port_base = self._spec.port_pose.inverse()
        self._T_flange_scanner = Pose.from_vector(self._spec.T_flange_scanner)
        cast_profile(self._scene, Pose.identity(), self._sensor, np.random.default_rng(0))  # builds the ray-caster

    @property
    def clock(self) -> EmulatedClock:
        """The world's time."""
        return EmulatedClock(self._board.world_time_s, self._board.time_scale)

    def begin_sweep(self) -> None:
        """Counts the sweep in the world; the first ones may be blinded by glare."""
        sweep = self._board.sweep() + 1
        self._board.put_sweep(sweep)
        self._glaring = sweep <= self._spec.glare_until_sweep

    def line(self, number: int, time_s: float) -> Array | None:
        """Points (M, 2) measured at ``time_s``, valid ones only; None while the arm's pose is not published."""
        matrix = self._board.arm_pose_at(time_s)
        if matrix is None:
            return None
        T_port_scanner = self._T_port_base @ Pose.from_matrix(matrix) @ self._T_flange_scanner
        sensor = replace(self._sensor, glare=GLARE if self._glaring else 0.0)
        return cast_profile(self._scene, T_port_scanner, sensor, self._rng)


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
