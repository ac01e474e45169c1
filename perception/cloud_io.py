"""Scan files: .ply, .pcd, .xyz and .npz into a ``Cloud`` in metres. Points not finite are dropped and counted."""

from __future__ import annotations

import io
import logging
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from perception.errors import EmptyScanError, ScanFileError
from perception.geometry import Array
from perception.ply import parse_ply
from perception.scan import Cloud
from perception.units import SCAN_EXTENT_M, check_extent, scale_of

_log = logging.getLogger(__name__)

MIN_POINTS = 200
"""Fewer points than this cannot determine a pose together with its evidence."""


def read_cloud(path: Path | str, unit: str = "m") -> Cloud:
    """A scan file as a cloud in the scanner frame, metres.

    :param unit: length unit of the file: m, cm or mm.
    :raises ScanFileError: missing, unreadable, unknown or broken format.
    :raises EmptyScanError: fewer than ``MIN_POINTS`` finite points.
    :raises UnitError: a size that only a wrong unit explains.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise ScanFileError(f"{path.name}: scan files of type {path.suffix or '(none)'} are not known")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScanFileError(f"{path}: {error.strerror or error}") from error
    if not data:
        raise EmptyScanError(f"{path.name} is an empty file")
    try:
        points, origins = reader(data)
    except (ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile, OverflowError, MemoryError) as error:
        raise ScanFileError(f"{path.name} cannot be read: {error}") from error
    return _checked(path.name, points, origins, scale_of(unit))


def _checked(name: str, points: Array, origins: Array | None, scale: float) -> Cloud:
    finite = np.isfinite(points).all(axis=1)
    if origins is not None:
        finite &= np.isfinite(origins).all(axis=1)
    dropped = len(points) - int(finite.sum())
    if dropped:
        _log.warning("%s: %d of %d points are not finite and were dropped", name, dropped, len(points))
    points = points[finite] * scale
    origins = None if origins is None else origins[finite] * scale
    if len(points) < MIN_POINTS:
        lost = f" ({dropped} not finite)" if dropped else ""
        raise EmptyScanError(f"{name} holds {len(points)} usable points{lost}; at least {MIN_POINTS} are needed")
    check_extent(points, SCAN_EXTENT_M, f"the scan {name}", "--scan-unit")
    return Cloud(points, "scanner", origins)


def _read_ply(data: bytes) -> tuple[Array, Array | None]:
    return parse_ply(data)[0], None


def _read_xyz(data: bytes) -> tuple[Array, Array | None]:
    text = data.decode("utf-8", "strict").replace(",", " ").replace(";", " ")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # an empty file is told as too few points, by the caller
        table = np.loadtxt(io.StringIO(text), comments=("#", "//"), ndmin=2)
    if table.size and table.shape[1] < 3:
        raise ValueError("each line needs x y z")
    return table[:, :3].astype(np.float64) if table.size else np.empty((0, 3)), None


def _read_npz(data: bytes) -> tuple[Array, Array | None]:
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        points = np.asarray(archive["points"], dtype=np.float64)
        origins = np.asarray(archive["origins"], dtype=np.float64) if "origins" in archive else None
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"the array 'points' has shape {points.shape}, not (N, 3)")
    if origins is not None and origins.shape != points.shape:
        raise ValueError("the arrays 'points' and 'origins' differ in shape")
    return points, origins


def _read_pcd(data: bytes) -> tuple[Array, Array | None]:
    header, body = _pcd_header(data)
    fields, sizes, kinds = header["FIELDS"], [int(s) for s in header["SIZE"]], header["TYPE"]
    counts = [int(c) for c in header.get("COUNT", ["1"] * len(fields))]
    n = int(header["POINTS"][0])
    dtype = np.dtype(
        [(f"{f}{k}", f"<{t.lower()}{s}", c) for k, (f, s, t, c) in enumerate(zip(fields, sizes, kinds, counts))]  # noqa: B905
    )
    column = [f"{axis}{fields.index(axis)}" for axis in "xyz"]
    match header["DATA"][0]:
        case "ascii":
            starts = np.concatenate([[0], np.cumsum(counts)])
            table = np.loadtxt(io.BytesIO(body), ndmin=2)
            return table[:n, [int(starts[fields.index(axis)]) for axis in "xyz"]].astype(np.float64), None
        case "binary":
            rows = np.frombuffer(body, dtype, n)
            return np.column_stack([rows[c].reshape(n) for c in column]).astype(np.float64), None
        case other:
            raise ValueError(f"PCD data of kind {other} are not supported: save as binary or ascii")


def _pcd_header(data: bytes) -> tuple[dict[str, list[str]], bytes]:
    header, at = dict[str, list[str]](), 0
    while "DATA" not in header:
        end = data.find(b"\n", at)
        if end < 0:
            raise ValueError("a PCD file without a DATA line")
        words = data[at:end].decode("ascii", "replace").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
    return header, data[at:]


_READERS: dict[str, Callable[[bytes], tuple[Array, Array | None]]] = {
    ".ply": _read_ply,
    ".pcd": _read_pcd,
    ".xyz": _read_xyz,
    ".txt": _read_xyz,
    ".npz": _read_npz,
}
