"""A port as the locator needs it: prepared once from a mesh, kept on disk by the content of the mesh."""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.flats import CELL_M as FLAT_CELL_M
from perception.flats import Flats, as_kept, build_flats, near_any
from perception.floating import FLOAT_M, Floating, find_floating
from perception.front_map import FrontMap, build_front_map
from perception.geometry import Array, Pose
from perception.mesh_io import checked_mesh
from perception.nearest import NearestField, build_nearest
from perception.ray_solid import RaySolid
from perception.relief import Templates, build_templates
from perception.rivals import differs_mirrored
from perception.surface import Surface, visible_surface

_log = logging.getLogger(__name__)

_VERSION = "21"
"""Part of the cache key: raise it when the preparation changes."""
SPACING_M = 0.0012
EDGE_SPACING_M = 0.0005
USUAL_ROLL_RAD = float(np.deg2rad(15.0))
_FACING = 0.9
FACING_M = 0.003
"""Millimetres of distance that a difference of one radian in facing direction counts as."""


@dataclass(frozen=True, slots=True)
class AcceptanceLimits:
    """What an estimate must reach to be accepted; the docking tolerance of the plug decides the last two."""

    max_rms_m: float = 0.0012
    max_translation_sigma_m: float = 0.0005
    max_rotation_sigma_rad: float = float(np.deg2rad(0.35))


