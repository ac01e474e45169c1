"""The plug's frame at the flange from a plug that is in: docks at one port, each looked at from several sides.

Where the plug sits in the port is known from the port's description, where the port is from the scans. What the
hand-eye calibration has wrong shows as scans that disagree once they look from several sides; what all of them have
in common is in the covariance. How long the tool is, a plug that was pushed home does not tell: it tells how far arm,
mount and plug give. Along its own axis the tool keeps the length that it had.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.calibration.errors import CalibrationError
from perception.calibration.teaching import mean_pose
from perception.geometry import Array, Pose

MIN_LOOKS = 3
LEAST_SIDES_RAD = float(np.deg2rad(8.0))
"""Between two of a dock's lines of sight, at the least."""
MAX_SPREAD_M = 0.0006
MAX_SPREAD_RAD = float(np.deg2rad(0.3))
"""Of the tool's pose from look to look, and of the port's place from before a dock to after it."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One scan of the port."""

    T_base_flange: Pose
    """In the middle of the sweep."""
    T_base_port: Pose
    """As located."""


@dataclass(frozen=True, slots=True, eq=False)
class MatedDock:
    """One dock, and what was seen of the port before and after it."""

    T_base_flange_mated: Pose
    """While the charger said latched."""
    T_base_port_before: Pose
    """Where the mission located the port that it then docked at."""
    looks: tuple[Look, ...]
    """After the plug was out again."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What mating takes for granted."""

    T_port_tcp: Pose
    """The mated plug in the port, from the port's description."""
    T_flange_scanner: Pose
    scanner_covariance: Array
    """(6, 6) of the hand-eye calibration: metres in the flange frame, radians in the scanner frame."""
    T_flange_tcp: Pose
    """The tool as it was known until now: its length is kept."""
    length_sigma_m: float
    play_m: float
    """How far a mated plug can be off the port's axis, and ..."""
    play_rad: float
    """... how far tilted or turned."""


@dataclass(frozen=True, slots=True, eq=False)
class MatedTool:
    """A tool found by mating."""

    T_flange_tcp: Pose
    covariance: Array
    """(6, 6) metres in the flange frame, radians in the TCP's frame; the hand-eye calibration's part is in it."""
    own_covariance: Array
    """The same without the hand-eye calibration's part, which cancels where ports are looked at as here."""
    spread_m: float
    """Largest distance of a look's tool from the mean."""
    spread_rad: float
    deeper_m: float
    """How much further than described the plug went in."""


def tool_by_mating(docks: Sequence[MatedDock], known: Known) -> MatedTool:
    """``T_flange_tcp`` with which every dock ends where the port's description says.

    :raises CalibrationError: too few looks, looks from one side only, a port that moved, looks that disagree
    """
    for number, dock in enumerate(docks, 1):
        _refuse_poor(number, dock, known.T_flange_scanner)
    looks = [(dock, look) for dock in docks for look in dock.looks]
    if not looks:
        raise CalibrationError("no dock to find the tool from")
    tools = [_tool(dock, look.T_base_port, known) for dock, look in looks]
    mean = mean_pose(tools)
    off = np.stack([mean.change_to(tool) for tool in tools])
    spread_m, spread_rad = (float(np.linalg.norm(part, axis=1).max()) for part in (off[:, :3], off[:, 3:]))
    if spread_m > MAX_SPREAD_M or spread_rad > MAX_SPREAD_RAD:
        raise CalibrationError(
            f"looks disagree on the tool by {1e3 * spread_m:.2f} mm and {np.rad2deg(spread_rad):.2f} deg",
            remedy="Calibrate hand-eye first; check that vehicle, scanner and plug sit tight; then mate again.",
        )
    longer_m = float(mean.rotation[:, 2] @ (mean.translation - known.T_flange_tcp.translation))
    tool = mean.moved([0.0, 0.0, -longer_m])
    own = off.T @ off / (len(tools) - 1) / len(tools) + _play(known, tool)
    pull = np.mean([_pull(dock, look, known) for dock, look in looks], axis=0)
    own, shared = _with_length(own, tool, known), _without_length(pull @ known.scanner_covariance @ pull.T, tool)
    return MatedTool(tool, own + shared, own, spread_m, spread_rad, -longer_m)


def _refuse_poor(number: int, dock: MatedDock, T_flange_scanner: Pose) -> None:
    """Each dock on its own: enough looks, from several sides, of a port that stood still."""
    if len(dock.looks) < MIN_LOOKS:
        raise CalibrationError(f"{len(dock.looks)} looks after dock {number} are too few: at least {MIN_LOOKS}")
    sights = np.stack([look.T_base_flange.rotate(T_flange_scanner.rotation[:, 2]) for look in dock.looks])
    apart_rad = float(np.arccos(np.clip(sights @ sights.T, -1.0, 1.0)).max())
    if apart_rad < LEAST_SIDES_RAD:
        raise CalibrationError(
            f"all looks after dock {number} are parallel within {np.rad2deg(apart_rad):.0f} deg",
            remedy="Look from several sides (scan.viewpoints): only then an error of the hand-eye calibration shows.",
        )
    after = mean_pose([look.T_base_port for look in dock.looks])
    moved_m, turned_rad = dock.T_base_port_before.distance_to(after), dock.T_base_port_before.angle_to(after)
    if moved_m > MAX_SPREAD_M or turned_rad > MAX_SPREAD_RAD:
        raise CalibrationError(
            f"after dock {number} the port is seen {1e3 * moved_m:.2f} mm and {np.rad2deg(turned_rad):.2f} deg off"
            " where it was before",
            remedy="Hold the vehicle (brake, chocks) and mate again.",
        )


def _tool(dock: MatedDock, T_base_port: Pose, known: Known) -> Pose:
    return dock.T_base_flange_mated.inverse() @ T_base_port @ known.T_port_tcp


def _pull(dock: MatedDock, look: Look, known: Known) -> Array:
    """(6, 6) change of the tool with the hand-eye calibration's parameters, to first order."""
    T_scanner_tcp = (look.T_base_flange @ known.T_flange_scanner).inverse() @ look.T_base_port @ known.T_port_tcp
    between = dock.T_base_flange_mated.rotation.T @ look.T_base_flange.rotation
    pull = np.zeros((6, 6))
    pull[:3, :3] = between
    pull[:3, 3:] = -between @ known.T_flange_scanner.rotation @ _cross(T_scanner_tcp.translation)
    pull[3:, 3:] = T_scanner_tcp.rotation.T
    return pull


def _cross(v: Array) -> Array:
    """(3, 3) with which ``v x u`` is a product."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _play(known: Known, tool: Pose) -> Array:
    """(6, 6): anywhere within the play is equally likely, and every dock may rest on the same side."""
    across = tool.rotation[:, :2]
    play = np.zeros((6, 6))
    play[:3, :3] = known.play_m**2 / 3.0 * across @ across.T
    play[3:, 3:] = known.play_rad**2 / 3.0 * np.eye(3)
    return play


def _without_length(covariance: Array, tool: Pose) -> Array:
    """Along its own axis the tool was not estimated."""
    axis = tool.rotation[:, 2]
    keep = np.eye(6)
    keep[:3, :3] -= np.outer(axis, axis)
    return np.asarray(keep @ covariance @ keep.T)


def _with_length(covariance: Array, tool: Pose, known: Known) -> Array:
    axis = tool.rotation[:, 2]
    told = _without_length(covariance, tool)
    told[:3, :3] += known.length_sigma_m**2 * np.outer(axis, axis)
    return told
