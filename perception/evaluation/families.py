"""What a port's drawing and a built part of it look like, whichever code draws it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from perception.evaluation import other_family
from perception.evaluation.built import BuiltTolerance, built_variant, shrink_factor
from perception.geometry import Array
from perception.port_shape import PortShape
from perception.port_solid import Ints, PortMesh, build_mesh, build_parts

OTHERS: Mapping[str, PortShape] = MappingProxyType({other_family.NAME: other_family.SHAPE})
"""Ports that are bundled with no model and drawn by code of their own; a locator is given their mesh."""


def drawn_mesh(shape: PortShape) -> tuple[Array, Ints]:
    """The CAD: vertices (V, 3) in metres and faces (F, 3). Raises MeshError."""
    if shape == OTHERS.get(shape.name):
        mesh = other_family.drawing()
        return mesh.vertices, mesh.faces
    return build_mesh(shape)


def built_part(shape: PortShape, tolerance: BuiltTolerance, rng: np.random.Generator, *, contacts: bool) -> PortMesh:
    """One part as moulding and assembly leave it; without any contact if that is asked for. Raises MeshError."""
    if shape == OTHERS.get(shape.name):
        return other_family.built(tolerance, rng, contacts=contacts)
    variant = built_variant(shape, tolerance, rng)
    mesh = build_parts(variant if contacts else replace(variant, contacts=()))
    return replace(mesh, vertices=mesh.vertices * shrink_factor(tolerance, rng))
