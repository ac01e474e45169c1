"""What an arm does not know of itself: joint zeros, lengths, and how far it gives under weight. Pure, any serial arm.

To first order: such errors move the flange by tenths of a millimetre, what is left out by less than a micrometre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.geometry import Array, exp_many

COUNT = 19
"""Parameters: six of a, six of d (Denavit-Hartenberg lengths, m), six joint zeros (rad), one compliance (rad/Nm)."""
G_M_S2 = 9.81


@dataclass(frozen=True, slots=True)
class Weights:
    """What bends the arm: each link's mass in its middle, the load at the flange. The arm stands upright.

    Only proportions matter where the compliance is estimated along with them; these are a UR10e's.
    """

    links_kg: tuple[float, float, float, float, float, float] = (7.4, 13.1, 4.0, 2.1, 2.0, 0.6)
    load_kg: float = 3.0


def error_jacobian(frames: Array, weights: Weights) -> Array:
    """How errors move the true flange against the told one: twists in the flange's frame per unit of each parameter.

    :param frames: (P, 7, 4, 4) base, each joint's link, the last being the flange (Denavit-Hartenberg)
    :return: (P, 6, 19), translation first
    """
    axes, origins, flange = frames[:, :6, :3, 2], frames[:, :6, :3, 3], frames[:, 6, None, :3, 3]
    along_x = frames[:, 1:, :3, 0]
    zeros = np.concatenate([np.cross(axes, flange - origins), axes], axis=2)  # (P, 6 joints, 6)
    lengths = [np.concatenate([way, np.zeros_like(way)], axis=2) for way in (along_x, axes)]
    gives = np.einsum("pk,pki->pi", gravity_torques(frames, weights), zeros)[:, None]
    in_base = np.concatenate([*lengths, zeros, gives], axis=1)  # (P, 19, 6)
    rotations = frames[:, 6, :3, :3]
    parts = (np.einsum("pji,pkj->pik", rotations, in_base[:, :, part]) for part in (slice(0, 3), slice(3, 6)))
    return np.concatenate(list(parts), axis=1)


def gravity_torques(frames: Array, weights: Weights) -> Array:
    """(P, 6) Nm that gravity puts on the joints, in their own sense of turning."""
    origins, axes = frames[:, :, :3, 3], frames[:, :6, :3, 2]
    masses = np.concatenate([0.5 * (origins[:, 1:] + origins[:, :-1]), origins[:, -1:]], axis=1)  # (P, 7, 3)
    arms = masses[:, None] - origins[:, :6, None]  # (P, 6 joints, 7 masses, 3)
    about = arms[..., 0] * axes[:, :, None, 1] - arms[..., 1] * axes[:, :, None, 0]
    carried = np.arange(7)[None] >= np.arange(6)[:, None]
    return np.asarray((about * carried) @ (G_M_S2 * np.array([*weights.links_kg, weights.load_kg])))


def true_in_told(frames: Array, errors: Array, weights: Weights) -> Array:
    """(P, 4, 4): the true flange in the frame of the flange that the arm tells, for each of P sets of frames.

    :param errors: (19,)
    """
    return exp_many(error_jacobian(frames, weights) @ errors)
