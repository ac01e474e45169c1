"""The arm's state link: every sample the controller sends, stamped with the host's clock.

A sample is new when the controller's own time stamp has changed; that, and not the library's word for being connected,
is what freshness is judged by. ur_rtde's receive interface survives a lost link, so it may live in this process.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from itertools import takewhile
from typing import Any

import numpy as np

from drivers.arm.errors import FrozenStateError, StateLinkLostError
from drivers.base import ArmState, ByteSink, Clock, LinkHealth, LinkOpenError, RobotMode, SafetyMode
from perception.geometry import Array, Pose

log = logging.getLogger(__name__)

VARIABLES = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "robot_mode",
    "safety_mode",
    "runtime_state",
    "speed_scaling",
    "target_speed_fraction",
    "payload",
    "payload_cog",
)
"""Only names that ur_rtde knows: one that it does not would shift all fields behind it."""

PLAYING = 2
"""RTDE ``runtime_state`` of a running program."""
HISTORY = 60_000
"""Two minutes at 500 Hz."""
AT_REST_RAD_S = 0.005
AT_REST_M_S = 0.001
ATTEMPTS = 5


class Telemetry:
    """Reader thread over one RTDEReceiveInterface."""

    def __init__(
        self,
        host: str,
        frequency_hz: float,
        T_flange_tcp: Pose,
        sink: ByteSink,
        clock: Clock,
        on_state: Callable[[ArmState], None],
    ) -> None:
        self._T_flange_tcp = T_flange_tcp
        self._frequency_hz = frequency_hz
        self._sink = sink
        self._clock = clock
        self._on_state = on_state
        self._history: deque[ArmState] = deque(maxlen=HISTORY)
        self._history_lock = threading.Lock()
        self._samples = 0
        self._missed = 0
        self._torn = 0
        self._stop = threading.Event()
        self._receive = _connect(host, frequency_hz)
        self._take()
        self._thread = threading.Thread(target=self._run, name="arm-telemetry", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and the link."""
        self._stop.set()
        self._thread.join(2.0)
        _retire(self._receive)

    # --- for the arm -------------------------------------------------------------------------------------------------

    def newest(self) -> ArmState | None:
        """The newest sample however old it is."""
        return self._history[-1] if self._history else None

    def is_fresh(self, freshness_s: float) -> bool:
        """Whether the link is up and a sample came within the last ``freshness_s``."""
        state = self.newest()
        recent = state is not None and self._clock.now_s() - state.time_s <= freshness_s
        return recent and bool(self._receive.isConnected())

    def fresh(self, freshness_s: float) -> ArmState:
        """The newest sample. Raises StateLinkLostError or FrozenStateError if it is older than ``freshness_s``."""
        state = self.newest()
        if state is not None and self.is_fresh(freshness_s):
            return state
        if not self._receive.isConnected():
            raise StateLinkLostError("the controller closed the arm's state link")
        age = "none came yet" if state is None else f"the last is {self._clock.now_s() - state.time_s:.2f} s old"
        raise FrozenStateError(f"the arm's state link is open but brings no new samples ({age})")

    def history(self, since_s: float) -> list[ArmState]:
        """Samples received after ``since_s``, oldest first."""
        with self._history_lock:
            found = list(takewhile(lambda state: state.time_s > since_s, reversed(self._history)))
        return found[::-1]

    def payload(self) -> tuple[float, Array]:
        """Mass (kg) and centre of gravity (3,) in m that the controller reckons with."""
        return float(self._receive.getPayload()), np.asarray(self._receive.getPayloadCog(), dtype=np.float64)

    def health(self, freshness_s: float) -> LinkHealth:
        """Judged by the age of the newest sample."""
        state, up = self.newest(), self.is_fresh(freshness_s)
        counters = (("samples", self._samples), ("missed", self._missed), ("torn", self._torn))
        return LinkHealth(up, None if state is None else state.time_s, counters)

    # --- the thread --------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        pause_s = 0.25 / self._frequency_hz
        while not self._stop.wait(pause_s):
            try:
                self._take()
            except Exception as error:  # the library's own types; the reader must outlive any of them
                if not self._stop.is_set():
                    log.error("the arm's state cannot be read: %s", error)
                return

    def _take(self) -> None:
        """Read one sample if there is a new one."""
        last = self.newest()
        if last is not None and self._receive.getTimestamp() == last.device_time_s:
            return
        state = self._read()
        if state is None:
            return
        if last is not None:
            steps = round((state.device_time_s - last.device_time_s) * self._frequency_hz)
            self._missed += max(0, steps - 1)
        self._samples += 1
        with self._history_lock:
            self._history.append(state)
        self._sink.arm_state(state)
        self._on_state(state)

    def _read(self) -> ArmState | None:
        """One consistent sample: fields are read one by one, so the time stamp must be the same before and after."""
        r = self._receive
        for _ in range(ATTEMPTS):
            stamp = r.getTimestamp()
            values = (
                r.getActualQ(),
                r.getActualQd(),
                r.getActualTCPPose(),
                r.getActualTCPSpeed(),
                r.getActualTCPForce(),
                r.getRobotMode(),
                r.getSafetyMode(),
                r.getRuntimeState(),
                r.getSpeedScaling() * r.getTargetSpeedFraction(),
            )
            if r.getTimestamp() == stamp:
                return self._state(stamp, *values)
            self._torn += 1
        return None

    def _state(
        self,
        stamp: float,
        q: list[float],
        qd: list[float],
        pose: list[float],
        speed: list[float],
        force: list[float],
        mode: int,
        safety: int,
        runtime: int,
        scaling: float,
    ) -> ArmState:
        tcp_speed = np.array(speed)
        moving = max(map(abs, qd)) > AT_REST_RAD_S or float(np.linalg.norm(tcp_speed[:3])) > AT_REST_M_S
        return ArmState(
            time_s=self._clock.now_s(),
            device_time_s=stamp,
            T_base_tcp=Pose.from_vector(pose),
            T_flange_tcp=self._T_flange_tcp,
            joints=np.array(q),
            tcp_speed=tcp_speed,
            wrench=np.array(force),
            mode=_known(RobotMode, mode, RobotMode.NO_CONTROLLER),
            safety=_known(SafetyMode, safety, SafetyMode.FAULT),
            moving=moving,
            program_running=runtime == PLAYING,
            speed_scaling=float(np.clip(scaling, 0.0, 1.0)),
        )


def _known(kind: Any, value: int, otherwise: Any) -> Any:
    """A member of an enumeration; newer controllers know more values, which are taken for the worst."""
    try:
        return kind(value)
    except ValueError:
        return otherwise


_RETIRED: list[Any] = []
"""Closed interfaces, kept to the process's end: the library's destructor sleeps while it holds Python's global lock,
which would hold up the supervisor's tick for half a second."""


def _retire(receive: Any) -> None:
    """Disconnect, which takes half a second, in a thread of its own. Not a daemon: cut off at exit, it aborts."""
    _RETIRED.append(receive)
    threading.Thread(target=receive.disconnect, name="arm-disconnect", daemon=False).start()


def _connect(host: str, frequency_hz: float) -> Any:
    from rtde_receive import RTDEReceiveInterface  # compiled; here, so that the module's logic imports without it

    try:
        return RTDEReceiveInterface(host, frequency_hz, list(VARIABLES))
    except (RuntimeError, ValueError) as error:
        raise LinkOpenError(f"the arm's state link cannot be opened: {error}") from error