@dataclass(frozen=True, eq=False)
class PortModel:
    """A port model. Port frame: origin on the rim plane, centre of the AC section; +z out of the vehicle, +y up."""

    name: str
    vertices: Array
    """(V, 3) metres, port frame."""
    faces: NDArray[np.int64]
    """(F, 3)."""
    surface: Surface
    """Samples of what can be seen from the front, fine enough to register against."""
    nearest: NearestField
    """Look-up of the nearest sample of ``surface``."""
    front: FrontMap
    """Heights seen from the front, for local evidence."""
    flats: Flats
    """Where the surfaces that face along the axis end."""
    templates: Templates
    """Signed volumes for the search, at the rolls of the usual prior."""
    checksum: str
    """Hash of the mesh; equal checksums mean equal models."""
    T_port_tcp: Pose = field(default_factory=Pose.identity)
    """Where the plug's tool centre is when mated."""
    limits: AcceptanceLimits = field(default_factory=AcceptanceLimits)
    loose_heights_m: tuple[float, ...] = ()
    """Heights over the rim plane of flats that lie elsewhere in another make's port: they neither decide its pose nor
    speak for or against it. ``flats``, ``front`` and ``templates`` are without them."""

    @staticmethod
    def from_mesh(
        name: str,
        vertices: Array,
        faces: NDArray[np.int64],
        *,
        T_port_tcp: Pose | None = None,
        limits: AcceptanceLimits | None = None,
        loose_heights_m: tuple[float, ...] = (),
        cache_dir: Path | None = None,
    ) -> PortModel:
        """Prepares a model from a triangle mesh, or takes the prepared one from the cache.

        :param vertices: (V, 3) metres, port frame.
        :param faces: (F, 3); degenerate ones are tolerated.
        :param loose_heights_m: flats, facing along the axis, whose height differs from make to make.
        :param cache_dir: where prepared models are kept; None for the user's cache directory.
        :raises MeshError: no usable face.
        :raises UnitError: a size that no port has.
        """
        vertices, faces = checked_mesh(name, np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64))
        checksum = _checksum(vertices, faces)
        marked = "".join(f"-{round(-1e6 * height)}" for height in loose_heights_m)
        path = (cache_dir or default_cache_dir()) / f"model-{_VERSION}-{checksum[:20]}{marked}.npz"
        prepared = _load(path)
        if prepared is None:
            dense = visible_surface(vertices, faces)
            surface = dense.thinned(SPACING_M, EDGE_SPACING_M)
            templates = build_templates(surface.only(_decides(surface, loose_heights_m)), USUAL_ROLL_RAD)
            flats = build_flats(vertices, faces)
            prepared = surface, build_nearest(surface), build_front_map(dense.points), flats, templates
            _save(path, *prepared)
        surface, nearest, front, flats, templates = prepared
        return PortModel(
            name,
            vertices,
            faces,
            surface,
            nearest,
            front.without(loose_heights_m),
            flats.without(loose_heights_m),
            templates,
            checksum,
            T_port_tcp or Pose.identity(),
            limits or AcceptanceLimits(),
            loose_heights_m,
        )

    def make_ready(self) -> None:
        """Makes now what is else made on first use, a second or two of it, so that the first scan waits no longer."""
        _ = self.decides, self.solid, self.tree, self.contacts, self.handed, self.lenient_flats

    @cached_property
    def decides(self) -> Array:
        """(M,) 1 for the samples that decide the pose, 0 for those on loose flats."""
        return _decides(self.surface, self.loose_heights_m).astype(np.float64)

    @cached_property
    def solid(self) -> RaySolid:
        """The mesh as rays meet it; loose flats tell nothing."""
        corners = self.vertices[self.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing = normals[:, 2] > _FACING * np.linalg.norm(normals, axis=1)
        loose = facing & near_any(corners[:, :, 2].mean(axis=1), self.loose_heights_m)
        return RaySolid(self.vertices, self.faces, ~loose)

    @cached_property
    def tree(self) -> cKDTree:
        """A kd-tree of the surface samples by place and facing direction (6-D, normals times ``FACING_M``)."""
        keys = np.hstack([self.surface.points, FACING_M * self.surface.normals])
        return cKDTree(keys, balanced_tree=False, compact_nodes=False)

    @cached_property
    def contacts(self) -> NDArray[np.int64]:
        """Numbers of the front map's features that are contacts: tips within the inlet that stand free."""
        number = self.floating.number
        return np.unique(number[(number > 0) & (number == self.front.feature) & self.front.inner])

    @cached_property
    def handed(self) -> bool:
        """Whether the port is not its own mirror image."""
        return differs_mirrored(self.front)

    @cached_property
    def floating(self) -> Floating:
        """The contacts, which sit where they were put and not where the drawing has them."""
        return find_floating(self.front)

    @cached_property
    def lenient_flats(self) -> Flats:
        """``flats`` for looking where edges are contradicted: a contact may be off its place without doing so."""
        x, y = (self.flats.low[k] + (np.arange(n) + 0.5) * FLAT_CELL_M for k, n in enumerate(self.flats.shape))
        at = np.column_stack([one.ravel() for one in np.meshgrid(x, y, indexing="ij")])
        return self.flats.lenient((self.floating.at(at) > 0).reshape(self.flats.shape), FLOAT_M)

    def templates_for(self, roll_rad: float) -> Templates:
        """The signed volumes for rolls up to ``roll_rad``; the prepared ones where they fit."""
        if abs(roll_rad - USUAL_ROLL_RAD) < 1e-6:
            return self.templates
        return build_templates(self.surface.only(self.decides > 0), roll_rad)

    @property
    def size(self) -> tuple[Array, Array]:
        """Lowest and highest corner (3,) of the visible surface."""
        return self.surface.points.min(axis=0), self.surface.points.max(axis=0)


def _decides(surface: Surface, loose_heights_m: Sequence[float]) -> NDArray[np.bool_]:
    facing = surface.normals[:, 2] > _FACING
    return ~(facing & near_any(surface.points[:, 2], loose_heights_m))


def default_cache_dir() -> Path:
    """``$XDG_CACHE_HOME/portdock/models`` or its usual default."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return Path(base) / "portdock" / "models"


def _checksum(vertices: Array, faces: NDArray[np.int64]) -> str:
    digest = hashlib.sha256(np.round(vertices * 1e7).astype("<i8").tobytes())
    digest.update(faces.astype("<i8").tobytes())
    return digest.hexdigest()


_Prepared = tuple[Surface, NearestField, FrontMap, Flats, Templates]


def _load(path: Path) -> _Prepared | None:
    try:
        with np.load(path, allow_pickle=False) as archive:
            columns = archive["surface"].astype(np.float64)
            surface = Surface(columns[:, :3], columns[:, 3:6], *columns[:, 6:].T)
            grid = archive["grid"]
            nearest = NearestField(grid[:3], archive["index"], float(grid[3]), len(surface))
            lowest, highest, distinct = archive["front"]
            maps = (lowest, highest, distinct, archive["feature"], archive["inner"])
            front = FrontMap(archive["front_low"], *maps)
            templates = Templates(archive["rolls"], archive["template_low"], archive["templates"])
            flats = Flats(archive["flats_low"], archive["flats_heights"], archive["flats"].astype(np.float32))
            return surface, nearest, front, flats, templates
    except FileNotFoundError:
        return None
    except Exception as error:  # a broken cache file must never stop a docking: prepare again
        _log.warning("the cached model %s is unusable and is prepared again: %s", path.name, error)
        return None


def _save(
    path: Path, surface: Surface, nearest: NearestField, front: FrontMap, flats: Flats, templates: Templates
) -> None:
    """Writes beside and renames, so that two processes at once do no harm. What cannot be written is not cached."""
    scalars = (surface.visibility, surface.edge_m, surface.area_m2, surface.level)
    columns = np.column_stack([surface.points, surface.normals, *scalars])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
            np.savez(
                file,
                surface=columns.astype(np.float32),
                grid=np.append(nearest.origin, nearest.cell_m),
                index=nearest.index,
                front_low=front.low,
                front=np.stack([front.lowest, front.highest, front.distinct]),
                feature=front.feature,
                inner=front.inner,
                flats_low=flats.low,
                flats_heights=flats.heights,
                flats=as_kept(flats.distance),
                rolls=templates.rolls,
                template_low=templates.low,
                templates=templates.volumes,
            )
        os.replace(file.name, path)
    except OSError as error:
        _log.info("prepared models are not cached: %s", error)
