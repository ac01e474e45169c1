"""PLY files: the vertices of a cloud, the vertices and triangles of a mesh; ascii and both binary byte orders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Array

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    count_kind: str | None = None
    """numpy type of a list's length; None for a scalar."""


@dataclass(slots=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def parse_ply(data: bytes) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (N, 3) and triangles (M, 3), M = 0 for a cloud. Raises ValueError for anything else."""
    order, elements, body = _header(data)
    vertices = np.empty((0, 3))
    faces = np.empty((0, 3), dtype=np.int64)
    reader = _ascii_element if order == "ascii" else _binary_element
    for element in elements:
        table, lists, body = reader(body, element, order)
        if element.name == "vertex":
            vertices = np.column_stack([np.asarray(table[axis], dtype=np.float64) for axis in "xyz"])
        elif element.name == "face" and lists:
            faces = _triangulate(lists)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise ValueError("a face names a vertex that does not exist")
    return vertices, faces


def _header(data: bytes) -> tuple[str, list[_Element], bytes]:
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("not a PLY file")
    body = data[data.index(b"\n", end) + 1 :] if b"\n" in data[end:] else b""
    order, elements = "", list[_Element]()
    for line in data[:end].decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:1] == ["format"]:
            order = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}[words[1]]
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[:1] == ["property"] and words[1] == "list":
            elements[-1].properties.append(_Property(words[4], _TYPES[words[3]], _TYPES[words[2]]))
        elif words[:1] == ["property"]:
            elements[-1].properties.append(_Property(words[2], _TYPES[words[1]]))
    if not order:
        raise ValueError("a PLY file without a format line")
    return order, elements, body


_Parsed = tuple[dict[str, NDArray[np.float64]], list[NDArray[np.int64]], bytes]


def _binary_element(body: bytes, element: _Element, order: str) -> _Parsed:
    scalar = all(p.count_kind is None for p in element.properties)
    if scalar:
        dtype = np.dtype([(p.name, order + p.kind) for p in element.properties])
        if len(body) < dtype.itemsize * element.count:
            raise ValueError("the PLY file ends early")
        rows = np.frombuffer(body, dtype, element.count)
        return {name: rows[name] for name in dtype.names or ()}, [], body[dtype.itemsize * element.count :]
    uniform = _uniform_triangles(body, element, order)
    if uniform is not None:
        return {}, [uniform[0]], uniform[1]
    return _mixed_lists(body, element, order)


def _uniform_triangles(body: bytes, element: _Element, order: str) -> tuple[NDArray[np.int64], bytes] | None:
    """The usual case, all faces triangles, without a loop; None when it is another case."""
    fields: list[tuple[str, str] | tuple[str, str, int]] = []
    listed = ""
    for p in element.properties:
        if p.count_kind is None:
            fields.append((p.name, order + p.kind))
        elif listed:
            return None
        else:
            listed = p.name
            fields += [("count", order + p.count_kind), (p.name, order + p.kind, 3)]
    dtype = np.dtype(fields)
    if len(body) < dtype.itemsize * element.count:
        return None
    rows = np.frombuffer(body, dtype, element.count)
    if not bool((rows["count"] == 3).all()):
        return None
    return rows[listed].astype(np.int64), body[dtype.itemsize * element.count :]


def _mixed_lists(body: bytes, element: _Element, order: str) -> _Parsed:
    polygons, at = list[NDArray[np.int64]](), 0
    for _ in range(element.count):
        first: NDArray[np.int64] | None = None
        for p in element.properties:
            length = 1
            if p.count_kind is not None:
                length = int(np.frombuffer(body, order + p.count_kind, 1, at)[0])
                at += np.dtype(p.count_kind).itemsize
            values = np.frombuffer(body, order + p.kind, length, at)
            at += values.nbytes
            if p.count_kind is not None and first is None:
                first = values.astype(np.int64)
        if first is not None:
            polygons.append(first)
    return {}, polygons, body[at:]


def _ascii_element(body: bytes, element: _Element, order: str) -> _Parsed:
    lines = body.split(b"\n", element.count)
    rest = lines[element.count] if len(lines) > element.count else b""
    rows = [line.split() for line in lines[: element.count]]
    if len(rows) < element.count:
        raise ValueError("the PLY file ends early")
    if all(p.count_kind is None for p in element.properties):
        values = np.array(rows, dtype=np.float64).reshape(element.count, -1)
        return {p.name: values[:, k] for k, p in enumerate(element.properties)}, [], rest
    if element.properties[0].count_kind is None:
        raise ValueError("a PLY face that does not start with its list of vertices")
    return {}, [np.array(row[1 : 1 + int(row[0])], dtype=np.int64) for row in rows], rest


def _triangulate(polygons: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Polygons as fans of triangles; an (M, 3) array passes unchanged."""
    if len(polygons) == 1 and polygons[0].ndim == 2:
        return polygons[0]
    fans = [np.column_stack([np.full(len(p) - 2, p[0]), p[1:-1], p[2:]]) for p in polygons if len(p) >= 3]
    return np.concatenate(fans) if fans else np.empty((0, 3), dtype=np.int64)
