"""The acceptance gate: reasons to refuse a pose. No reason, no refusal; an estimate with one never becomes a plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.distortion import UNDISTORTED, Distortion
from perception.estimate import Prior, Verdict
from perception.evidence import MAX_DENIED, Evidence
from perception.geometry import Array, Pose
from perception.port_model import AcceptanceLimits

MIN_COVERAGE = 0.15
MAX_VIOLATION = 0.25
MIN_MARGIN = 0.10
MIN_FEATURES = 2
MIN_INNER = 0.06
MIN_BLOCKED = 0.4
MIN_ROLL_VOTES = 6
MIN_ROLL_MARGIN = 0.4
MAX_SHEAR_RAD = float(np.deg2rad(0.9))
MAX_STRETCH = 0.010
MAX_LEAN_RAD = float(np.deg2rad(2.0))
"""Of the 24 scans in docs/locator.md some hard and extreme ones exceed these; they explain nothing then (see below)."""
MAX_DEPTH_DISPUTE_M = 0.0008
"""Twice what a built port's contacts are off axially."""
MIN_EXPLAINED = 0.3
"""A distortion that takes away less of what contradicts a pose is none: things before the port pull at it."""
_PRIOR_SLACK_M = 0.006
_PRIOR_SLACK_RAD = float(np.deg2rad(3.0))


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """All that the gate looks at."""

    T_prior_port: Pose
    covariance: Array
    rms_m: float
    evidence: Evidence
    margin: float
    distortion: Distortion = UNDISTORTED
    depth_dispute_m: float = 0.0
    """How much higher than the model has it the flat that disagrees most is seen."""


def reasons_against(findings: Findings, prior: Prior, limits: AcceptanceLimits) -> tuple[str, ...]:
    """One sentence for each thing that speaks against acceptance."""
    return (
        *_outside_prior(findings.T_prior_port, prior),
        *_uncertain(findings, limits),
        *_unsupported(findings),
        *_distorted(findings.distortion),
        *_of_other_depth(findings.depth_dispute_m),
    )


def _outside_prior(pose: Pose, prior: Prior) -> list[str]:
    found = []
    lateral, along = float(np.hypot(*pose.translation[:2])), abs(float(pose.translation[2]))
    if lateral > prior.lateral_m + _PRIOR_SLACK_M:
        found.append(
            f"the pose lies {lateral * 1e3:.0f} mm sideways of the prior, which allows {prior.lateral_m * 1e3:.0f}"
        )
    if along > prior.along_m + _PRIOR_SLACK_M:
        found.append(
            f"the pose lies {along * 1e3:.0f} mm along the axis from the prior, which allows {prior.along_m * 1e3:.0f}"
        )
    tilt = float(np.arccos(np.clip(pose.rotation[2, 2], -1, 1)))
    if tilt > prior.tilt_rad + _PRIOR_SLACK_RAD:
        found.append(f"the axis is tilted {_deg(tilt):.0f} deg from the prior, which allows {_deg(prior.tilt_rad):.0f}")
    roll = abs(roll_of(pose))
    if roll > prior.roll_rad + _PRIOR_SLACK_RAD:
        found.append(f"the roll is {_deg(roll):.0f} deg from the prior, which allows {_deg(prior.roll_rad):.0f}")
    return found


def _deg(angle_rad: float) -> float:
    return float(np.rad2deg(angle_rad))


def roll_of(pose: Pose) -> float:
    """Rotation about the port's axis once the tilt is taken out, in radians."""
    r = pose.rotation
    return float(np.arctan2(r[1, 0] - r[0, 1], r[0, 0] + r[1, 1]))


def _uncertain(findings: Findings, limits: AcceptanceLimits) -> list[str]:
    found = []
    sigma = np.sqrt(np.diag(findings.covariance))
    shift, turn = float(np.linalg.norm(sigma[:3])), float(np.linalg.norm(sigma[3:]))
    if findings.rms_m > limits.max_rms_m:
        found.append(
            f"the points lie {findings.rms_m * 1e3:.2f} mm off the surface, more than {limits.max_rms_m * 1e3:.2f} mm"
        )
    if shift > limits.max_translation_sigma_m:
        found.append(
            f"a position uncertainty of {shift * 1e3:.2f} mm exceeds {limits.max_translation_sigma_m * 1e3:.2f} mm"
        )
    if turn > limits.max_rotation_sigma_rad:
        found.append(
            f"an angle uncertainty of {_deg(turn):.2f} deg exceeds {_deg(limits.max_rotation_sigma_rad):.2f} deg"
        )
    return found


