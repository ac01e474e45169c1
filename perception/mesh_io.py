"""Mesh files of a port: .stl, .ply and .obj into vertices and triangles in metres. Degenerate triangles are dropped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from perception.errors import MeshError
from perception.geometry import Array
from perception.ply import parse_ply
from perception.units import MODEL_EXTENT_M, check_extent, scale_of

MESH_SUFFIXES = (".stl", ".ply", ".obj")


def read_mesh(path: Path | str, unit: str = "m") -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) in metres and triangles (F, 3) of a mesh file.

    :raises MeshError: missing, unreadable, without faces.
    :raises UnitError: a size that only a wrong unit explains.
    """
    path = Path(path)
    reader = {".stl": _parse_stl, ".ply": parse_ply, ".obj": _parse_obj}.get(path.suffix.lower())
    if reader is None:
        raise MeshError(f"{path.name}: mesh files of type {path.suffix or '(none)'} are not known")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MeshError(f"{path}: {error.strerror or error}") from error
    try:
        vertices, faces = reader(data)
    except (ValueError, KeyError, IndexError, OverflowError, MemoryError) as error:
        raise MeshError(f"{path.name} cannot be read: {error}") from error
    return checked_mesh(path.name, vertices * scale_of(unit), faces)


def checked_mesh(name: str, vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """The mesh without degenerate triangles. Raises MeshError when nothing is left, UnitError for its size."""
    if len(faces) == 0:
        raise MeshError(f"{name} has no faces", remedy="Give a surface mesh; a cloud of points is not a model.")
    if not np.isfinite(vertices).all():
        raise MeshError(f"{name} has vertices that are not finite")
    check_extent(vertices[np.unique(faces)], MODEL_EXTENT_M, f"the model {name}", "--model-unit")
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    solid = area > 1e-12
    if not solid.any():
        raise MeshError(f"{name} has only degenerate faces")
    return vertices, faces[solid]


def _parse_stl(data: bytes) -> tuple[Array, NDArray[np.int64]]:
    corners = _binary_stl(data)
    if corners is None:
        words = data.decode("ascii", "replace").split()
        at = np.flatnonzero(np.array(words) == "vertex")
        if not words or words[0].lower() != "solid":
            raise ValueError("not an STL file")
        corners = np.array([words[i + 1 : i + 4] for i in at], dtype=np.float64)
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3).astype(np.int64)


def _binary_stl(data: bytes) -> Array | None:
    if len(data) < 84:
        return None
    count = int(np.frombuffer(data, "<u4", 1, 80)[0])
    if len(data) < 84 + 50 * count or (data[:5].lower() == b"solid" and len(data) != 84 + 50 * count):
        return None
    dtype = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(data, dtype, count, 84)["corners"].astype(np.float64)


def _parse_obj(data: bytes) -> tuple[Array, NDArray[np.int64]]:
    vertices, faces = list[list[float]](), list[list[int]]()
    for line in data.decode("utf-8", "replace").splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(w) for w in words[1:4]])
        elif words[:1] == ["f"]:
            index = [int(w.split("/")[0]) for w in words[1:]]
            index = [i - 1 if i > 0 else len(vertices) + i for i in index]
            faces += [[index[0], index[k], index[k + 1]] for k in range(1, len(index) - 1)]
    if faces and (np.max(faces) >= len(vertices) or np.min(faces) < 0):
        raise ValueError("a face names a vertex that does not exist")
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3)
