"""Recorded sweeps as .npz files: a small scan with its truth, for tests, replay by a mock scanner, and a first try.

Arrays: ``points`` and ``origins`` (N, 3) in the scanner frame at mid-sweep, ``T_scanner_port`` and ``prior`` (4, 4),
``port`` (name), and the same measurements as profiles: ``profile_x_m`` and ``profile_z_m`` (K, M) in each profile's own
laser plane, NaN where nothing was measured, and ``profile_y_m`` (K,), the scanner's place along the sweep.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from perception.errors import ScanFileError
from perception.evaluation.scenes import SimulatedScan
from perception.geometry import Array, Pose
from perception.scan import Cloud

_GRID_M = 2.0**-17
"""Coordinates are rounded to this (8 um, far below the noise): the file is half as long."""
_REACH_M = 0.095
"""How far from the middle of the scan points are kept."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedSweep:
    """A sweep read back; what a file does not hold is None."""

    cloud: Cloud
    T_scanner_port: Pose | None
    prior: Pose | None
    """T_scanner_port as a site would expect it."""
    port: str | None


def read_sweep(path: Path | str) -> RecordedSweep:
    """Read a recorded sweep. Raises ScanFileError where the file is missing or is none."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            points = np.asarray(archive["points"], dtype=np.float64)
            origins = np.asarray(archive["origins"], dtype=np.float64) if "origins" in archive else None
            poses = [Pose.from_matrix(archive[k]) if k in archive else None for k in ("T_scanner_port", "prior")]
            port = str(archive["port"]) if "port" in archive else None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ScanFileError(f"{path} is no recorded sweep: {error}") from error
    if points.ndim != 2 or points.shape[1] != 3:
        raise ScanFileError(f"{path} is no recorded sweep: its points are not (N, 3)")
    return RecordedSweep(Cloud(points, "scanner", origins), poses[0], poses[1], port)


def write_sweep(path: Path | str, scan: SimulatedScan, *, every: int = 3) -> int:
    """Write the middle of a simulated sweep, every n-th ray of its profiles; returns the number of points."""
    near = (np.abs(scan.cloud.points[:, :2]) < _REACH_M).all(axis=1)
    keep = near & (scan.ray % every == 0)
    origins = np.zeros_like(scan.cloud.points) if scan.cloud.origins is None else scan.cloud.origins
    points, origins = _rounded(scan.cloud.points[keep]), _rounded(origins[keep])
    row, column = scan.profile[keep].copy(), scan.ray[keep] // every
    row -= row.min()
    shape = (int(row.max()) + 1, int(column.max()) + 1)
    x, z, y = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32), np.full(shape[0], np.nan)
    x[row, column], z[row, column] = (points - origins)[:, 0], (points - origins)[:, 2]
    y[row] = origins[:, 1]
    np.savez_compressed(
        path,
        points=points,
        origins=origins,
        T_scanner_port=scan.T_scanner_port.matrix,
        prior=scan.prior.T_ref_port.matrix,
        port=np.array(scan.port),
        profile_x_m=x,
        profile_z_m=z,
        profile_y_m=y,
    )
    return int(keep.sum())


def _rounded(points: Array) -> Array:
    rounded: Array = (np.round(points / _GRID_M) * _GRID_M).astype(np.float32)
    return rounded