def _features_asked_for(e: Evidence) -> tuple[int, int, int]:
    """(seen, of how many, needed): half of those that no depth hides, two at most; one where all are deep."""
    if e.reachable:
        return e.reachable_seen, e.reachable, min(MIN_FEATURES, (e.reachable + 1) // 2)
    return e.features_seen, e.features, min(1, e.features)


def _unsupported(findings: Findings) -> list[str]:
    e = findings.evidence
    found = []
    if e.coverage < MIN_COVERAGE:
        found.append(f"only {e.coverage:.0%} of the port's outline has scan points where its surface is")
    if e.violation > MAX_VIOLATION:
        where = "behind the port's surface" if e.behind > e.before else "where the port leaves space free"
        found.append(f"{e.violation:.0%} of the distinctive evidence contradicts the port: points {where}")
    seen, of, needed = _features_asked_for(e)
    if seen < needed:
        found.append(f"only {seen} of {of} contacts and wells are seen where they should be")
    if e.features_denied > MAX_DENIED * (e.features_seen + e.features_denied):
        found.append(f"{e.features_denied} contacts or wells are contradicted, {e.features_seen} are seen")
    if e.contacts > 1 and not e.contacts_seen:
        found.append(f"none of the {e.contacts} contacts is seen")
    elif e.contacts_denied > MAX_DENIED * (e.contacts_seen + e.contacts_denied):
        found.append(f"{e.contacts_denied} contacts are not where they should be, {e.contacts_seen} are seen")
    if e.mirror is not None and sum(e.mirror) < MIN_ROLL_VOTES:
        found.append("hardly any point tells this port from its mirror image")
    elif e.mirror is not None and e.mirror[0] - e.mirror[1] < MIN_ROLL_MARGIN * sum(e.mirror):
        found.append(f"its mirror image explains the scan as well: {e.mirror[0]} places for, {e.mirror[1]} against")
    if e.inner < MIN_INNER or e.blocked > e.inner:
        found.append(
            f"{e.inner:.0%} of the inlet is seen as it should be and {e.blocked:.0%} has something before it:"
            " capped, occupied or hidden"
        )
    if e.roll_for + e.roll_against < MIN_ROLL_VOTES:
        found.append("hardly any point tells this roll from others")
    elif e.roll_margin < MIN_ROLL_MARGIN:
        found.append(
            f"a roll by {_deg(e.roll_rival_rad):.0f} deg explains the scan as well: {e.roll_for} places speak for this"
            f" roll, {e.roll_against} against"
        )
    if findings.margin < MIN_MARGIN:
        found.append(f"another pose fits nearly as well (margin {findings.margin:.0%})")
    return found


def _distorted(found: Distortion) -> list[str]:
    """A scan out of proportion was not taken as its poses say; what is located in it is elsewhere."""
    if found.explains < MIN_EXPLAINED:
        return []
    words = []
    if found.shear_rad > MAX_SHEAR_RAD:
        words.append(f"sheared by {_deg(found.shear_rad):.1f} deg")
    for axis, stretch in (("x", found.stretch_x), ("y", found.stretch_y)):
        if abs(stretch) > MAX_STRETCH:
            words.append(f"{abs(stretch):.1%} too {'long' if stretch > 0 else 'short'} along {axis}")
    if found.lean_rad > MAX_LEAN_RAD:
        words.append(f"leaning by {_deg(found.lean_rad):.1f} deg")
    if not words:
        return []
    return [f"the scan is {' and '.join(words)} against the port: check hand-eye and the sweep's speed"]


def _of_other_depth(dispute_m: float) -> list[str]:
    """A port whose flats lie as the model has them sideways and not in depth is of another make, or a wrong model."""
    if abs(dispute_m) <= MAX_DEPTH_DISPUTE_M:
        return []
    where = "higher" if dispute_m > 0 else "deeper"
    return [f"a flat of the port is seen {abs(dispute_m) * 1e3:.1f} mm {where} than the model has it: check its depths"]


def verdict(findings: Findings, against: tuple[str, ...]) -> Verdict:
    """What the scan shows: a thing before an inlet that is otherwise where it should be occupies it."""
    e = findings.evidence
    if not against:
        return "port"
    if e.blocked > max(MIN_BLOCKED, e.inner) and e.violation <= MAX_VIOLATION and e.coverage >= MIN_COVERAGE:
        return "occupied"
    return "uncertain"


def supporting(findings: Findings) -> tuple[str, ...]:
    """What supports an accepted pose."""
    e = findings.evidence
    return (
        f"{e.coverage:.0%} of the port's outline has scan points where its surface is",
        f"{e.features_seen} of {e.features} contacts and wells are seen, {e.features_denied} contradicted",
        f"{e.violation:.0%} of the distinctive evidence contradicts",
        f"{e.roll_for} places speak for this roll and {e.roll_against} for its strongest rival",
        f"the next best pose scores {findings.margin:.0%} lower",
    )
