"""What speaks for and against a pose, place by place: scan points where the port should be, or where it cannot be.

Votes are taken cell by cell, so that a dense patch counts no more than a thin one, and a few flying points nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_erosion

from perception.crop import Scene
from perception.front_map import CELL_M, TOLERANCE_M, FrontMap
from perception.geometry import Array, Pose
from perception.port_model import PortModel
from perception.rivals import mirror_image, rival_roll, votes_of

VOTE_CELL_M = 0.0015
ABOVE_RIM_M = 0.003
"""Points higher than this over the rim plane are things in the way, and say nothing about the port."""
BLOCKS_M = 0.12
"""Within this height over the rim plane a thing before the inlet may be a plug."""
_BORE_LEAST = 6.0
"""Points that a filled bore would show, from which on its emptiness says something."""
_BORE_EMPTY, _BORE_FILLED = 0.25, 0.5
"""Shares of those points that an empty bore may show, and that a filled one must."""
MAX_DENIED = 0.25
"""Of the features that are seen or denied, so many may be denied."""
_DENIED_LEAST, _DENIED_SHARE = 4, 0.05
"""Points that deny a feature: at least so many, and this share of what the feature would show if it were filled."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Counts and shares; see the properties for what the gate asks."""

    agreeing: float
    """Weight of cells whose points lie where the port's surface is; weighted by how distinctive they are."""
    behind: float
    """Weight of cells whose points lie behind the surface: a ray passed through material."""
    before: float
    """Weight of cells whose points lie in space that the port leaves free."""
    coverage: float
    """Share of the port's outline, seen from the front, with points that agree."""
    features: int
    """Contact-sized features of the model."""
    features_seen: int
    """Those with agreeing points."""
    features_denied: int
    """Those with points that contradict them."""
    inner: float
    """Share of the inlet within the rim where points agree."""
    blocked: float
    """Share of the inlet within the rim before which something else lies."""
    roll_for: int
    """Points that decide between this roll and its strongest rival, and speak for this one."""
    roll_against: int
    roll_rival_rad: float
    """By how much the strongest rival is rolled."""
    reachable: int = 0
    """Features that no depth hides from a laser, bores among them."""
    reachable_seen: int = 0
    contacts: int = 0
    """Of the features, the tips within the inlet that stand free of what is around them."""
    contacts_seen: int = 0
    contacts_denied: int = 0
    mirror: tuple[int, int] | None = None
    """Points that speak for this port, and for its mirror image; None where a port is its own."""

    @property
    def violation(self) -> float:
        """Share of the distinctive evidence that contradicts, 0 to 1."""
        return (self.behind + self.before) / max(self.agreeing + self.behind + self.before, 1e-9)

    @property
    def doubtful(self) -> bool:
        """Whether the pose looks like one that stopped on its way: features are denied, or another roll is as good."""
        denied = self.features_denied > MAX_DENIED * (self.features_seen + self.features_denied)
        return denied or self.roll_against >= max(self.roll_for, 1)

    @property
    def roll_margin(self) -> float:
        """1: every deciding point speaks for this roll; 0: as many for the rival."""
        total = self.roll_for + self.roll_against
        return (self.roll_for - self.roll_against) / total if total else 0.0


def score(pose: Pose, points: Array, model: PortModel) -> float:
    """One number to rank poses by: agreeing minus contradicting points (N, 3), as a share of the model's outline."""
    local = pose.inverse().apply(points)
    misfit = model.front.misfit(local)
    known = ~np.isnan(misfit) & (local[:, 2] < ABOVE_RIM_M)
    cell = np.floor(local[known, :2] / VOTE_CELL_M).astype(np.int64)
    cell -= cell.min(axis=0, initial=0)
    vote = np.where(np.abs(misfit[known]) < TOLERANCE_M, 1.0, -1.0)
    total = np.sign(np.bincount(cell[:, 0] * (cell[:, 1].max(initial=0) + 1) + cell[:, 1], vote))
    return float(total.sum() * VOTE_CELL_M**2 / max(np.isfinite(model.front.lowest).sum() * CELL_M**2, 1e-9))


