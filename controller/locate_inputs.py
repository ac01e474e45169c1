"""What ``portdock locate`` is given beside scans: the expected pose and the models, checked."""

from __future__ import annotations

import json
from pathlib import Path

from controller.port_files import bundled_ports
from controller.port_models import port_model
from perception.errors import InputError
from perception.estimate import Prior
from perception.geometry import Pose
from perception.port_model import PortModel


def read_prior(path: Path) -> Prior:
    """The expected pose from a JSON file with the key ``prior``. Raises InputError."""
    return Prior(read_pose(path, "prior"))


def read_pose(path: Path, key: str) -> Pose:
    """The pose that a JSON file holds under a key: 4x4, metres. Raises InputError."""
    remedy = f"Give a JSON file whose key {key!r} is a 4x4 pose of the port (T_scanner_port), in metres."
    content = read_json(path, remedy)
    if not isinstance(content, dict) or key not in content:
        raise InputError(f"{path.name} has no key {key!r}", remedy=remedy)
    return as_pose(content[key], f"{path.name}: {key}", remedy)


def read_poses(path: Path, count: int) -> list[Pose]:
    """The poses that a JSON file holds under ``poses``, one for each scan: 4x4, metres. Raises InputError."""
    remedy = "Give a JSON file whose key 'poses' lists a 4x4 T_base_scanner in metres for each scan, in their order."
    content = read_json(path, remedy)
    listed = content.get("poses") if isinstance(content, dict) else None
    if not isinstance(listed, list) or len(listed) != count:
        raise InputError(f"{path.name} does not list {count} poses", remedy=remedy)
    return [as_pose(value, f"{path.name}: pose {k + 1}", remedy) for k, value in enumerate(listed)]


def read_json(path: Path, remedy: str) -> object:
    """What a JSON file holds. Raises InputError."""
    try:
        return json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}", remedy=remedy) from error
    except ValueError as error:
        raise InputError(f"{path.name} is not JSON: {error}".replace("\n", " "), remedy=remedy) from error


def as_pose(value: object, where: str, remedy: str) -> Pose:
    """A 4x4 list as a pose. Raises InputError."""
    try:
        return Pose.from_matrix(value)  # type: ignore[arg-type]
    except (ValueError, TypeError) as error:
        raise InputError(f"{where} is not a pose: {error}", remedy=remedy) from error


def requested_models(request: str, unit: str) -> list[PortModel]:
    """The models that ``--model`` names: one, several with commas between, or ``auto`` for all bundled ones.

    Raises UnknownPortError, MeshError, UnitError.
    """
    names = bundled_ports() if request == "auto" else tuple(part.strip() for part in request.split(",") if part.strip())
    if not names:
        raise InputError("--model names no model", remedy=f"Use one of {', '.join(bundled_ports())}, or a mesh file.")
    return [port_model(name, unit) for name in names]
