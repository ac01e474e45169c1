"""The published method from scan to pose, in the paper's order. Millimetres inside; ``locate_published`` takes metres.

scan -> tree (1)-(3) -> eta (4)-(7) -> keep (8) -> features (9)-(13) -> keypoints (14)-(16) -> ICP, loss (17)
                                        ^                                                        |
                                        +---------------------- kappa (18) ----------------------+
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field

import numpy as np

from perception.estimate import PortEstimate, Prior
from perception.geometry import Array, Pose
from perception.port_model import PortModel
from perception.published import clouds, dense
from perception.published.denoise import NoiseStatistics, keep_mask, noise_statistics
from perception.published.features import eigen_features
from perception.published.feedback import FeedbackCollapsedError, next_kappa, normalised_loss, stop_reason
from perception.published.kdtree import AdaptiveKDTree
from perception.published.kdtree_numpy import Mask
from perception.published.keypoints import Keypoints, extract_keypoints
from perception.published.profiles import MethodSettings, ProfileName, profile
from perception.published.registration import IcpResult, IcpSettings, keypoint_icp, trimmed_distance
from perception.published.starts import start_poses
from perception.published.target import PreparedTarget, prepare_target
from perception.scan import Cloud

_log = logging.getLogger(__name__)

_RANKED_POINTS = 3000
_COARSE_POINTS = 600
_COARSE = IcpSettings(max_iterations=20, trims=(1.0,))


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """What one round of the loop did. Lengths in mm."""

    kappa: float
    kept: Mask
    """(N,) which points of the scan stayed (8)."""
    keypoints: int
    loss_mm2: float
    """Equation (17) on the round's own keypoints."""
    T_target_test: Pose
    score_mm2: float
    """Trimmed mean squared distance of the first round's cloud to the target: what ranks the rounds."""
    T_target_test_so_far: Pose
    """What the method would return if it ended here."""
    elapsed_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The method's answer and how it came about."""

    T_target_test: Pose
    """Translation in mm: ``x_target = R x_test + t``."""
    score_mm2: float
    kept: Mask
    """(N,) the cleaned scan of the round that is returned."""
    rounds: tuple[Round, ...]
    stopped: str
    """Why the loop ended."""
    dropped: int
    """Points that were not finite."""
    converged: bool
    """False if no round gave a valid registration, or (18) collapsed: then the pose is not to be used."""


@dataclass(slots=True, eq=False)
class _State:
    """The scan and what the rounds so far have found."""

    points: Array
    tree: AdaptiveKDTree
    noise: NoiseStatistics | None
    target: PreparedTarget
    settings: MethodSettings
    rng: np.random.Generator
    pose: Pose
    ranked: Array = field(default_factory=lambda: np.empty((0, 3)))
    rounds: list[Round] = field(default_factory=list)


def register(
    test_mm: Array,
    target_mm: Array | PreparedTarget,
    settings: ProfileName | MethodSettings = "faithful",
    rng: np.random.Generator | None = None,
    start: Pose | None = None,
) -> Registration:
    """Registers a test cloud (N, 3) to a target cloud (M, 3), both in millimetres.

    :param target_mm: points, or the target prepared with the same settings.
    :param rng: used by the control ``jitter`` only.
    :param start: T_target_test to begin with, translation in mm; identity if None.
    :raises UnitError: a cloud is not in millimetres.
    :raises EmptyScanError, DegenerateCloudError: a cloud cannot determine a pose.
    """
    chosen = profile(settings) if isinstance(settings, str) else settings
    target = target_mm if isinstance(target_mm, PreparedTarget) else prepare_target(target_mm, chosen)
    state = _prepare(test_mm, target, chosen, rng or np.random.default_rng(0), start or Pose.identity())
    kappa, best_scores = chosen.feedback.kappa_0, [float("inf")]
    while True:
        done = _round(state, kappa)
        best_scores.append(min(best_scores[-1], done.score_mm2))
        eps_n = normalised_loss(done.loss_mm2, 2.0 * target.keypoint_spacing)
        stopped = stop_reason(kappa, done.kept.mean(), eps_n, best_scores[1:], chosen.feedback)
        if stopped:
            return _answer(state, stopped)
        try:
            kappa = next_kappa(kappa, done.loss_mm2, 2.0 * target.keypoint_spacing, chosen.feedback)  # (18)
        except FeedbackCollapsedError as error:
            _log.warning("%s", error)
            return _answer(state, str(error), collapsed=True)


def locate_published(
    cloud: Cloud, model: PortModel, prior: Prior | None = None, profile_name: ProfileName = "robust"
) -> PortEstimate:
    """The port's pose by the published method; a refusal is an estimate with ``accepted`` False and its reasons.

    :param cloud: the scan, metres.
    :param prior: where the port is expected; None takes the middle of the scan, facing the scanner.
    """
    from perception.published.locating import locate  # it builds on this module

    return locate(cloud, model, prior, profile(profile_name))


