"""The port in several scans of it: each located, all registered to each other and to the model, then located as one.

Where the arm says from where each scan was taken, its poses begin the registration and bound it; otherwise what was
found in each scan alone tells how the scans lie to each other, and a scan in which nothing was found has no say.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.errors import InputError
from perception.estimate import PortEstimate, Prior
from perception.geometry import Pose
from perception.locate import LocateSettings, locate, prior_from_cloud
from perception.port_model import PortModel
from perception.scan import Cloud, merge
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
    poses = list(T_port_views)
    if len(chosen) > 1:
        found = register_views([clouds[k].points for k in chosen], [poses[k] for k in chosen], model)
        if T_first_view is None or _agree(found, [T_first_view[k] for k in chosen]):
            for k, pose in zip(chosen, found, strict=True):
                poses[k] = pose
        else:
            _log.warning(
                "the scans do not fit to each other where the arm says that they were taken; the arm is believed"
            )
    T_first = [poses[0].inverse() @ pose for pose in poses]
    frame = clouds[0].frame
    together = merge([clouds[k].transformed(T_first[k], frame) for k in chosen])
    estimate = locate(together, model, prior or prior_from_cloud(clouds[0]), settings)
    return ViewsEstimate(estimate, together, tuple(T_first), used, alone)


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
