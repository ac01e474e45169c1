"""Exhaustive search over position and roll for a given mating axis, as a correlation computed with Fourier transforms.

The scan is voxelised in a frame whose z is the hypothesised axis; the model's signed volume (relief.py) is laid over it
at every position and a set of rolls. The best distinct places go on to alignment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy.ndimage import maximum_filter

from perception.estimate import Prior
from perception.geometry import Array, Pose
from perception.port_model import PortModel
from perception.relief import CELL_M, Templates, Volume

MARGIN_M = 0.005
"""The search goes this far beyond the prior's bounds, so that a port at the bound is a peak and not a slope."""


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
    found = list[Candidate]()
    for axis in axes:
        frame = axis_frame(axis)
        volume = _occupancy(points @ frame, low - reach, shape)
        spectrum = scipy.fft.rfftn(volume, workers=threads)
        steps = (2 * reach / CELL_M).astype(int) + 1
        score = np.empty((len(rolls), *steps), dtype=np.float32)
        for k, template in enumerate(spectra):
            score[k] = _inverse_corner(spectrum * template, shape, steps, threads)
        found += _peaks(score, frame, rolls, reach, prior, keep)
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
    return [np.conj(scipy.fft.rfftn(volume, s=(x, y, z), workers=threads)) for volume in templates.volumes], (x, y, z)


def _inverse_corner(spectrum: Array, shape: tuple[int, int, int], steps: Array, threads: int) -> Array:
    """The first ``steps`` (3,) values of the inverse transform along each axis; the rest is not computed to its end."""
    along_x = scipy.fft.ifft(spectrum, axis=0, overwrite_x=True, workers=threads)[: steps[0]]
    along_y = scipy.fft.ifft(along_x, axis=1, workers=threads)[:, : steps[1]]
    return np.asarray(scipy.fft.irfft(along_y, n=shape[2], axis=2, workers=threads)[..., : steps[2]])


def _occupancy(points: Array, low: Array, shape: tuple[int, int, int]) -> Volume:
    cell = np.floor((points - low) / CELL_M).astype(np.int64)
    cell = cell[((cell >= 0) & (cell < shape)).all(axis=1)]
    flat = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    counts = np.bincount(flat, minlength=int(np.prod(shape)))
    return np.minimum(counts, 2).astype(np.float32).reshape(shape) * np.float32(0.5)


def _peaks(score: Array, frame: Array, rolls: Array, reach: Array, prior: Prior, keep: int) -> list[Candidate]:
    best_roll = score.argmax(axis=0)
    best = score.max(axis=0)
    where = np.argwhere((best == maximum_filter(best, 5)) & (best > 0))
    offsets = (where * CELL_M - reach) @ frame.T
    allowed = (np.hypot(offsets[:, 0], offsets[:, 1]) < prior.lateral_m + MARGIN_M) & (
        np.abs(offsets[:, 2]) < prior.along_m + MARGIN_M
    )
    where, offsets = where[allowed], offsets[allowed]
    order = np.argsort(-best[tuple(where.T)])[:keep]
    candidates = []
    for place, offset in zip(where[order], offsets[order], strict=True):
        at = tuple(place)
        rotation = frame @ Pose.from_rotvec([0, 0, rolls[best_roll[at]]]).rotation
        candidates.append(Candidate(Pose(rotation, offset), float(best[at])))
    return candidates
