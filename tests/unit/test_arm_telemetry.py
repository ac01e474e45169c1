"""The arm's state link: when a sample was taken, how old it may be, and what is said when none comes any more."""

from __future__ import annotations

import socket
import struct
import threading

import numpy as np
import pytest

from drivers.arm.errors import FrozenStateError, StateLinkLostError
from drivers.arm.telemetry import Telemetry
from drivers.base import ArmState, RobotMode, SafetyMode
from perception.geometry import Pose
from tests.arm_rig import Sink, own_address, until

KINDS = b"DOUBLE,VECTOR6D,VECTOR6D,VECTOR6D,VECTOR6D,VECTOR6D,INT32,INT32,UINT32,DOUBLE,DOUBLE,DOUBLE,VECTOR3D,UINT64"


class ManualClock:
    def __init__(self) -> None:
        self.time_s = 100.0

    def now_s(self) -> float:
        return self.time_s

    def sleep(self, seconds: float) -> None:
        self.time_s += seconds


def package(kind: str, payload: bytes) -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


def sample(timestamp_s: float, qd: float = 0.0, safety: int = 1, mode: int = 7) -> bytes:
    doubles = [timestamp_s, *[0.1] * 6, *[qd] * 6, *[0.2] * 6, *[0.0] * 6, *[0.0] * 6]
    modes = struct.pack(">iiI", mode, safety, 2)
    rest = struct.pack(">6dQ", 0.5, 0.5, 2.5, 0.0, 0.01, 0.06, 0)
    return package("U", b"\x01" + struct.pack(">31d", *doubles) + modes + rest)


class Controller:
    """Answers the set-up, then sends what the test says."""

    def __init__(self) -> None:
        self.host = own_address()
        self._server = socket.create_server((self.host, 30004))
        self._thread = threading.Thread(target=self._set_up, daemon=True)
        self._thread.start()

    def _set_up(self) -> None:
        self.link, _ = self._server.accept()
        replies = {"V": b"\x01", "v": struct.pack(">4I", 5, 15, 0, 0), "O": b"\x01" + KINDS, "S": b"\x01"}
        while True:
            size, kind = struct.unpack(">HB", self.link.recv(3, socket.MSG_WAITALL))
            if size > 3:
                self.link.recv(size - 3, socket.MSG_WAITALL)
            self.link.sendall(package(chr(kind), replies[chr(kind)]))
            if chr(kind) == "S":
                self.link.sendall(sample(10.0))
                return

    def send(self, data: bytes) -> None:
        self._thread.join(5.0)
        self.link.sendall(data)

    def close(self) -> None:
        self.link.close()
        self._server.close()


class Bench:
    def __init__(self) -> None:
        self.controller = Controller()
        self.clock = ManualClock()
        self.sink = Sink()
        self.states: list[ArmState] = []
        self.telemetry = Telemetry(
            self.controller.host, 125.0, 2.0, Pose.identity(), self.sink, self.clock, self.states.append
        )

    def send(self, data: bytes, count: int) -> list[ArmState]:
        """Send, and wait until so many states in all have been taken."""
        self.controller.send(data)
        until(lambda: len(self.states) >= count, "the samples are taken")
        return self.states


@pytest.fixture
def bench():
    made = Bench()
    yield made
    made.telemetry.close()
    made.controller.close()


def test_fields_land_where_they_belong(bench) -> None:
    state = bench.telemetry.newest()
    assert state is not None
    assert state.device_time_s == 10.0
    assert state.joints == pytest.approx([0.1] * 6)
    assert (state.mode, state.safety, state.program_running) == (RobotMode.RUNNING, SafetyMode.NORMAL, True)
    assert state.speed_scaling == 0.25
    assert not state.moving
    mass, cog = bench.telemetry.payload()
    assert (mass, cog.tolist()) == (2.5, [0.0, 0.01, 0.06])
    assert bench.sink.states == [state]


def test_samples_that_queued_up_are_spread_by_the_controllers_clock(bench) -> None:
    bench.clock.time_s += 0.04
    states = bench.send(sample(10.008) + sample(10.016) + sample(10.04), 4)
    assert [state.time_s for state in states] == pytest.approx([100.0, 100.008, 100.016, 100.04])
    assert dict(bench.telemetry.health(1.0).counters) == {"samples": 4, "missed": 2}


def test_times_increase_even_if_the_hosts_clock_does_not(bench) -> None:
    states = bench.send(sample(10.008), 2)
    states = bench.send(sample(10.016), 3)
    assert (np.diff([state.time_s for state in states]) > 0).all()


def test_a_repeated_time_stamp_is_no_new_sample(bench) -> None:
    bench.clock.time_s += 0.5
    bench.controller.send(sample(10.0) * 3)
    assert len(bench.send(sample(10.008), 2)) == 2


def test_movement_is_seen_in_the_joints(bench) -> None:
    assert bench.send(sample(10.008, qd=0.02), 2)[-1].moving


def test_modes_of_the_future_are_taken_for_the_worst(bench) -> None:
    state = bench.send(sample(10.008, safety=42, mode=42), 2)[-1]
    assert (state.mode, state.safety) == (RobotMode.NO_CONTROLLER, SafetyMode.FAULT)


def test_old_state_is_frozen_state(bench) -> None:
    bench.clock.time_s += 0.19
    assert bench.telemetry.fresh(0.2) is bench.telemetry.newest()
    bench.clock.time_s += 0.02
    with pytest.raises(FrozenStateError, match=r"0\.21 s old"):
        bench.telemetry.fresh(0.2)
    assert not bench.telemetry.health(0.2).up


@pytest.mark.parametrize("data", [b"", package("U", b"\x01" + bytes(10)), b"\x00\x01X"])
def test_a_closed_link_or_nonsense_on_it_is_a_lost_link_at_once(bench, data) -> None:
    if data:
        bench.controller.send(data)
    else:
        bench.controller.link.close()
    until(lambda: not bench.telemetry.is_fresh(60.0), "the loss is seen")
    with pytest.raises(StateLinkLostError):
        bench.telemetry.fresh(60.0)


def test_history_gives_what_came_after_a_moment(bench) -> None:
    for k in range(1, 6):
        bench.clock.time_s += 0.008
        bench.send(sample(10.0 + 0.008 * k), k + 1)
    since_s = bench.states[2].time_s
    assert bench.telemetry.history(since_s) == bench.states[3:]
    assert bench.telemetry.history(-1.0) == bench.states
