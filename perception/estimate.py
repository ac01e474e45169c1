"""What a locator is told beforehand, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from perception.geometry import Array, Pose
from perception.scan import Frame


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Where a site expects the port, and how far off it may be."""

    T_ref_port: Pose
    lateral_m: float = 0.040
    """Largest sideways offset of the port's origin."""
    along_m: float = 0.030
    """Largest offset along the mating axis."""
    tilt_rad: float = float(np.deg2rad(20.0))
    """Largest angle between the expected and the true mating axis."""
    roll_rad: float = float(np.deg2rad(15.0))
    """Largest roll about the mating axis."""


Verdict = Literal["port", "no-port", "occupied", "closed-cover", "uncertain"]


@dataclass(frozen=True, slots=True, eq=False)
class PortEstimate:
    """The port's pose and everything a caller needs to judge it. Only an ``accepted`` estimate may become a plan."""

    port: str
    """Name of the port model."""
    T_ref_port: Pose
    ref: Frame
    covariance: Array
    """(6, 6): translation (m) then rotation vector (rad), both in the port frame."""
    rms_residual_m: float
    inlier_ratio: float
    """Share of the visible model surface that has scan points on it, 0 to 1."""
    runner_up_margin: float
    """How far the second-best distinct pose scores below the best one, 0 (ambiguous) to 1."""
    accepted: bool
    reasons: tuple[str, ...]
    """Why it was refused, or what supports it: one sentence each."""
    timings_s: tuple[tuple[str, float], ...]
    """(step, seconds) in order, the last one being ("total", ...)."""
    verdict: Verdict = "port"
    runner_ups: tuple[tuple[float, Pose], ...] = ()
    """Other poses that were considered, (score, T_ref_port), best first; the chosen pose scores higher or as high."""

    @staticmethod
    def nothing_found(
        port: str, prior: Prior, ref: Frame, reason: str, timings_s: tuple[tuple[str, float], ...]
    ) -> PortEstimate:
        """The refusal of a scan that no pose could be found in: the prior's pose, as uncertain as can be."""
        return PortEstimate(
            port=port,
            T_ref_port=prior.T_ref_port,
            ref=ref,
            covariance=np.diag([1.0] * 3 + [np.pi**2] * 3),
            rms_residual_m=float("inf"),
            inlier_ratio=0.0,
            runner_up_margin=0.0,
            accepted=False,
            reasons=(reason,),
            timings_s=timings_s,
            verdict="no-port",
        )

    @property
    def elapsed_s(self) -> float:
        """Total time of the locator."""
        return dict(self.timings_s).get("total", 0.0)
