"""A folder of scans with their truth: ``NAME.ply`` beside ``NAME.json``, meshes in ``ports/``; poses in metres.

The JSON holds ``T`` and ``prior`` (4x4 T_scanner_port), ``port``, and where they are known ``tier``, ``integrity`` and
``crlb`` (``trans_mm``, ``rot_deg``).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from perception.cloud_io import read_cloud
from perception.errors import InputError
from perception.estimate import Prior
from perception.evaluation.locate_cases import Case, CaseScan, each_tier
from perception.geometry import Pose
from perception.mesh_io import MESH_SUFFIXES

_REMEDY = "Give a folder of NAME.ply with NAME.json: T, prior (4x4 T_scanner_port in metres) and port."


@dataclass(frozen=True, slots=True)
class FolderCase:
    """A scan file and what is asked of it."""

    case: Case
    scan: Path
    mesh: Path | None
    """The port's CAD, if the folder brings it."""


def folder_cases(folder: Path) -> list[FolderCase]:
    """All scans of a folder, sorted by name. Raises InputError where there is none or a truth is unusable."""
    truths = sorted(folder.glob("*.json")) if folder.is_dir() else []
    found = [_folder_case(folder, k, path) for k, path in enumerate(truths) if path.with_suffix(".ply").exists()]
    if not found:
        raise InputError(f"{folder} holds no scan with its truth", remedy=_REMEDY)
    return found


def _folder_case(folder: Path, number: int, path: Path) -> FolderCase:
    truth = _truth(path)
    port = str(truth.get("port", ""))
    try:
        (tier,) = each_tier([str(truth.get("tier", "nominal"))])
    except ValueError as error:
        raise InputError(f"{path.name}: {error}", remedy=_REMEDY) from error
    meshes = [folder / "ports" / f"{port}{suffix}" for suffix in MESH_SUFFIXES]
    mesh = next((one for one in meshes if one.exists()), None)
    return FolderCase(Case("port", number, tier, port, port), path.with_suffix(".ply"), mesh)


def read_scan(entry: FolderCase) -> CaseScan:
    """The scan and its truth. Raises InputError."""
    truth = _truth(entry.scan.with_suffix(".json"))
    try:
        pose, prior = Pose.from_matrix(truth["T"]), Pose.from_matrix(truth["prior"])
        bound = truth.get("crlb") or {}
        bound_m = float(bound.get("trans_mm", np.nan)) / 1e3
        bound_rad = float(np.deg2rad(float(bound.get("rot_deg", np.nan))))
        integrity = float(truth.get("integrity", np.nan))
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{entry.scan.stem}.json is no truth of a scan: {error}", remedy=_REMEDY) from error
    return CaseScan(read_cloud(entry.scan), Prior(prior), pose, bound_m, bound_rad, integrity)


def _truth(path: Path) -> dict[str, Any]:
    try:
        truth = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path.name} cannot be read: {error}".replace("\n", " "), remedy=_REMEDY) from error
    if not isinstance(truth, dict) or not {"T", "prior", "port"} <= set(truth):
        raise InputError(f"{path.name} lacks T, prior or port", remedy=_REMEDY)
    return truth
