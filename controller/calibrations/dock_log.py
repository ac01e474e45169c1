"""Every successful dock as one line of a file: where the plug came to rest against where the estimate said.

A line is appended and synced at once. Docks that were made with other calibrations are kept, but not judged together
with those since: a new calibration moves what is expected.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from perception.calibration.drift import Dock, Drift, warnings
from perception.geometry import Array, Pose

log = logging.getLogger(__name__)

NAME = "docks.jsonl"


@dataclass(frozen=True, slots=True, eq=False)
class LoggedDock:
    """One line."""

    time: datetime
    basis: str
    """Names the cell and its calibrations."""
    dock: Dock


def rest_offset(T_base_port: Pose, T_port_tcp_expected: Pose, T_base_tcp: Pose) -> Array:
    """(6,) plug at rest minus expected, in the port frame: metres, then rotation vector in radians."""
    actual = T_base_port.inverse() @ T_base_tcp
    turn = Rotation.from_matrix(actual.rotation @ T_port_tcp_expected.rotation.T).as_rotvec()
    return np.concatenate([actual.translation - T_port_tcp_expected.translation, turn])


def append_dock(folder: Path, basis: str, dock: Dock) -> None:
    """One more line, on disk when this returns. A full disk costs the line, never the mission."""
    values = {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "basis": basis,
        "port": dock.port,
        "offset_mm_deg": [*(1e3 * dock.offset[:3]).round(5).tolist(), *np.rad2deg(dock.offset[3:]).round(5).tolist()],
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / NAME).open("a", encoding="utf-8") as file:
            file.write(json.dumps(values) + "\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        log.error("this dock is not in the drift log: %s", error)


def read_docks(folder: Path) -> list[LoggedDock]:
    """Oldest first. A line that was cut short is left out."""
    try:
        lines = (folder / NAME).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    found = []
    for number, line in enumerate(lines, 1):
        try:
            found.append(_parsed(line))
        except (ValueError, KeyError, TypeError) as error:
            log.warning("%s, line %d is left out: %s", NAME, number, error)
    return found


def _parsed(line: str) -> LoggedDock:
    values = json.loads(line)
    offset = np.asarray(values["offset_mm_deg"], dtype=np.float64)
    if offset.shape != (6,) or not np.isfinite(offset).all():
        raise ValueError("six numbers are wanted")
    offset = np.concatenate([offset[:3] / 1e3, np.deg2rad(offset[3:])])
    return LoggedDock(datetime.fromisoformat(values["time"]), str(values["basis"]), Dock(str(values["port"]), offset))


def judged(logged: Sequence[LoggedDock], basis: str) -> list[LoggedDock]:
    """Those that may be judged together with docks of this basis: of the same cell, and of each port those since it
    was last taught."""
    cell = [one for one in logged if cell_mark(one.basis) == cell_mark(basis)]
    newest = {one.dock.port: one.basis for one in cell}
    return [one for one in cell if one.basis == newest[one.dock.port]]


def cell_mark(basis: str) -> str:
    """The part of a basis that all ports of a cell share."""
    return basis.rpartition(" ")[0] or basis


def in_words(drift: Drift) -> str:
    """A warning on one line, with what would be done about it."""
    shift_mm, turn_deg = 1e3 * drift.shift[:3], np.rad2deg(drift.shift[3:])
    place = ", ".join(f"{value:+.2f}" for value in shift_mm)
    turn = ", ".join(f"{value:+.2f}" for value in turn_deg)
    command = "portdock calibrate hand-eye" if drift.cause == "hand-eye or tool" else f"portdock teach {drift.port}"
    return (
        f"docking at {drift.port} has shifted ({', '.join(drift.axes)}) for {drift.docks_ago + 1} docks:"
        f" {place} mm, {turn} deg; likely {drift.cause}. Check that nothing is loose, then `{command}`."
    )


def drift_warnings(folder: Path, basis: str) -> tuple[str, ...]:
    """What the chart says after the newest dock."""
    return tuple(in_words(drift) for drift in warnings([one.dock for one in judged(read_docks(folder), basis)]))
