"""The default locator: a scan and a port model in, a judged pose out, as a sequence of named steps.

crop -> axis hypotheses -> exhaustive search -> alignment of the best candidates -> choice -> refinement and evidence,
again while the one doubts the other -> covariance -> gate; a refusal looks at what is there instead. Each step has its
module.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from perception.align import align
from perception.closed_panel import SKIN_REASONS, closed_panel
from perception.covariance import covariance
from perception.crop import Scene, crop
from perception.errors import DegenerateCloudError, EmptyScanError
from perception.estimate import PortEstimate, Prior
from perception.evidence import Evidence, judge, score
from perception.gate import Findings, reasons_against, supporting, verdict
from perception.geometry import Array, Pose
from perception.hypotheses import axis_hypotheses
from perception.port_model import PortModel
from perception.refine import Refined, refine
from perception.relief import flat_weights
from perception.scan import Cloud
from perception.search import search
from perception.spread import spread

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class LocateSettings:
    """What the steps may spend."""

    axes: int = 6
    """Mating-axis hypotheses."""
    places: int = 8
    """Places kept for each axis."""
    candidates: int = 12
    """Candidates that are aligned."""
    finalists: int = 4
    """Candidates that are aligned further before one is chosen."""
    second_looks: int = 2
    """How often a refined pose that the evidence doubts is refined again."""
    align_points: int = 1500
    """Scan points that align them."""
    threads: int = 2
    propose: Callable[[Scene, PortModel], Sequence[Pose]] | None = None
    """A further source of hypotheses: T_prior_port of places worth aligning. With ``places`` 0 the only one."""
    clock: Callable[[], float] = field(default=perf_counter)


@dataclass(slots=True)
class _Timer:
    clock: Callable[[], float]
    laps: list[tuple[str, float]] = field(default_factory=list)
    start: float = 0.0
    last: float = 0.0

    def __post_init__(self) -> None:
        self.start = self.last = self.clock()

    def lap(self, step: str) -> None:
        now = self.clock()
        self.laps.append((step, now - self.last))
        self.last = now

    def done(self) -> tuple[tuple[str, float], ...]:
        return (*self.laps, ("total", self.clock() - self.start))


def locate(
    cloud: Cloud,
    model: PortModel | Sequence[PortModel],
    prior: Prior | None = None,
    settings: LocateSettings | None = None,
) -> PortEstimate:
    """Finds the port in a scan.

    :param cloud: the scan, metres.
    :param model: the port to find, or several of which the best-fitting one is reported.
    :param prior: where it is expected; None searches the whole scan.
    :returns: an estimate in the cloud's frame; a refusal is an estimate with ``accepted`` False and its reasons.
    """
    settings = settings or LocateSettings()
    if isinstance(model, PortModel):
        return _locate_one(cloud, model, prior or prior_from_cloud(cloud), settings)
    estimates = [_locate_one(cloud, one, prior or prior_from_cloud(cloud), settings) for one in model]
    return max(estimates, key=lambda estimate: (estimate.accepted, estimate.inlier_ratio))


def prior_from_cloud(cloud: Cloud) -> Prior:
    """A wide prior for a scan without one: the port faces the scanner somewhere near the middle of the scan."""
    middle = np.median(cloud.points, axis=0)
    return Prior(Pose(np.diag([1.0, -1.0, -1.0]), middle), lateral_m=0.08, along_m=0.06)


def _locate_one(cloud: Cloud, model: PortModel, prior: Prior, settings: LocateSettings) -> PortEstimate:
    timer = _Timer(settings.clock)
    try:
        scene = crop(cloud, model, prior, settings.threads)
        timer.lap("crop")
        axes = axis_hypotheses(scene.thin_normals, prior.tilt_rad, settings.axes)
        timer.lap("axes")
        places = _places(axes, scene, model, prior, settings)
        timer.lap("search")
        ranked = _align_and_rank(places, scene, model, settings)
        timer.lap("align")
        refined, evidence = _refine_and_judge(ranked[0][1], scene, model, settings)
        timer.lap("refine")
    except (EmptyScanError, DegenerateCloudError) as error:
        _log.info("not located: %s", error)
        nothing = PortEstimate.nothing_found(model.name, prior, cloud.frame, str(error), timer.done())
        return _with_what_is_there(nothing, cloud, prior, timer)
    judged = _judged(cloud, model, prior, scene, ranked, refined, evidence, timer)
    return _with_what_is_there(judged, cloud, prior, timer)


def _with_what_is_there(estimate: PortEstimate, cloud: Cloud, prior: Prior, timer: _Timer) -> PortEstimate:
    """A refusal says more where the scan shows closed skin: a closed cover wants opening, plain skin another place."""
    if estimate.accepted or estimate.verdict == "occupied":
        return estimate
    seen = closed_panel(cloud.points, prior)
    timer.lap("closed skin")
    if seen is not None:
        estimate = replace(estimate, verdict=seen, reasons=(SKIN_REASONS[seen], *estimate.reasons))
    return replace(estimate, timings_s=timer.done())


def _places(axes: Array, scene: Scene, model: PortModel, prior: Prior, settings: LocateSettings) -> list[Pose]:
    """T_prior_port of the places that are worth aligning."""
    proposed = [] if settings.propose is None else list(settings.propose(scene, model))
    if settings.places == 0:
        return proposed
    found = search(scene.thin_points, axes, model, prior, keep=settings.places, threads=settings.threads)
    return [*proposed, *(candidate.T_prior_port for candidate in found[: settings.candidates])]


def _align_and_rank(
    places: list[Pose], scene: Scene, model: PortModel, settings: LocateSettings
) -> list[tuple[float, Pose]]:
    """Aligned poses with their scores, best first. Raises DegenerateCloudError without any candidate."""
    if not places:
        raise DegenerateCloudError("nothing within the prior's bounds resembles the port")
    chosen = _subset(scene, settings.align_points)
    weights = np.append(flat_weights(model.surface) * model.decides, 0.0)
    points, normals = scene.thin_points[chosen], scene.thin_normals[chosen]
    ranked = _ranked(align(places, points, normals, model, weights), scene, model, settings)
    # Some are still on their way: the best ones go on before the choice is made.
    best = [pose for _, pose in ranked[: settings.finalists]]
    again = _ranked(align(best, points, normals, model, weights), scene, model, settings)
    return sorted([*again, *ranked[settings.finalists :]], key=lambda entry: -entry[0])


def _ranked(
    poses: Sequence[Pose], scene: Scene, model: PortModel, settings: LocateSettings
) -> list[tuple[float, Pose]]:
    scores = spread(lambda pose: score(pose, scene.thin_points, model), poses, settings.threads)
    return sorted(zip(scores, poses, strict=True), key=lambda entry: -entry[0])


def _refine_and_judge(
    start: Pose, scene: Scene, model: PortModel, settings: LocateSettings
) -> tuple[Refined, Evidence]:
    """The refined pose and what speaks for and against it. Raises DegenerateCloudError.

    What looks as if it had stopped on its way is refined again, from there or from the roll that explains it better,
    as long as that finds better.
    """
    refined = refine(start, scene, model, threads=settings.threads)
    evidence = judge(refined.T_prior_port, scene, model, refined.scale_m)
    for _ in range(settings.second_looks):
        pose, rival = refined.T_prior_port, evidence.roll_against >= max(evidence.roll_for, 1)
        if not evidence.doubtful:
            break
        roll = Pose.from_rotvec([0.0, 0.0, evidence.roll_rival_rad if rival else 0.0])
        try:
            other = refine(pose @ roll, scene, model, threads=settings.threads)
        except DegenerateCloudError:
            break
        if score(other.T_prior_port, scene.thin_points, model) <= score(pose, scene.thin_points, model):
            break
        refined, evidence = other, judge(other.T_prior_port, scene, model, other.scale_m)
    return refined, evidence


def _subset(scene: Scene, count: int) -> NDArray[np.int64]:
    """Evenly spread numbers of thinned points."""
    return np.unique(np.linspace(0, len(scene.thin_points) - 1, count).astype(np.int64))


def _judged(
    cloud: Cloud,
    model: PortModel,
    prior: Prior,
    scene: Scene,
    ranked: list[tuple[float, Pose]],
    refined: Refined,
    evidence: Evidence,
    timer: _Timer,
) -> PortEstimate:
    pose = refined.T_prior_port
    cov = covariance(refined)
    timer.lap("covariance")
    margin = _margin(score(pose, scene.thin_points, model), pose, ranked)
    findings = Findings(
        pose,
        cov,
        refined.rms_m,
        evidence,
        margin,
        distortion=refined.distortion,
        depth_dispute_m=refined.depth_dispute_m,
    )
    against = reasons_against(findings, prior, model.limits)
    timer.lap("evidence")
    return PortEstimate(
        port=model.name,
        T_ref_port=prior.T_ref_port @ pose,
        ref=cloud.frame,
        covariance=cov,
        rms_residual_m=refined.rms_m,
        inlier_ratio=evidence.coverage,
        runner_up_margin=margin,
        accepted=not against,
        reasons=against or supporting(findings),
        timings_s=timer.done(),
        verdict=verdict(findings, against),
        runner_ups=tuple((score, prior.T_ref_port @ other) for score, other in _others(pose, ranked)[:3]),
    )


def _others(pose: Pose, ranked: list[tuple[float, Pose]]) -> list[tuple[float, Pose]]:
    """The candidates that are not this pose. Rolls less than 20 deg off are none: refinement compared them outright."""
    return [(score, other) for score, other in ranked if other.distance_to(pose) > 0.004 or other.angle_to(pose) > 0.35]


def _margin(best: float, pose: Pose, ranked: list[tuple[float, Pose]]) -> float:
    """How far the best pose that is not this one scores below it, as a share of its score."""
    if best <= 0:
        return 0.0
    others = [score for score, _ in _others(pose, ranked)]
    return float(np.clip(1.0 - max(others, default=0.0) / best, 0.0, 1.0))
