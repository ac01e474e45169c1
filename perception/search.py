"""Exhaustive search over position and roll for a given mating axis, as a correlation computed with Fourier transforms.

The scan is voxelised in a frame whose z is the hypothesised axis; the model's signed volume (relief.py) is laid over it
at every position and a set of rolls. The best distinct places go on to alignment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from perception.estimate import Prior
from perception.geometry import Array, Pose
from perception.port_model import PortModel
from perception.relief import CELL_M, Templates, Volume
from perception.spread import spread

MARGIN_M = 0.005
"""The search goes this far beyond the prior's bounds, so that a port at the bound is a peak and not a slope."""
_APART_CELLS = 3
"""Places no further apart than this along any axis lead alignment to the same pose."""
_MOST = 20_000
"""Places that are looked at for distinct ones: the best so many."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A pose worth a closer look, with the correlation that found it."""

    T_prior_port: Pose
    score: float


def search(
    points: Array, axes: Array, model: PortModel, prior: Prior, *, keep: int = 12, threads: int = 2
) -> list[Candidate]:
    """The ``keep`` best distinct places for each axis, best first.

    :param points: (N, 3) thinned scan in the prior frame.
    :param axes: (K, 3) hypothesised mating axes.
    """
    templates = model.templates_for(prior.roll_rad)
    reach = _reach(prior)
    spectra, shape = _spectra(templates, reach, threads)
    rolls, low = templates.rolls, templates.low
    steps = (2 * reach / CELL_M).astype(int) + 1

    def along(axis: Array) -> list[Candidate]:
        frame = axis_frame(axis)
        spectrum = scipy.fft.rfftn(_occupancy(points @ frame, low - reach, shape))
        score = np.empty((len(rolls), *steps), dtype=np.float32)
        for k, template in enumerate(spectra):
            score[k] = _inverse_corner(spectrum * template, shape, steps)
        return _best_places(score, frame, rolls, reach, prior, keep)

    found = [candidate for candidates in spread(along, axes, threads) for candidate in candidates]
    return sorted(found, key=lambda candidate: -candidate.score)


def axis_frame(axis: Array) -> Array:
    """Rotation (3, 3) whose third column is ``axis``, turned as little as possible from the identity."""
    return (
        Pose.from_rotvec(np.array([-axis[1], axis[0], 0.0]) * _arc(axis)).rotation if axis[2] < 1 - 1e-12 else np.eye(3)
    )


def _arc(axis: Array) -> float:
    sine = float(np.hypot(axis[0], axis[1]))
    return float(np.arctan2(sine, axis[2])) / sine


def _reach(prior: Prior) -> Array:
    """Half the search range along the axes of a tilted frame, which holds the prior's range and a margin."""
    sine = np.sin(prior.tilt_rad)
    side, along = prior.lateral_m + MARGIN_M, prior.along_m + MARGIN_M
    return np.array([side + along * sine, side + along * sine, along + side * sine])


def _spectra(templates: Templates, reach: Array, threads: int) -> tuple[list[Array], tuple[int, int, int]]:
    """Conjugate spectra of the templates, and the shape they are padded to, which holds the search range as well."""
    padded = np.array(templates.volumes.shape[1:]) + np.ceil(2 * reach / CELL_M).astype(int) + 1
    x, y, z = (int(scipy.fft.next_fast_len(int(n), real=True)) for n in padded)
    spectra = spread(lambda volume: np.conj(scipy.fft.rfftn(volume, s=(x, y, z))), templates.volumes, threads)
    return spectra, (x, y, z)


def _inverse_corner(spectrum: Array, shape: tuple[int, int, int], steps: Array) -> Array:
    """The first ``steps`` (3,) values of the inverse transform along each axis; the rest is not computed to its end."""
    along_x = scipy.fft.ifft(spectrum, axis=0, overwrite_x=True)[: steps[0]]
    along_y = scipy.fft.ifft(along_x, axis=1)[:, : steps[1]]
    return np.asarray(scipy.fft.irfft(along_y, n=shape[2], axis=2)[..., : steps[2]])


def _occupancy(points: Array, low: Array, shape: tuple[int, int, int]) -> Volume:
    cell = np.floor((points - low) / CELL_M).astype(np.int64)
    cell = cell[((cell >= 0) & (cell < shape)).all(axis=1)]
    flat = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    counts = np.bincount(flat, minlength=int(np.prod(shape)))
    return np.minimum(counts, 2).astype(np.float32).reshape(shape) * np.float32(0.5)


def _apart(where: NDArray[np.int64], value: Array, keep: int) -> list[int]:
    """Numbers of the best places (N, 3), none within reach of alignment from a better one.

    Not the peaks: on a flat that is larger than the port the right place may lie on the slope of another.
    """
    left = np.argsort(-value)[:_MOST]
    chosen: list[int] = []
    while len(left) and len(chosen) < keep:
        chosen.append(int(left[0]))
        left = left[np.abs(where[left] - where[left[0]]).max(axis=1) > _APART_CELLS]
    return chosen


def _best_places(score: Array, frame: Array, rolls: Array, reach: Array, prior: Prior, keep: int) -> list[Candidate]:
    best_roll = score.argmax(axis=0)
    best = score.max(axis=0)
    where = np.argwhere(best > 0)
    offsets = (where * CELL_M - reach) @ frame.T
    allowed = (np.hypot(offsets[:, 0], offsets[:, 1]) < prior.lateral_m + MARGIN_M) & (
        np.abs(offsets[:, 2]) < prior.along_m + MARGIN_M
    )
    where, offsets = where[allowed], offsets[allowed]
    order = _apart(where, best[tuple(where.T)], keep)
    candidates = []
    for place, offset in zip(where[order], offsets[order], strict=True):
        at = tuple(place)
        rotation = frame @ Pose.from_rotvec([0, 0, rolls[best_roll[at]]]).rotation
        candidates.append(Candidate(Pose(rotation, offset), float(best[at])))
    return candidates
