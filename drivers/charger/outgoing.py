"""What the robot says: frames with counters, the pending request, the announced pose. Its owner locks and sends."""

from __future__ import annotations

import can

from drivers.base import CommandRejectedError, DockPose, Heartbeat
from drivers.charger import contract, messages
from drivers.charger.contract import Codec, Contract, FrameError
from drivers.charger.e2e import next_counter
from drivers.charger.handshake import Handshake
from drivers.charger.settings import CanSettings

_EARLY = 0.9
"""A cyclic frame is due a little before its cycle is over, so that a tick that comes early does not skip one."""
_SAID = 3
"""How often a withdrawn pose is said to be withdrawn."""


class Outgoing:
    """The sending side of the contract."""

    def __init__(self, the_contract: Contract, settings: CanSettings) -> None:
        self._contract = the_contract
        self._modulus = settings.protection.counter_modulus
        self._counters: dict[str, int] = {}
        self._pose: DockPose | None = None
        self._pose_sequence = 0
        self._pose_sent_s: float | None = None
        self._withdrawals = 0
        cycle_s = the_contract[contract.COMMAND].cycle_s
        self.handshake = Handshake(settings.ack_timeout_s, settings.ack_resends, cycle_s)

    def tick(self, beat: Heartbeat, now_s: float) -> list[can.Message]:
        """The heartbeat, then what else is due. Raises CommandRejectedError for values that do not fit."""
        codec = self._contract[contract.HEARTBEAT]
        try:
            frames = [_message(codec, messages.encode_heartbeat(codec, self._count(codec.name), beat))]
            if self.handshake.due(now_s):
                frames.append(self.command(now_s))
            return frames + self._pose_frames(now_s)
        except FrameError as error:
            raise CommandRejectedError(f"not to be put into a CAN frame: {error}") from error

    def command(self, now_s: float) -> can.Message:
        """The newest request, or that there is none."""
        codec = self._contract[contract.COMMAND]
        request, sequence, argument = self.handshake.outgoing()
        frame = messages.encode_command(codec, self._count(codec.name), request, sequence, argument)
        self.handshake.sent(now_s)
        return _message(codec, frame)

    def announce(self, pose: DockPose | None, now_s: float) -> None:
        """Take a pose for the next ticks, or withdraw it. Raises CommandRejectedError and withdraws what cannot go."""
        had_pose, self._pose, self._pose_sent_s = self._pose is not None, None, None
        self._pose_sequence += 1
        self._withdrawals = _SAID if had_pose else 0
        if pose is None:
            return
        try:
            messages.encode_pose(self._contract, 0, self._pose_sequence, pose, now_s)
        except FrameError as error:
            self._withdrawals = _SAID
            raise CommandRejectedError(f"the pose cannot be sent to the charger: {error}") from error
        self._pose = pose

    def _pose_frames(self, now_s: float) -> list[can.Message]:
        codecs = [self._contract[name] for name in self._contract.pose_names]
        due = self._pose_sent_s is None or now_s - self._pose_sent_s >= _EARLY * codecs[0].cycle_s
        if not due or (self._pose is None and self._withdrawals == 0):
            return []
        counter = self._count("pose")
        if self._pose is not None:
            frames = messages.encode_pose(self._contract, counter, self._pose_sequence, self._pose, now_s)
        else:
            self._withdrawals -= 1
            frames = messages.encode_no_pose(self._contract, counter, self._pose_sequence)
        self._pose_sent_s = now_s
        return [_message(codec, frame) for codec, frame in zip(codecs, frames, strict=True)]

    def _count(self, name: str) -> int:
        """The next counter of a message."""
        self._counters[name] = next_counter(self._counters.get(name, -1), self._modulus)
        return self._counters[name]


def _message(codec: Codec, data: bytes) -> can.Message:
    return can.Message(
        arbitration_id=codec.arbitration_id,
        is_extended_id=codec.is_extended,
        is_fd=codec.is_fd,
        bitrate_switch=codec.is_fd,
        data=data,
    )
