"""The coarse stage with a port whose model is known: where it is in each sweep, and the mounting that this gives.

With a mounting guess that is some degrees off a sweep's cloud is sheared, because the scanner does not move the way it
is taken to; the locator bears that, as it looks for the port's shape with some tolerance. Where it sees the port before
the scanner in each sweep, the mounting follows as hand-eye calibration has it; what the shear has spoilt of these
poses, the profiles' own points mend.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from perception.calibration.errors import CalibrationError
from perception.calibration.hand_eye import Asked, fitted
from perception.calibration.sightings import Mounting, Sightings
from perception.calibration.targets import PortTarget
from perception.errors import PortdockError
from perception.estimate import Prior
from perception.geometry import Array, Pose, exp
from perception.locate import locate
from perception.port_model import PortModel
from perception.scan import Cloud

GUESS_M, GUESS_RAD = 0.02, float(np.deg2rad(10.0))
"""How good the guess is."""
LATERAL_M, ALONG_M = 0.09, 0.07
"""Where the port may be seen in a sweep: the guess is off, and its rotation has a lever of the stand-off's length."""
TILT_RAD, ROLL_RAD = float(np.deg2rad(20.0)), float(np.deg2rad(15.0))
LEAST_INLIERS = 0.15
"""Of the port's outline. The locator accepts no sheared port, but says how much of it fits."""
NEAR_M = 0.004
"""Points further than this from the model are not the port's."""
FAR_M = 0.008
"""The same while the cloud is still sheared."""
EDGE_M = 0.0008
"""Points whose nearest place is nearer to an edge may belong to either side of it."""
SHEAR_SCALE_M = 0.003
MOST_FITTED = 10_000
"""Points that settle it, of all sweeps."""
PLACE_M, TURN_RAD = 0.003, float(np.deg2rad(3.0))
"""1 sigma of the port's pose as one sheared sweep shows it."""
GOOD_M = 0.0005
GOOD_SHARE = 0.7
"""So many of the points near the port are to be within ``GOOD_M`` of its surface: built ports differ from drawings."""
_REMEDY = "Check port.model and port.T_base_port; the port must be open, and every sweep must cross the whole of it."


@dataclass(frozen=True, slots=True, eq=False)
class FoundPort:
    """The port in all sweeps."""

    on_port: NDArray[np.bool_]
    """(N,) which sightings lie on it."""
    target: PortTarget
    mounting: Mounting
    """The guess, improved so far that all sweeps show the port at one place."""


def find_port(seen: Sightings, model: PortModel, T_base_port: Pose, guess: Mounting) -> FoundPort:
    """The port in every sweep.

    :param T_base_port: where the port is expected, within some centimetres
    :raises CalibrationError: a sweep in which the port is not found, or sweeps that do not show one and the same port
    """
    known = _settled(seen, on_port(seen, PortTarget.at(T_base_port, model.surface), guess, NEAR_M))
    if known is not None:
        return known  # the mounting was good already
    sweeps, T_scanner_port = np.unique(seen.sweep_of_point), []
    for number in sweeps:
        T_base_port = port_in_sweep(seen.of(seen.sweep_of_point == number), model, T_base_port, guess, int(number))
        T_scanner_port.append((_middle(seen, number) @ guess.T_flange_scanner).inverse() @ T_base_port)
    middles = [_middle(seen, number) for number in sweeps]
    mounting, place = _brought_together(middles, T_scanner_port, guess, T_base_port)
    found = _settled(seen, on_port(seen, PortTarget.at(place, model.surface), mounting, FAR_M))
    if found is None:
        raise CalibrationError("the sweeps do not show one and the same port", remedy=_REMEDY)
    return found


def port_in_sweep(seen: Sightings, model: PortModel, T_base_port: Pose, mounting: Mounting, number: int) -> Pose:
    """T_base_port as one sweep shows it with this mounting. Raises CalibrationError where it shows none."""
    try:
        found = locate(_cloud(seen, mounting), model, Prior(T_base_port, LATERAL_M, ALONG_M, TILT_RAD, ROLL_RAD))
    except PortdockError as error:
        raise CalibrationError(f"sweep {number + 1}: {error.cause}", remedy=_REMEDY) from error
    if found.inlier_ratio < LEAST_INLIERS:
        raise CalibrationError(f"the port is not found in sweep {number + 1}", remedy=_REMEDY)
    return found.T_ref_port


def on_port(seen: Sightings, target: PortTarget, mounting: Mounting, near_m: float) -> FoundPort:
    """Which sightings lie on the port, edges left out."""
    local = target.T_base_port.inverse().apply(seen.in_base(mounting))
    distance, nearest = target.tree.query(local, distance_upper_bound=near_m, workers=2)
    chosen = np.isfinite(distance)
    chosen[chosen] = target.surface.edge_m[nearest[chosen]] > EDGE_M
    return FoundPort(chosen, target, mounting)


def _settled(seen: Sightings, found: FoundPort) -> FoundPort | None:
    """Fitted to the points themselves; None if these do not come to lie on the port."""
    if found.on_port.sum() < 50:
        return None
    some = seen.of(thinned(found.on_port, MOST_FITTED))
    mounting, target, _ = fitted(some, found.target, found.mounting, Asked().columns, SHEAR_SCALE_M)
    again = on_port(seen, target, mounting, NEAR_M)
    points = seen.of(again.on_port).in_base(mounting)
    off_m = target.distances(points).residual
    if not len(off_m) or np.mean(np.abs(off_m) < GOOD_M) < GOOD_SHARE:
        return None
    return replace(again, target=target.with_free_depths(points))


def thinned(chosen: NDArray[np.bool_], most: int) -> NDArray[np.bool_]:
    """(N,) at most so many of the chosen ones, evenly spread."""
    numbers = np.flatnonzero(chosen)
    few = np.zeros(len(chosen), dtype=bool)
    few[numbers[np.unique(np.linspace(0, len(numbers) - 1, min(most, len(numbers))).astype(np.int64))]] = True
    return few


def _cloud(seen: Sightings, mounting: Mounting) -> Cloud:
    origins = np.einsum("pij,j->pi", seen.rotations, mounting.T_flange_scanner.translation) + seen.translations
    return Cloud(seen.in_base(mounting), "base", origins[seen.profile])


def _middle(seen: Sightings, number: int) -> Pose:
    """T_base_flange in the middle of a sweep."""
    row = np.flatnonzero(seen.sweep == number)
    return Pose(seen.rotations[row[len(row) // 2]], seen.translations[row[len(row) // 2]])


def _brought_together(
    T_base_flange: list[Pose], T_scanner_port: list[Pose], guess: Mounting, T_base_port: Pose
) -> tuple[Mounting, Pose]:
    """Mounting and port with which every sweep shows the port at one place."""
    guessed = guess.T_flange_scanner

    def scanner(x: Array) -> Pose:
        turned = guessed @ exp([0.0, 0.0, 0.0, *x[3:6]])
        return Pose(turned.rotation, turned.translation + x[:3])

    def off(x: Array) -> Array:
        port, mount = T_base_port @ exp(x[6:]), scanner(x)
        seen = [
            port.inverse() @ flange @ mount @ one for flange, one in zip(T_base_flange, T_scanner_port, strict=True)
        ]
        rows = [np.concatenate([one.translation / PLACE_M, one.rotvec / TURN_RAD]) for one in seen]
        return np.concatenate([*rows, x[:3] / GUESS_M, x[3:6] / GUESS_RAD])

    solved = least_squares(off, np.zeros(12), loss="soft_l1").x
    return replace(guess, T_flange_scanner=scanner(solved)), T_base_port @ exp(solved[6:])