def judge(pose: Pose, scene: Scene, model: PortModel, noise_m: float) -> Evidence:
    """The evidence for T_prior_port = ``pose`` in a scan with the given noise (1 sigma)."""
    front = model.front
    tolerance = max(TOLERANCE_M, 3.5 * noise_m)
    local = pose.inverse().apply(scene.points)
    misfit = front.misfit(local)
    inner, blocked = _inner(front, local, misfit, tolerance)
    known = ~np.isnan(misfit) & (local[:, 2] < ABOVE_RIM_M)
    local, misfit = local[known], misfit[known]
    i, j, _ = front.cells(local)
    cell = np.unique((i // 3) * 100_000 + j // 3, return_inverse=True)[1].reshape(-1)
    states = (np.abs(misfit) < tolerance, misfit <= -tolerance, misfit >= tolerance)
    counts = [np.bincount(cell[state], minlength=int(cell.max(initial=0)) + 1) for state in states]
    weight = np.bincount(cell, front.distinct[i, j]) / np.maximum(np.bincount(cell), 1)
    good, behind, before = _votes(counts)
    seen, denied = _features(front, i, j, misfit, tolerance)
    empty, filled = _bores(front, i, j, misfit, tolerance)
    contacts, reachable = model.contacts - 1, front.reachable
    votes = votes_of(local, misfit, cell, tolerance)
    rival, roll_for, roll_against = rival_roll(votes, front)
    outline = np.isfinite(front.lowest).sum() * CELL_M**2
    return Evidence(
        float(weight[good].sum()),
        float(weight[behind].sum()),
        float(weight[before].sum()),
        min(float(good.sum()) * (3 * CELL_M) ** 2 / outline, 1.0),
        front.features + front.bores,
        int(seen.sum()) + empty,
        int(denied.sum()) + filled,
        inner,
        blocked,
        roll_for,
        roll_against,
        rival,
        int(reachable.sum()) + front.bores,
        int(seen[reachable].sum()) + empty,
        len(contacts),
        int(seen[contacts].sum()),
        int(denied[contacts].sum()),
        mirror_image(votes, front) if model.handed else None,
    )


def _votes(counts: list[NDArray[np.int64]]) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    agree, behind, before = counts
    good = (agree >= behind + before) & (agree > 0)
    return good, ~good & (behind >= before) & (behind >= 2), ~good & (before > behind) & (before >= 2)


def _inner(front: FrontMap, local: Array, misfit: Array, tolerance: float) -> tuple[float, float]:
    """Shares of the inlet within the rim that points confirm, and before which other points lie at any height."""
    i, j, _ = front.cells(local)
    within = front.inner[i, j] & ~np.isnan(misfit) & (local[:, 2] < BLOCKS_M)
    cell = np.unique((i[within] // 3) * 100_000 + j[within] // 3, return_inverse=True)[1].reshape(-1)
    agree = np.bincount(cell, np.abs(misfit[within]) < tolerance)
    before = np.bincount(cell, misfit[within] >= tolerance)
    x, y = np.nonzero(front.inner)
    whole = max(len(np.unique((x // 3) * 100_000 + y // 3)), 1)
    return float((agree > before).sum()) / whole, float(((before >= agree) & (before >= 2)).sum()) / whole


def _features(
    front: FrontMap, i: NDArray[np.int64], j: NDArray[np.int64], misfit: Array, tolerance: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which contact-sized features (F,) have points that agree, and which have points that contradict.

    A well whose floor the laser does not reach has a few flying points of its edges, and nothing that agrees.
    """
    number = front.feature[i, j].astype(np.int64)
    solid = np.maximum(number, 0)
    agree = np.bincount(solid, np.abs(misfit) < tolerance, minlength=front.features + 1)[1:]
    against = np.bincount(solid, np.abs(misfit) >= tolerance, minlength=front.features + 1)[1:]
    size = np.bincount(np.maximum(front.feature, 0).ravel(), minlength=front.features + 1)[1:]
    filled_shows = size * len(i) / max(len(np.unique(i * front.feature.shape[1] + j)), 1)
    enough = against >= np.maximum(_DENIED_LEAST, _DENIED_SHARE * filled_shows)
    return (agree >= 2) & (agree > 2 * against), enough & (against > 2 * agree)


def _bores(
    front: FrontMap, i: NDArray[np.int64], j: NDArray[np.int64], misfit: Array, tolerance: float
) -> tuple[int, int]:
    """How many bores are seen to be empty, and how many have something in them.

    A laser that enters a bore is hardly ever seen coming back: emptiness is that points stop at its edge. It counts
    where the surface around is seen so densely that a filled bore would show.
    """
    bore = np.maximum(-front.feature[i, j].astype(np.int64), 0)
    empty = filled = 0
    hits = np.zeros(front.feature.shape)
    np.add.at(hits, (i, j), np.abs(misfit) < tolerance)
    for k in range(1, front.bores + 1):
        patch = front.feature == -k
        core = binary_erosion(patch)
        ring = binary_dilation(patch, iterations=4) & ~binary_dilation(patch, iterations=2)
        expected = float(hits[ring].mean()) * int(core.sum())
        found = int(((bore == k) & core[i, j] & (misfit >= tolerance)).sum())
        if expected >= _BORE_LEAST:
            empty += found < _BORE_EMPTY * expected
            filled += found > _BORE_FILLED * expected
    return empty, filled
