"""The published method as a locator: a scan in metres in, a judged pose out. ``pipeline.locate_published`` is the door.

The method knows no acceptance: it returns a pose for anything. Here its pose has to earn acceptance twice. The default
locator's surface refinement, started at the pose, must agree with it; and the default locator's gate must find nothing
against it. A keypoint-only pose that is a millimetre off is therefore refused, not passed on.
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np

from perception.covariance import covariance
from perception.crop import Scene, crop
from perception.errors import DegenerateCloudError, EmptyScanError
from perception.estimate import PortEstimate, Prior
from perception.evidence import judge
from perception.gate import Findings, reasons_against
from perception.geometry import Array, Pose
from perception.port_model import PortModel
from perception.published.dense import subset
from perception.published.pipeline import Registration, register
from perception.published.profiles import MethodSettings
from perception.published.target import PreparedTarget, prepare_target
from perception.refine import Refined, refine
from perception.scan import Cloud

TARGET_POINTS = SCAN_POINTS = 10_000
_MAX_DISAGREEMENT_M = 0.0007
_MAX_DISAGREEMENT_RAD = float(np.deg2rad(0.6))
_MARGIN_MM = 8.0


def locate(cloud: Cloud, model: PortModel, prior: Prior | None, settings: MethodSettings) -> PortEstimate:
    """See ``pipeline.locate_published``."""
    begun = perf_counter()
    expected = prior or _facing(cloud)
    try:
        scene = crop(cloud, model, expected)
        points, target = _clouds(scene, model, settings)
        prepared = perf_counter()
        found = _register_twice(points, target, settings)
        registered = perf_counter()
        T_prior_port = _port_pose(found)
        refined = refine(T_prior_port, scene, model)
        judged = _judged(cloud, model, expected, scene, T_prior_port, refined, found)
    except (EmptyScanError, DegenerateCloudError) as error:
        spent = (("total", perf_counter() - begun),)
        return PortEstimate.nothing_found(model.name, expected, cloud.frame, str(error), spent)
    done = perf_counter()
    steps = (("prepare", prepared - begun), ("register", registered - prepared), ("judge", done - registered))
    return replace(judged, timings_s=(*steps, ("total", done - begun)))


def hypothesis(scene: Scene, model: PortModel, settings: MethodSettings) -> Pose:
    """T_prior_port as the method has it, for who judges it by other means.

    Raises EmptyScanError or DegenerateCloudError for a scan without keypoints.
    """
    return _port_pose(_register_twice(*_clouds(scene, model, settings), settings))


def _clouds(scene: Scene, model: PortModel, settings: MethodSettings) -> tuple[Array, PreparedTarget]:
    """The scan's points and the port as the target, millimetres."""
    target = prepare_target(subset(model.surface.points, TARGET_POINTS) * 1e3, settings)
    return subset(scene.thin_points, SCAN_POINTS) * 1e3, target


def _port_pose(found: Registration) -> Pose:
    pose = found.T_target_test.inverse()
    return Pose(pose.rotation, pose.translation / 1e3)


def _register_twice(points: Array, target: PreparedTarget, settings: MethodSettings) -> Registration:
    """Once with all that the prior allows, then again with what lies around the port found: surroundings mislead."""
    first = register(points, target, settings)
    low, high = target.points.min(axis=0) - _MARGIN_MM, target.points.max(axis=0) + _MARGIN_MM
    placed = first.T_target_test.apply(points)
    near = points[((placed > low) & (placed < high)).all(axis=1)]
    if len(near) < settings.neighbours or len(near) > 0.95 * len(points):
        return first
    return register(near, target, settings, start=first.T_target_test)


def _judged(
    cloud: Cloud,
    model: PortModel,
    prior: Prior,
    scene: Scene,
    pose: Pose,
    refined: Refined,
    found: Registration,
) -> PortEstimate:
    spread = covariance(refined)
    evidence = judge(pose, scene, model, refined.scale_m)
    findings = Findings(pose, spread, refined.rms_m, evidence, margin=1.0)
    against = (*_disagreement(pose, refined.T_prior_port), *reasons_against(findings, prior, model.limits))
    if not found.converged:
        against = (f"the method did not finish: {found.stopped}", *against)
    return PortEstimate(
        port=model.name,
        T_ref_port=prior.T_ref_port @ pose,
        ref=cloud.frame,
        covariance=spread,
        rms_residual_m=refined.rms_m,
        inlier_ratio=evidence.coverage,
        runner_up_margin=findings.margin,
        accepted=not against,
        reasons=against or (f"{evidence.coverage:.0%} of the port's outline has points that agree",),
        timings_s=(),
        verdict="uncertain" if against else "port",
    )


def _disagreement(pose: Pose, refined: Pose) -> tuple[str, ...]:
    """Whether the surface's own best fit is elsewhere."""
    shift, turn = pose.distance_to(refined), pose.angle_to(refined)
    if shift <= _MAX_DISAGREEMENT_M and turn <= _MAX_DISAGREEMENT_RAD:
        return ()
    return (f"the surface fits best {shift * 1e3:.1f} mm and {np.rad2deg(turn):.1f} deg away from the keypoints' pose",)


def _facing(cloud: Cloud) -> Prior:
    """A wide prior for a scan without one: the port faces the scanner in the middle of the scan."""
    return Prior(Pose(np.diag([1.0, -1.0, -1.0]), np.median(cloud.points, axis=0)), lateral_m=0.08, along_m=0.06)
