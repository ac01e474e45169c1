"""The arm's state link: every sample the controller sends, stamped with the host's clock.

Freshness is judged by samples that bring a new time stamp of the controller's own, never by a connection being open.
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
from drivers.arm.rtde_stream import RawSample, RtdeStream
from drivers.base import ArmState, ByteSink, Clock, LinkHealth, ProtocolError, RobotMode, SafetyMode
from perception.geometry import Array, Pose

log = logging.getLogger(__name__)

PLAYING = 2
"""RTDE ``runtime_state`` of a running program."""
HISTORY = 60_000
"""Two minutes at 500 Hz."""
AT_REST_RAD_S = 0.005
AT_REST_M_S = 0.001
READ_S = 0.1
LEAST_STEP_S = 1e-6
"""Samples' times increase strictly, so that poses can be interpolated over them."""


class Telemetry:
    """Reader thread over one RTDE stream."""

    def __init__(
        self,
        host: str,
        frequency_hz: float,
        timeout_s: float,
        T_flange_tcp: Pose,
        sink: ByteSink,
        clock: Clock,
        on_state: Callable[[ArmState], None],
    ) -> None:
        """Open the link and wait for the first sample. Raises ArmAbsentError, ProtocolError or FrozenStateError."""
        self._T_flange_tcp = T_flange_tcp
        self._frequency_hz = frequency_hz
        self._sink = sink
        self._clock = clock
        self._on_state = on_state
        self._history: deque[ArmState] = deque(maxlen=HISTORY)
        self._history_lock = threading.Lock()
        self._payload = (0.0, np.zeros(3))
        self._samples = 0
        self._missed = 0
        self._gone: str | None = None
        self._stop = threading.Event()
        self._stream = RtdeStream(host, timeout_s)
        try:
            self._stream.start(frequency_hz)
            self._take(self._stream.read(timeout_s))
            if not self._history:
                raise FrozenStateError("the controller accepts the state link but sends nothing")
        except BaseException:
            self._stream.close()
            raise
        self._thread = threading.Thread(target=self._run, name="arm-telemetry", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and the link."""
        self._stop.set()
        self._stream.close()
        self._thread.join(2.0)

    # --- for the arm -------------------------------------------------------------------------------------------------

    def newest(self) -> ArmState | None:
        """The newest sample however old it is."""
        return self._history[-1] if self._history else None

    def is_fresh(self, freshness_s: float) -> bool:
        """Whether the link is up and a sample came within the last ``freshness_s``."""
        state = self.newest()
        return self._gone is None and state is not None and self._clock.now_s() - state.time_s <= freshness_s

    def fresh(self, freshness_s: float) -> ArmState:
        """The newest sample. Raises StateLinkLostError or FrozenStateError if it is older than ``freshness_s``."""
        state = self.newest()
        if state is not None and self.is_fresh(freshness_s):
            return state
        if self._gone is not None:
            raise StateLinkLostError(f"the arm's state link is lost: {self._gone}")
        age = "none came yet" if state is None else f"the last is {self._clock.now_s() - state.time_s:.2f} s old"
        raise FrozenStateError(f"the arm's state link is open but brings no new samples ({age})")

    def history(self, since_s: float) -> list[ArmState]:
        """Samples received after ``since_s``, oldest first."""
        with self._history_lock:
            found = list(takewhile(lambda state: state.time_s > since_s, reversed(self._history)))
        return found[::-1]

    def payload(self) -> tuple[float, Array]:
        """Mass (kg) and centre of gravity (3,) in m that the controller reckons with."""
        return self._payload

    def health(self, freshness_s: float) -> LinkHealth:
        """Judged by the age of the newest sample."""
        state, up = self.newest(), self.is_fresh(freshness_s)
        counters = (("samples", self._samples), ("missed", self._missed))
        return LinkHealth(up, None if state is None else state.time_s, counters, self._gone or "")

    # --- the thread --------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._take(self._stream.read(READ_S))
            except (OSError, ProtocolError) as error:
                self._gone = str(error)
                if not self._stop.is_set():
                    log.error("the arm's state link is lost: %s", error)
                return

    def _take(self, samples: list[RawSample]) -> None:
        """Stamp, keep and hand on what came at once: spread evenly by device time since the sample before."""
        last = self.newest()
        samples = [one for one in samples if last is None or one.timestamp_s != last.device_time_s]
        if not samples:
            return
        now_s = self._clock.now_s()
        before_s = now_s if last is None else last.time_s
        device_before_s = samples[0].timestamp_s if last is None else last.device_time_s
        span_s = samples[-1].timestamp_s - device_before_s
        for sample in samples:
            share = (sample.timestamp_s - device_before_s) / span_s if span_s > 0.0 else 1.0
            self._keep(self._state(sample, before_s + share * (now_s - before_s)))
        self._payload = (samples[-1].payload_kg, np.array(samples[-1].payload_cog_m))

    def _keep(self, state: ArmState) -> None:
        last = self.newest()
        if last is not None:
            steps = round((state.device_time_s - last.device_time_s) * self._frequency_hz)
            self._missed += max(0, steps - 1)
        self._samples += 1
        with self._history_lock:
            self._history.append(state)
        self._sink.arm_state(state)
        self._on_state(state)

    def _state(self, sample: RawSample, time_s: float) -> ArmState:
        last = self.newest()
        tcp_speed = np.array(sample.tcp_speed)
        moving = max(map(abs, sample.qd)) > AT_REST_RAD_S or float(np.linalg.norm(tcp_speed[:3])) > AT_REST_M_S
        return ArmState(
            time_s=time_s if last is None else max(time_s, last.time_s + LEAST_STEP_S),
            device_time_s=sample.timestamp_s,
            T_base_tcp=Pose.from_vector(sample.tcp_pose),
            T_flange_tcp=self._T_flange_tcp,
            joints=np.array(sample.q),
            tcp_speed=tcp_speed,
            wrench=np.array(sample.tcp_force),
            mode=_known(RobotMode, sample.robot_mode, RobotMode.NO_CONTROLLER),
            safety=_known(SafetyMode, sample.safety_mode, SafetyMode.FAULT),
            moving=moving,
            program_running=sample.runtime_state == PLAYING,
            speed_scaling=float(np.clip(sample.speed_scaling * sample.speed_fraction, 0.0, 1.0)),
            digital_outputs=sample.digital_outputs & 0xFF,
        )


def _known(kind: Any, value: int, otherwise: Any) -> Any:
    """A member of an enumeration; newer controllers know more values, which are taken for the worst."""
    try:
        return kind(value)
    except ValueError:
        return otherwise
