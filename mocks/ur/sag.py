"""How far gravity bends the emulated arm: each joint gives in proportion to the torque that the weight puts on it.

Masses are a UR10e's, each in the middle of its link, for other models in proportion to what they can carry; plug and
scanner hang at the flange. Not simulated: bending of the tubes themselves, friction, what the controller compensates.
The arm stands upright.
"""

from __future__ import annotations

import numpy as np

from mocks.ur.kinematics import Kinematics
from perception.geometry import Array

LINK_KG = np.array([7.4, 13.1, 4.0, 2.1, 2.0, 0.6])
LINKS_OF_PAYLOAD_KG = 12.5
"""That these links belong to."""
TOOL_KG = 3.0
G_M_S2 = 9.81
REUSED_WITHIN_RAD = 1e-3
"""So far the last deflection is good enough: over this way it changes by a thousandth, less than a micrometre."""


class Sag:
    """Deflection of the joints by their angles."""

    def __init__(self, kinematics: Kinematics, compliance_rad_per_nm: float) -> None:
        self._kinematics = kinematics
        self._compliance_rad_per_nm = compliance_rad_per_nm
        links = LINK_KG * kinematics.model.payload_kg / LINKS_OF_PAYLOAD_KG
        self._weight_n = G_M_S2 * np.append(links, TOOL_KG)
        self._at: Array | None = None
        self._deflection = np.zeros(6)

    def torques(self, q: Array) -> Array:
        """(6,) Nm that gravity puts on the joints at ``q`` (6,) rad, in their own sense of turning."""
        links = self._kinematics.links(q)
        origins = np.vstack([np.zeros(3), links[:, :3, 3]])
        axes = np.vstack([[0.0, 0.0, 1.0], links[:5, :3, 2]])
        masses = np.vstack([0.5 * (origins[:-1] + origins[1:]), origins[-1]])
        arms = masses[None, :, :2] - origins[:6, None, :2]
        # A weight pulls along -z: its moment (arm x force) is (-y, x, 0) times the weight.
        about = -arms[:, :, 1] * axes[:, :1] + arms[:, :, 0] * axes[:, 1:2]
        carried = np.arange(7)[None, :] >= np.arange(6)[:, None]
        return np.asarray((about * carried) @ self._weight_n)

    def deflection(self, q: Array) -> Array:
        """(6,) rad by which the joints truly stand off ``q``."""
        if self._at is None or float(np.abs(q - self._at).max()) > REUSED_WITHIN_RAD:
            self._at, self._deflection = q.copy(), self._compliance_rad_per_nm * self.torques(q)
        return self._deflection
