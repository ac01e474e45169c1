"""The emulated arm in the mock world: its true tool meets the true port, and the others are told."""

from __future__ import annotations

import numpy as np

from mocks.spatial import inverse_of, matrix_of
from mocks.world import contact
from mocks.world.blackboard import Blackboard
from mocks.world.spec import WorldSpec
from perception.geometry import Array, Pose

FAR_M = 0.5
"""Beyond this distance from home nothing touches, and no contact is computed."""


class PortEnvironment:
    """What the plug can touch, and what the blackboard says and hears about it."""

    def __init__(self, world: WorldSpec, board: Blackboard) -> None:
        self._board = board
        self._T_flange_tcp = matrix_of(world.T_flange_tcp)
        self._T_port_base, self._cars = inverse_of(matrix_of(world.T_base_port)), 0
        self._port = contact.Port(
            T_port_tcp=Pose.from_vector(world.T_port_tcp),
            exists=world.panel == "port",
            blocked_depth_m=world.blocked_depth_m,
            parameters=contact.ContactParameters(
                capture_radius_m=world.capture_radius_m,
                capture_tilt_rad=world.capture_tilt_rad,
                capture_roll_rad=world.capture_roll_rad,
            ),
        )
        self._home = self._port.T_port_tcp.translation
        self._state = contact.ContactState()

    def step(self, T_base_flange: Array, dt: float) -> Array:
        """Wrench (6,) on the plug at its true TCP, base axes; publishes the plug's state."""
        self._see_next_car()
        T_port_tcp = self._T_port_base @ T_base_flange @ self._T_flange_tcp
        if float(np.abs(T_port_tcp[:3, 3] - self._home).max()) > FAR_M:
            self._state = contact.ContactState()
            return np.zeros(6)
        plug = contact.misalignment(T_port_tcp, self._port)
        self._state, wrench, told = contact.step(self._state, plug, self._port, self._board.lock())
        self._board.put_plug(told)
        R = self._T_port_base[:3, :3].T
        return np.concatenate([R @ wrench[:3], R @ wrench[3:]])

    def _see_next_car(self) -> None:
        """Another one may have parked since the last step."""
        cars = self._board.cars()
        T_base_port = self._board.car() if cars != self._cars else None
        if T_base_port is not None:
            self._cars, self._T_port_base = cars, inverse_of(matrix_of(T_base_port))
            self._state = contact.ContactState()
