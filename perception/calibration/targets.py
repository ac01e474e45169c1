"""What is swept to calibrate: a sphere, three planes, a port. Each tells how far points are from its surface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.geometry import Array, Pose, exp
from perception.surface import Surface

LEAST_ON_FLAT = 200
"""Points that it takes to estimate how deep a flat lies."""


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Signed distances of N points to a target that has K parameters of its own."""

    residual: Array
    """(N,) metres."""
    gradient: Array
    """(N, 3) change with the point."""
    own: Array
    """(N, K) change with the target's parameters."""


class Target(Protocol):
    """Something that stands still in the base frame; where exactly is estimated along with the mounting."""

    @property
    def parameters(self) -> int:
        """K."""

    def distances(self, points: Array) -> Distances:
        """For points (N, 3) in the base frame, the same N as those that the target was found in."""

    def moved(self, step: Array) -> Self:
        """With its parameters changed by ``step`` (K,)."""

    def of(self, points: NDArray[np.bool_]) -> Self:
        """For a selection of the points."""


@dataclass(frozen=True, slots=True, eq=False)
class SphereTarget:
    """A sphere of known radius; with ``radius_free`` its radius is estimated too, to check that it is the right one."""

    centre: Array
    radius_m: float
    radius_free: bool = False

    @property
    def parameters(self) -> int:
        """Centre, and radius if free."""
        return 4 if self.radius_free else 3

    def distances(self, points: Array) -> Distances:
        """Distance from the surface, positive outside."""
        spokes = points - self.centre
        lengths = np.linalg.norm(spokes, axis=1)
        outward = spokes / lengths[:, None]
        own = -outward if not self.radius_free else np.column_stack([-outward, -np.ones(len(points))])
        return Distances(lengths - self.radius_m, outward, own)

    def moved(self, step: Array) -> SphereTarget:
        """Centre, then radius."""
        radius_m = self.radius_m + (float(step[3]) if self.radius_free else 0.0)
        return replace(self, centre=self.centre + step[:3], radius_m=radius_m)

    def of(self, points: NDArray[np.bool_]) -> SphereTarget:
        """Points do not matter to it."""
        return self


@dataclass(frozen=True, slots=True, eq=False)
class PlanesTarget:
    """M planes ``normal . p = offset``, with the plane that each point lies on."""

    normals: Array
    """(M, 3) unit."""
    offsets: Array
    """(M,)."""
    plane: NDArray[np.int64]
    """(N,)."""

    @property
    def parameters(self) -> int:
        """Two of direction and the offset, plane by plane."""
        return 3 * len(self.normals)

    def distances(self, points: Array) -> Distances:
        """Distance from each point's own plane."""
        normals = self.normals[self.plane]
        own = np.zeros((len(points), len(self.normals), 3))
        first, second = self._tangents()
        rows = np.arange(len(points))
        own[rows, self.plane, 0] = np.einsum("ni,ni->n", points, first[self.plane])
        own[rows, self.plane, 1] = np.einsum("ni,ni->n", points, second[self.plane])
        own[rows, self.plane, 2] = -1.0
        residual = np.einsum("ni,ni->n", points, normals) - self.offsets[self.plane]
        return Distances(residual, normals, own.reshape(len(points), -1))

    def moved(self, step: Array) -> PlanesTarget:
        """Normals stay unit."""
        s = step.reshape(-1, 3)
        first, second = self._tangents()
        normals = self.normals + s[:, :1] * first + s[:, 1:2] * second
        lengths = np.linalg.norm(normals, axis=1)
        return replace(self, normals=normals / lengths[:, None], offsets=(self.offsets + s[:, 2]) / lengths)

    def of(self, points: NDArray[np.bool_]) -> PlanesTarget:
        """Keeps the chosen points' planes."""
        return replace(self, plane=self.plane[points])

    def _tangents(self) -> tuple[Array, Array]:
        """Two unit vectors (M, 3) each in every plane."""
        least = np.eye(3)[np.abs(self.normals).argmin(axis=1)]
        first = np.cross(self.normals, least)
        first /= np.linalg.norm(first, axis=1)[:, None]
        return first, np.cross(self.normals, first)


@dataclass(frozen=True, slots=True, eq=False)
class PortTarget:
    """A port whose model is known: distance along the normal of the nearest surface sample.

    A built port differs from its drawing most in how deep its flats lie: these depths are estimated with its pose.
    """

    T_base_port: Pose
    surface: Surface
    tree: cKDTree
    levels: Array
    """(L,) numbers of the flats (``Surface.level``) whose depth is free; the rim plane's is not."""
    depths_m: Array
    """(L,) by how much they stand out of where the drawing has them."""

    @staticmethod
    def at(T_base_port: Pose, surface: Surface) -> PortTarget:
        """The port as drawn, at a pose in the base frame."""
        return PortTarget(T_base_port, surface, cKDTree(surface.points), np.zeros(0), np.zeros(0))

    def with_free_depths(self, points: Array) -> PortTarget:
        """The depths of those flats free that enough of the points (N, 3; base frame) lie on."""
        nearest = self.tree.query(self.T_base_port.inverse().apply(points), workers=2)[1]
        numbers, counts = np.unique(self.surface.level[nearest], return_counts=True)
        levels = numbers[(numbers > 0) & (counts > LEAST_ON_FLAT)]
        return replace(self, levels=levels, depths_m=np.zeros(len(levels)))

    @property
    def parameters(self) -> int:
        """A twist in the port frame, and the free depths."""
        return 6 + len(self.levels)

    def distances(self, points: Array) -> Distances:
        """Point to plane."""
        local = self.T_base_port.inverse().apply(points)
        nearest = self.tree.query(local, workers=2)[1]
        normals = self.surface.normals[nearest]
        on_level = self.surface.level[nearest][:, None] == self.levels
        residual = np.einsum("ni,ni->n", local - self.surface.points[nearest], normals) - on_level @ self.depths_m
        own = -np.column_stack([normals, np.cross(local, normals), on_level])
        return Distances(residual, self.T_base_port.rotate(normals), own)

    def moved(self, step: Array) -> PortTarget:
        """Translation, then rotation vector, along and about the port's axes; then the depths."""
        return replace(self, T_base_port=self.T_base_port @ exp(step[:6]), depths_m=self.depths_m + step[6:])

    def of(self, points: NDArray[np.bool_]) -> PortTarget:
        """Points do not matter to it."""
        return self
