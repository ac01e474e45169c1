"""An arm's two links that play recorded states and the recorded results of commands.

What the control worker knew of a motion is not in a recording; it is read off the states: a motion is done when the
arm rests at its target, and failed when the controller's program ends before.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from drivers.arm import messages as m
from drivers.arm.errors import ControlLinkLostError, FrozenStateError
from drivers.arm.links import Links
from drivers.arm.motion import ARRIVED_M, ARRIVED_RAD, SETTLE_S
from drivers.arm.settings import UrSettings
from drivers.arm.telemetry import Telemetry
from drivers.arm.worker_client import CALL_S, WorkerClient
from drivers.base import ArmCommandRecord, ArmState, LinkHealth, NullSink
from drivers.playback import ARM, EndOfRecording, Playback
from perception.geometry import Pose

NAMES: dict[type, str] = {
    m.MoveJoints: "move_joints",
    m.MoveLinear: "move_linear",
    m.MoveVelocity: "move_velocity",
    m.Comply: "comply",
    m.Stop: "stop",
    m.ZeroForceSensor: "zero_force_sensor",
}


_SILENCE_S, _STEP_S = 6.0, 0.01
"""A lost link shows here by silence: longest, and how often it is looked at meanwhile."""


@dataclass(frozen=True, slots=True)
class Window:
    """Within which arm samples a sweep used what it used."""

    first_s: float
    last_s: float


class PlayedTelemetry(Telemetry):
    """The state link as it was recorded, seen at the playback's time."""

    def __init__(self, playback: Playback, states: Sequence[ArmState], windows: Sequence[Window]) -> None:
        self._playback, self._states, self._windows = playback, states, windows
        self._times = [state.time_s for state in states]

    def close(self) -> None:
        """Nothing to close."""

    def newest(self) -> ArmState | None:
        """The newest sample; before the first one, that one."""
        if not self._states:
            return None
        return self._states[max(0, bisect_right(self._times, self._playback.now_s()) - 1)]

    def is_fresh(self, freshness_s: float) -> bool:
        """Whether a sample came within the last ``freshness_s``."""
        state = self.newest()
        return state is not None and self._playback.now_s() - state.time_s <= freshness_s

    def fresh(self, freshness_s: float) -> ArmState:
        """The newest sample. Raises FrozenStateError."""
        state = self.newest()
        if state is None or not self.is_fresh(freshness_s):
            raise FrozenStateError("the recording has no newer sample of the arm")
        return state

    def history(self, since_s: float) -> list[ArmState]:
        """Samples after ``since_s`` up to now; around a sweep, those that the sweep used."""
        end_s = self._playback.now_s()
        begin = bisect_right(self._times, since_s)
        for window in self._windows:
            if window.first_s <= end_s < window.last_s + SETTLE_S:
                end_s = min(end_s, window.last_s)
                begin = max(begin, bisect_right(self._times, np.nextafter(window.first_s, 0.0)))
                break
        return list(self._states[begin : bisect_right(self._times, end_s)])

    def after(self, time_s: float) -> list[ArmState]:
        """Samples after ``time_s`` up to now."""
        return list(self._states[bisect_right(self._times, time_s) : bisect_right(self._times, self._playback.now_s())])

    def health(self, freshness_s: float) -> LinkHealth:
        """Judged by the age of the newest sample."""
        return LinkHealth(self.is_fresh(freshness_s), self._playback.now_s(), ())


def _phase(state: ArmState, target: Pose, stopped: bool) -> m.Phase:
    """What a sample says of a motion that was under way."""
    if not state.program_running:
        return "failed"
    if state.moving:
        return "running"
    off_m, off_rad = state.T_base_tcp.distance_to(target), state.T_base_tcp.angle_to(target)
    return "done" if stopped or (off_m <= ARRIVED_M and off_rad <= ARRIVED_RAD) else "running"


