"""What must survive the process: the axis and depth on which a plug was, or may have been, inserted."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

from controller.planning import DockPlan
from perception.geometry import Pose

INSERTION_NAME = "insertion.json"


@dataclass(frozen=True, slots=True, eq=False)
class StoredInsertion:
    """The insertion that was under way when the file was written."""

    T_base_port: Pose
    T_port_tcp_mated: Pose


def remember_insertion(folder: Path, plan: DockPlan) -> None:
    """Write axis and depth durably, before anything touches."""
    values = {
        "T_base_port": plan.T_base_port.matrix.tolist(),
        "T_port_tcp_mated": plan.T_port_tcp_mated.matrix.tolist(),
    }
    write_durably(folder / INSERTION_NAME, json.dumps(values))


def write_durably(path: Path, text: str) -> None:
    """All of it or nothing, also when the power fails: write beside it, fsync, rename, fsync the folder."""
    temporary = path.with_name(path.name + ".tmp")
    with temporary.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
    _sync(path.parent)


def forget_insertion(folder: Path) -> None:
    """The plug is out and clear."""
    (folder / INSERTION_NAME).unlink(missing_ok=True)
    _sync(folder)


def recall_insertion(folder: Path) -> StoredInsertion | None:
    """The stored insertion, or None. A damaged file counts as none: the caller then asks for a person."""
    try:
        values = json.loads((folder / INSERTION_NAME).read_text(encoding="utf-8"))
        return StoredInsertion(Pose.from_matrix(values["T_base_port"]), Pose.from_matrix(values["T_port_tcp_mated"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
