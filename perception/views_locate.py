"""The port in several scans of it: each located alone; what they say is held together, or they are merged.

Where the arm says from where each scan was taken and the port was found in some of them, these must agree, and their
mean is the answer: a merged scan carries the arm's error as a blur, and was located worse than each scan alone
(`portdock evaluate views`). Where it was found in none, or nobody says how the scans lie, they are registered to each
other and to the model and located as one; a scan in which nothing was found then has no say without the arm.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from perception.calibration.teaching import mean_pose
from perception.errors import InputError
from perception.estimate import PortEstimate, Prior
from perception.geometry import Pose
from perception.locate import LocateSettings, locate, prior_from_cloud
from perception.port_model import AcceptanceLimits, PortModel
from perception.scan import Cloud, Frame, merge
from perception.views_joint import register_views

_log = logging.getLogger(__name__)

_ARM_M, _ARM_RAD = 0.0015, float(np.deg2rad(0.6))
"""Registration may move a scan so much from where the arm says that it was taken; farther off it is not believed."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewsEstimate:
    """What several scans say together."""

    estimate: PortEstimate
    """In the first scan's frame."""
    cloud: Cloud
    """All scans that had a say, in the first scan's frame."""
    T_first_view: tuple[Pose, ...]
    """Of each scan as given; where it was left out: the arm's pose, or the first guess."""
    used: tuple[bool, ...]
    """Which are in the merged cloud."""
    alone: tuple[PortEstimate, ...]
    """Of each scan by itself, in its own frame."""


def locate_views(
    clouds: Sequence[Cloud],
    model: PortModel,
    prior: Prior | None = None,
    T_first_view: Sequence[Pose] | None = None,
    settings: LocateSettings | None = None,
) -> ViewsEstimate:
    """Finds the port in several scans of it.

    :param prior: where it is expected in the first scan's frame.
    :param T_first_view: where the arm says that each scan was taken, seen from the first; None: registration alone.
    :raises InputError: fewer than two scans.
    """
    if len(clouds) < 2:
        raise InputError("one scan cannot be merged", remedy="Give two scans of one port, or more.")
    alone = tuple(
        locate(cloud, model, _prior_of(k, cloud, prior, T_first_view), settings) for k, cloud in enumerate(clouds)
    )
    if T_first_view is None:
        used, T_port_views = _by_registration(alone)
    else:
        used, T_port_views = _by_arm(alone, T_first_view)
    chosen = [k for k, use in enumerate(used) if use]
    poses, fit = list(T_port_views), True
    if len(chosen) > 1:
        found = register_views([clouds[k].points for k in chosen], [poses[k] for k in chosen], model)
        if T_first_view is None or _agree(found, [T_first_view[k] for k in chosen]):
            for k, pose in zip(chosen, found, strict=True):
                poses[k] = pose
        else:
            fit = False
            _log.warning("the scans do not fit to each other where the arm says that they were taken")
    T_first = [poses[0].inverse() @ pose for pose in poses]
    frame = clouds[0].frame
    together = merge([clouds[k].transformed(T_first[k], frame) for k in chosen])
    if T_first_view is not None and any(one.accepted for one in alone):
        estimate = _mean(alone, T_first_view, frame, model.limits)
    else:
        estimate = locate(together, model, prior or prior_from_cloud(clouds[0]), settings)
        if not fit:  # merged where the arm has them they are a blur, which may pass for a port beside the true place
            estimate = _refused(estimate, "the scans do not fit to each other where the arm says that they were taken")
        elif not alone[0].accepted and T_first_view is None:
            estimate = _refused(estimate, "the port was not found in the first scan: give the arm's poses")
        elif alone[0].accepted and not estimate.accepted:
            estimate = alone[0]
    return ViewsEstimate(estimate, together, tuple(T_first), used, alone)