class PlayedWorker(WorkerClient):
    """Answers commands as they were answered."""

    def __init__(self, playback: Playback, telemetry: PlayedTelemetry, commands: Sequence[ArmCommandRecord]) -> None:
        self._playback, self._telemetry = playback, telemetry
        self._commands = list(commands)
        self._given = 0
        self._moving: tuple[int, Pose, float] | None = None
        self._stopped = False
        self._known = m.Status(True, 0, "idle")
        self._known_s = -1.0
        playback.cue(ARM, [command.time_s for command in commands])

    @property
    def lost(self) -> str | None:
        """Never: what could not be asked is told by ``ask``."""
        return None

    @property
    def status(self) -> m.Status:
        """What became of the newest motion."""
        if self._moving is not None:
            number, target, looked_s = self._moving
            for state in self._telemetry.after(looked_s):
                phase = _phase(state, target, self._stopped)
                if phase != "running":
                    self._moving = None
                    self._known, self._known_s = m.Status(phase != "failed", number, phase), state.time_s
                    break
                self._moving = number, target, state.time_s
        return self._known

    @property
    def status_s(self) -> float:
        """When that was known."""
        return self._known_s

    def ask(self, command: m.Command, timeout_s: float = CALL_S) -> m.Reply:
        """The recorded answer, at the recorded time. Raises ControlLinkLostError as recorded, and EndOfRecording."""
        name = NAMES[type(command)]
        if self._is_held_up(name):
            self._let_stops_overtake()
        record = self._next(0)
        if record is None or record.name != name:
            raise EndOfRecording(f"{name} was not the next command to the arm")
        self._given += 1
        self._playback.did(ARM)
        if record.result == "lost":
            raise ControlLinkLostError("the arm did not answer in the recording")
        refusal, _, detail = record.result.partition(": ")
        if refusal != "ok":
            return m.Reply(0, cast(m.Refusal, refusal), detail)
        self._follow(command)
        return m.Reply(0)

    def _next(self, further: int) -> ArmCommandRecord | None:
        number = self._given + further
        return self._commands[number] if number < len(self._commands) else None

    def _is_held_up(self, name: str) -> bool:
        """Whether the recorded command waited in vain for its answer while the supervisor stopped the arm: its result
        stands after that of the stop."""
        first, second = self._next(0), self._next(1)
        return (
            first is not None and second is not None and name != "stop" and (first.name, second.name) == ("stop", name)
        )

    def _let_stops_overtake(self) -> None:
        """Time passes until the stop has been given here too."""
        given, end_s = self._given, self._playback.now_s() + _SILENCE_S
        while self._given == given and self._playback.now_s() < end_s:
            self._playback.pass_time(self._playback.now_s() + _STEP_S)

    def _follow(self, command: m.Command) -> None:
        if isinstance(command, m.MoveJoints | m.MoveLinear):
            self._stopped = False
            self._moving = (command.motion_id, Pose.from_vector(command.pose), self._playback.now_s())
            self._known = m.Status(True, command.motion_id, "running")
        elif isinstance(command, m.Stop):
            self._stopped = True

    def kick(self) -> None:
        """Nobody to tell."""

    def quit(self) -> None:
        """Nobody to tell."""


class PlayedLinks(Links):
    """Both, behind the real arm driver."""

    def __init__(
        self,
        settings: UrSettings,
        playback: Playback,
        states: Sequence[ArmState],
        commands: Sequence[ArmCommandRecord],
        windows: Sequence[Window],
    ) -> None:
        super().__init__(settings, NullSink(), playback)
        telemetry = PlayedTelemetry(playback, states, windows)
        self._telemetry = telemetry
        self._worker = PlayedWorker(playback, telemetry, commands)

    def open(self) -> None:
        """Nothing to open."""

    def restart(self) -> None:
        """Nothing to restart."""

    def close(self) -> None:
        """Nothing to close."""

    def set_output(self, number: int, level: bool) -> None:
        """Nobody to tell: a replay touches no robot."""

    def end_program(self) -> None:
        """Nobody to tell."""
