"""The default locator with steps of the published method before it, beside it or in its place: what each contributes.

Only ``keypoints-alone`` takes something away, the exhaustive search. A step that does not raise success, accuracy or
acceptance is left out of the default (docs/locator.md names them).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from perception.crop import Scene
from perception.errors import PortdockError
from perception.estimate import PortEstimate
from perception.evaluation.locate_cases import CaseScan
from perception.geometry import Array, Pose
from perception.locate import LocateSettings, locate
from perception.port_model import PortModel
from perception.published import clouds
from perception.published.denoise import keep_mask, noise_statistics
from perception.published.dense import subset
from perception.published.kdtree import AdaptiveKDTree
from perception.published.locating import SCAN_POINTS, TARGET_POINTS, hypothesis
from perception.published.pipeline import register
from perception.published.profiles import FAITHFUL, ROBUST
from perception.published.target import prepare_target
from perception.scan import Cloud

Variant = Callable[[CaseScan, PortModel, LocateSettings], PortEstimate]


def _denoised(scan: CaseScan, model: PortModel, settings: LocateSettings) -> PortEstimate:
    """Adaptive tree and denoising (1)-(8) in front."""
    return locate(cleaned(scan.cloud, ROBUST.feedback.kappa_0), model, scan.prior, settings)


def _keypoints(scan: CaseScan, model: PortModel, settings: LocateSettings) -> PortEstimate:
    """Keypoints (9)-(16) with their registration as one more source of hypotheses."""
    return locate(scan.cloud, model, scan.prior, replace(settings, propose=_by_keypoints))


def _keypoints_alone(scan: CaseScan, model: PortModel, settings: LocateSettings) -> PortEstimate:
    """Keypoints instead of the exhaustive search."""
    return locate(scan.cloud, model, scan.prior, replace(settings, propose=_by_keypoints, places=0))


def _fed_back(scan: CaseScan, model: PortModel, settings: LocateSettings) -> PortEstimate:
    """Where the evidence does not suffice: the loss (17) sets kappa (18), and the scan is cleaned by it."""
    first = locate(scan.cloud, model, scan.prior, settings)
    if first.accepted:
        return first
    kappa = _kappa_of_the_loss(scan, model, first)
    if kappa is None:
        return first
    again = locate(cleaned(scan.cloud, kappa), model, scan.prior, settings)
    return again if again.accepted else first


VARIANTS: dict[str, Variant] = {
    "denoised": _denoised,
    "keypoints": _keypoints,
    "keypoints-alone": _keypoints_alone,
    "fed-back": _fed_back,
}


def cleaned(cloud: Cloud, kappa: float) -> Cloud:
    """The cloud without what equations (1)-(8) call noise."""
    points_mm = clouds.in_millimetres(cloud.points, "m")
    tree = AdaptiveKDTree(points_mm)
    statistics = noise_statistics(tree, ROBUST.radius_spacings * clouds.spacing(tree, points_mm))
    keep = keep_mask(statistics, kappa, two_sided=ROBUST.two_sided)
    return Cloud(cloud.points[keep], cloud.frame, None if cloud.origins is None else cloud.origins[keep])


def _by_keypoints(scene: Scene, model: PortModel) -> list[Pose]:
    try:
        return [hypothesis(scene, model, ROBUST)]
    except PortdockError:
        return []  # no keypoints, no hypothesis


def _kappa_of_the_loss(scan: CaseScan, model: PortModel, found: PortEstimate) -> float | None:
    """What the published loop arrives at from the pose that was refused; None where it does not start."""
    local: Array = found.T_ref_port.inverse().apply(scan.cloud.points)
    low, high = model.size
    near = local[((local > low - 0.01) & (local < high + 0.01)).all(axis=1)]
    try:
        target = prepare_target(subset(model.surface.points, TARGET_POINTS) * 1e3, FAITHFUL)
        return register(subset(near, SCAN_POINTS) * 1e3, target, FAITHFUL).rounds[-1].kappa
    except PortdockError:
        return None
