"""Three ways to run the published method: as printed, as read, and made robust. Lengths are in point spacings.

The numbers are fixed: they were chosen before the evaluation was run, on other scenes than those it measures.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from perception.published.feedback import FeedbackSettings
from perception.published.kdtree_numpy import SplitRule
from perception.published.keypoints import KeypointSettings
from perception.published.registration import IcpSettings

ProfileName = Literal["literal", "faithful", "robust"]


@dataclass(frozen=True, slots=True)
class MethodSettings:
    """Everything the pipeline can be told. The defaults are those of ``faithful``."""

    name: str = "faithful"
    split: SplitRule = "std"
    """Split rule of the tree: changes the time of a query, never its result."""
    denoise: bool = True
    two_sided: bool = True
    """Equation (8) as printed, or only its upper side."""
    radius_spacings: float = 4.0
    """Radius of (4)."""
    neighbours: int = 40
    """k of (9), the point itself included."""
    keypoints: KeypointSettings = field(default_factory=KeypointSettings)
    """Here ``dist_min`` is in point spacings of the target."""
    icp: IcpSettings = field(default_factory=IcpSettings)
    feedback: FeedbackSettings = field(default_factory=FeedbackSettings)
    best_of_rounds: bool = True
    """Return the best iterate; False returns the last one."""
    many_starts: bool = False
    """Try 27 rotations about the start as well, and refine the best few before choosing."""
    refine_top: int = 4
    ranked_share: float = 0.7
    """Poses are ranked by the distances of this share of the scan, the nearest: the rest may have no counterpart."""
    dense: bool = False
    """Refine each pose point-to-plane on the cloud itself."""


LITERAL = MethodSettings(
    name="literal",
    keypoints=KeypointSettings(mode="xyz", dist_min=float("inf"), min_clusters=150, min_size=1),
    icp=IcpSettings(trims=(1.0,)),
    feedback=FeedbackSettings(rule="literal_mm", kappa_min=0.0),
    best_of_rounds=False,
)
"""As printed: all points clustered by coordinates, plain ICP, (18) raw in mm, the last iterate. No extension."""

FAITHFUL = MethodSettings()
"""The readings of docs/method.md: features select, (18) normalised and bounded, trimmed ICP, the best iterate."""

ROBUST = replace(
    FAITHFUL,
    name="robust",
    two_sided=False,
    feedback=FeedbackSettings(rule="fixed", max_rounds=1),
    many_starts=True,
    dense=True,
)
"""Faithful with the one-sided test, several starts, dense refinement, the best few refined before the choice; no
feedback, because repeating rounds did not improve a densely refined pose."""

PROFILES: tuple[MethodSettings, ...] = (LITERAL, FAITHFUL, ROBUST)


def profile(name: str) -> MethodSettings:
    """The profile of this name. Raises KeyError for another."""
    return {settings.name: settings for settings in PROFILES}[name]