def _mean(
    alone: Sequence[PortEstimate], T_first_view: Sequence[Pose], frame: Frame, limits: AcceptanceLimits
) -> PortEstimate:
    """The mean of what was accepted, in the first scan's frame; refused where the scans do not agree."""
    chosen = [k for k, one in enumerate(alone) if one.accepted]
    found = [T_first_view[k] @ alone[k].T_ref_port for k in chosen]
    best = alone[min(chosen, key=lambda k: float(np.trace(alone[k].covariance[:3, :3])))]
    middle, count = mean_pose(found), len(found)
    apart_m = max(one.distance_to(other) for one in found for other in found)
    apart_rad = max(one.angle_to(other) for one in found for other in found)
    off = np.stack([(middle.inverse() @ one).vector for one in found])
    scatter = np.diag((off**2).sum(axis=0)) / max(1, count * (count - 1))
    covariance = np.mean([alone[k].covariance for k in chosen], axis=0) / count + scatter
    words = f"agree within {1e3 * apart_m:.2f} mm and {np.rad2deg(apart_rad):.2f} deg"
    says = f"the port was found in {count} of {len(alone)} scans" + (f", which {words}" if count > 1 else "")
    estimate = replace(
        best,
        T_ref_port=middle,
        ref=frame,
        covariance=covariance,
        reasons=(says, *best.reasons),
        runner_ups=(),
        timings_s=(("total", sum(one.elapsed_s for one in alone)),),
    )
    sigma_m, sigma_rad = (float(np.sqrt(np.trace(covariance[rows, rows]))) for rows in (slice(3), slice(3, 6)))
    uncertain = sigma_m > limits.max_translation_sigma_m or sigma_rad > limits.max_rotation_sigma_rad
    if uncertain or apart_m > _ARM_M or apart_rad > _ARM_RAD:
        apart = f"{1e3 * apart_m:.1f} mm and {np.rad2deg(apart_rad):.1f} deg"
        return _refused(estimate, f"the scans disagree about the port by {apart}: check hand-eye and the arm's poses")
    return estimate


def _refused(estimate: PortEstimate, reason: str) -> PortEstimate:
    reasons = (reason,) if estimate.accepted else (reason, *estimate.reasons)
    return replace(estimate, accepted=False, reasons=reasons, verdict="uncertain")


def _prior_of(k: int, cloud: Cloud, prior: Prior | None, T_first_view: Sequence[Pose] | None) -> Prior | None:
    """The prior in scan k's own frame, where it can be told."""
    if prior is None or k == 0:
        return prior
    if T_first_view is None:
        return None
    T_view_port = T_first_view[k].inverse() @ prior.T_ref_port
    return Prior(T_view_port, prior.lateral_m, prior.along_m, prior.tilt_rad, prior.roll_rad)


def _by_registration(alone: Sequence[PortEstimate]) -> tuple[tuple[bool, ...], list[Pose]]:
    """Each scan begins where the port was found in it; scans that found it count, and the first in any case."""
    used = tuple(k == 0 or estimate.accepted for k, estimate in enumerate(alone))
    return used, [estimate.T_ref_port.inverse() for estimate in alone]


def _by_arm(alone: Sequence[PortEstimate], T_first_view: Sequence[Pose]) -> tuple[tuple[bool, ...], list[Pose]]:
    """All scans count; they begin at the port as the most certain of them saw it."""
    best = min(range(len(alone)), key=lambda k: (not alone[k].accepted, float(np.trace(alone[k].covariance[:3, :3]))))
    T_first_port = T_first_view[best] @ alone[best].T_ref_port
    return tuple(True for _ in alone), [T_first_port.inverse() @ pose for pose in T_first_view]


def _agree(T_port_views: Sequence[Pose], T_first_view: Sequence[Pose]) -> bool:
    """Whether registration left the scans about where the arm says, seen from the first of them."""
    for found, told in zip(T_port_views, T_first_view, strict=True):
        offset = (T_first_view[0].inverse() @ told).inverse() @ (T_port_views[0].inverse() @ found)
        if np.linalg.norm(offset.translation) > _ARM_M or np.linalg.norm(offset.rotvec) > _ARM_RAD:
            return False
    return True
