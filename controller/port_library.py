"""The user's own port models: meshes with what is known of them, in a folder, found by name like the bundled ones.

The folder is ``$PORTDOCK_MODELS``, or else ``$XDG_DATA_HOME/portdock/models`` (``~/.local/share``). Each model is a
mesh ``NAME.stl`` in metres and the port frame, beside ``NAME.json``.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, ClassVar

import numpy as np
from numpy.typing import NDArray

from perception.errors import InputError
from perception.geometry import Array, Pose
from perception.mesh_io import read_mesh
from perception.port_model import PortModel

_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


class ModelLibraryError(InputError):
    """A user's model cannot be stored or read."""

    code: ClassVar[str] = "model-library"
    default_remedy: ClassVar[str] = (
        "Name a writable folder with PORTDOCK_MODELS; portdock model list shows what is there."
    )


@dataclass(frozen=True, slots=True)
class UserModel:
    """What is known of a user's model beside its mesh."""

    name: str
    title: str
    source: str
    """File that it was made from."""
    mated_depth_mm: float | None = None
    """How far the mated plug's foremost face lies below the rim plane; None: not known, teach it."""

    @property
    def T_port_tcp(self) -> Pose:
        """Pose of the mated plug, as ``PortDescription.T_port_tcp``."""
        return Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -(self.mated_depth_mm or 0.0) / 1e3]))


def library_folder() -> Path:
    """Where the user's models are."""
    if chosen := os.environ.get("PORTDOCK_MODELS"):
        return Path(chosen).expanduser()
    return Path(os.environ.get("XDG_DATA_HOME") or "~/.local/share").expanduser() / "portdock" / "models"


def user_models() -> tuple[UserModel, ...]:
    """All of them, sorted by name; an unreadable description is left out."""
    found = []
    for path in sorted(library_folder().glob("*.json")):
        with contextlib.suppress(ModelLibraryError):
            found.append(_described(path))
    return tuple(found)


def has_model(name: str) -> bool:
    """Whether the user has a model of this name."""
    return bool(_NAME.fullmatch(name)) and (library_folder() / f"{name}.json").exists()


def load_model(name: str) -> PortModel:
    """The prepared model. Raises ModelLibraryError, MeshError or UnitError."""
    known = _described(library_folder() / f"{name}.json")
    vertices, faces = read_mesh(library_folder() / f"{name}.stl")
    return PortModel.from_mesh(name, vertices, faces, T_port_tcp=known.T_port_tcp)


def check_name(name: str) -> None:
    """Raises ModelLibraryError for a name that no file could safely have."""
    if not _NAME.fullmatch(name):
        raise ModelLibraryError(
            f"{name!r} is no name for a model", remedy="Use small letters, digits, - and _, at most 64 of them."
        )


def store_model(known: UserModel, vertices: Array, faces: NDArray[np.int64]) -> Path:
    """Store a model, replacing one of the same name; returns the mesh's path. Raises ModelLibraryError."""
    check_name(known.name)
    folder = library_folder()
    mesh = folder / f"{known.name}.stl"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write_whole(mesh, lambda file: file.write(as_stl(vertices, faces)))
        text = json.dumps(asdict(known), indent=1) + "\n"
        _write_whole(mesh.with_suffix(".json"), lambda file: file.write(text.encode()))
    except OSError as error:
        raise ModelLibraryError(f"cannot write to {folder}: {error.strerror or error}") from error
    return mesh


def _described(path: Path) -> UserModel:
    try:
        values = json.loads(path.read_text("utf-8"))
        return UserModel(**{**values, "name": path.stem})
    except (OSError, ValueError, TypeError) as error:
        raise ModelLibraryError(f"{path} describes no model: {error}".replace("\n", " ")) from error


def _write_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Writes beside and renames: an interruption leaves no half a file."""
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
        write(file)
    os.replace(file.name, path)


def as_stl(vertices: Array, faces: NDArray[np.int64]) -> bytes:
    """A binary STL of vertices (V, 3) and faces (F, 3), in the vertices' own unit."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    rows = np.zeros(len(faces), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]))
    rows["normal"], rows["corners"] = normal / np.maximum(length, 1e-30), corners
    return b"portdock port model, metres".ljust(80) + np.uint32(len(faces)).tobytes() + rows.tobytes()