def _prepare(
    test_mm: Array, target: PreparedTarget, settings: MethodSettings, rng: np.random.Generator, start: Pose
) -> _State:
    """Tree and noise statistics, once for a scan: neither changes with kappa."""
    points = clouds.in_millimetres(test_mm)
    finite = points[np.isfinite(points).all(axis=1)]
    clouds.check_shape(finite, settings.neighbours)
    tree = AdaptiveKDTree(points, split=settings.split)  # (1)-(3)
    noise = None
    if settings.denoise:
        noise = noise_statistics(tree, settings.radius_spacings * clouds.spacing(tree, points))  # (4)-(7)
    return _State(points, tree, noise, target, settings, rng, start)


def _round(state: _State, kappa: float) -> Round:
    """One round: keep (8), features (9)-(13), keypoints (14)-(16), registration (17)."""
    begun = time.perf_counter()
    keep = _kept(state, kappa)
    state.tree.keep_only(keep)
    kept, _, neighbours = state.tree.knn_of_kept(state.settings.neighbours)
    features = eigen_features(state.points, neighbours)
    keypoints = extract_keypoints(state.points[kept], features, state.target.settings, state.target.scale)
    if not state.rounds:
        state.ranked = dense.subset(state.points[kept], _RANKED_POINTS)
    result = _align(state, keypoints)
    pose = result.T_target_test
    if state.settings.dense:
        pose = _refined(state, pose, dense.MAX_POINTS, dense.GATES_SPACINGS)
    score = _score(state, state.ranked, pose) if result.valid else float("inf")
    if score < min((r.score_mm2 for r in state.rounds), default=float("inf")) or not state.settings.best_of_rounds:
        state.pose = pose
    done = Round(kappa, keep, len(keypoints), result.loss_mm2, pose, score, state.pose, time.perf_counter() - begun)
    state.rounds.append(done)
    return done


def _kept(state: _State, kappa: float) -> Mask:
    """Equation (8), or what a control does in its place."""
    feedback = state.settings.feedback
    if state.noise is None:
        keep = np.asarray(np.isfinite(state.points).all(axis=1))
    else:
        keep = keep_mask(state.noise, kappa, two_sided=state.settings.two_sided)
    if feedback.rule == "jitter":
        keep = keep & (state.rng.random(len(keep)) >= feedback.jitter_fraction)
    return keep


def _align(state: _State, keypoints: Keypoints) -> IcpResult:
    """Keypoint ICP from the best pose so far, in the first round from several starts where the settings say so."""
    tree, icp = state.target.keypoint_tree, state.settings.icp
    if not state.settings.many_starts or state.rounds:
        return keypoint_icp(keypoints.points, tree, [state.pose], icp)[0]
    starts = start_poses(state.points[state.tree.kept], state.target.points, state.pose)
    every_second = keypoints.points[::2]  # neighbours in the list are neighbours in space
    coarse = [result for result in keypoint_icp(every_second, tree, starts, _COARSE) if result.valid]
    if not coarse:
        return keypoint_icp(keypoints.points, tree, [state.pose], icp)[0]
    sample = dense.subset(state.ranked, _COARSE_POINTS)
    coarse.sort(key=lambda r: _score(state, sample, r.T_target_test))
    best = [result.T_target_test for result in coarse[: state.settings.refine_top]]
    results = keypoint_icp(keypoints.points, tree, best, icp)

    def score(result: IcpResult) -> float:
        pose = result.T_target_test
        if state.settings.dense:
            pose = _refined(state, pose, _COARSE_POINTS, dense.GATES_SPACINGS[:3])
        return _score(state, state.ranked, pose)

    return min(results, key=score)


def _score(state: _State, points: Array, pose: Pose) -> float:
    return trimmed_distance(points, state.target.tree, pose, state.settings.ranked_share)


def _refined(state: _State, pose: Pose, limit: int, gates_spacings: tuple[float, ...]) -> Pose:
    target = state.target
    gates = [gate * target.spacing for gate in gates_spacings]
    return dense.refine(dense.subset(state.ranked, limit), target.points, target.normals, target.tree, pose, gates)


def _answer(state: _State, stopped: str, *, collapsed: bool = False) -> Registration:
    """The best round, or the last one where the settings ask for it."""
    chosen = min(state.rounds, key=lambda r: r.score_mm2) if state.settings.best_of_rounds else state.rounds[-1]
    return Registration(
        chosen.T_target_test,
        chosen.score_mm2,
        chosen.kept,
        tuple(state.rounds),
        stopped,
        state.tree.dropped,
        converged=np.isfinite(chosen.score_mm2) and not collapsed,
    )
