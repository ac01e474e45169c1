"""A charger's control unit on a CAN bus, as ``drivers.base.Charger``.

It sends nothing by itself: heartbeat, pose and the repeats of a request go out when ``heartbeat`` is called, and only
the supervisor's tick calls that. It believes nothing it did not just receive: a frame counts once its checksum and
counter fit, and the charger is alive while such frames keep coming.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter

import can

from drivers.base import (
    ByteSink,
    ChargerRequest,
    ChargerStatus,
    Clock,
    CommandRejectedError,
    DockPose,
    Heartbeat,
    LinkHealth,
    LinkLostError,
    LinkOpenError,
    NullSink,
    RequestResult,
)
from drivers.charger import contract, messages
from drivers.charger.bus_link import BusLink
from drivers.charger.contract import Codec, Contract, FrameError
from drivers.charger.e2e import Receiver, Scheme, Verdict, next_counter
from drivers.charger.freshness import Freshness, Liveness
from drivers.charger.handshake import Handshake
from drivers.charger.messages import ElectricalFrame, StatusFrame
from drivers.charger.settings import CanSettings

_log = logging.getLogger(__name__)
_AT_ONCE = (ChargerRequest.ABORT, ChargerRequest.STOP_POWER)
_EARLY = 0.9
"""A cyclic frame is due a little before its cycle is over, so that a tick that comes early does not skip one."""


class CanCharger:
    """The charger at the other end of one CAN link. Its methods may be called from any thread."""

    def __init__(self, settings: CanSettings, clock: Clock, sink: ByteSink | None = None) -> None:
        """Load the contract. Raises InputError for a DBC that lacks messages or signals."""
        self._settings, self._clock = settings, clock
        self._contract = Contract(settings.dbc, settings.protection, settings.robot_address, settings.charger_address)
        self._lock = threading.RLock()
        self._news = threading.Condition(self._lock)
        self._codecs = {codec.arbitration_id: codec for codec in self._contract.from_charger}
        self._receivers = {i: Receiver(codec.protection) for i, codec in self._codecs.items()}
        self._status_receiver = self._receivers[self._contract[contract.STATUS].arbitration_id]
        self._freshness = Freshness(settings.degraded_s, settings.lost_s, settings.recovery_frames)
        command = self._contract[contract.COMMAND]
        self._handshake = Handshake(settings.ack_timeout_s, settings.ack_resends, command.cycle_s)
        self._counters: Counter[str] = Counter()
        self._heard_s: dict[int, float] = {}
        self._tx_counter: dict[str, int] = {}
        self._status: StatusFrame | None = None
        self._electrical: tuple[ElectricalFrame, float] | None = None
        self._pose: DockPose | None = None
        self._pose_sequence = 0
        self._withdrawals = 0
        self._pose_sent_s: float | None = None
        filters = [(c.arbitration_id, c.is_extended) for c in self._contract.from_charger]
        self._link = BusLink(settings, clock, sink or NullSink(), self._receive, filters, self._contract.is_fd)

    # --- life ---------------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Open the bus and wait for the charger's first valid status. Raises LinkOpenError."""
        self._link.open()
        with self._news:
            answered = self._news.wait_for(lambda: self._status is not None, self._settings.open_timeout_s)
        if not answered:
            self.close()
            raise self._no_answer()

    def close(self) -> None:
        """Stop listening and close the bus. Idempotent."""
        self._link.close()

    def _no_answer(self) -> LinkOpenError:
        where = f"{self._settings.interface} channel {self._settings.channel}"
        bad = self._total(Verdict.BAD_CRC)
        if bad:
            return LinkOpenError(
                f"{bad} frames of a charger arrived on {where}, but their checksums do not fit",
                remedy=f"Check that the charger protects its frames by {self._settings.protection.value} too.",
            )
        detail = f" ({self._link.trouble})" if self._link.trouble else ""
        return LinkOpenError(
            f"no charger answers on {where}{detail}",
            remedy="Check the charger's power, the bus wiring and termination, bit rate and DBC.",
        )

    # --- what the charger says ----------------------------------------------------------------------------------

    def status(self) -> ChargerStatus:
        """The newest valid status. Raises LinkLostError while the charger is silent or not yet trusted again.

        Voltage and current are NaN before the first electrical frame, so that no comparison with a limit holds.
        """
        with self._lock:
            now_s = self._clock.now_s()
            liveness = self._freshness.at(now_s)
            status, last_s = self._status, self._freshness.last_s
            trusted = liveness in (Liveness.ALIVE, Liveness.DEGRADED) and not self._status_receiver.two_senders
            if status is None or last_s is None or not trusted:
                raise LinkLostError(self._lost_text(now_s, liveness))
            electrical, at_s = self._electrical or (_NO_ELECTRICAL, float("-inf"))
            return ChargerStatus(
                time_s=last_s,
                state=status.state,
                proximity=status.proximity,
                pilot=status.pilot,
                lock=status.lock,
                contactor_closed=status.contactor_closed,
                dock_enable=status.dock_enable,
                motion_inhibit=status.motion_inhibit,
                estop=status.estop,
                fault_code=status.code if status.code < messages.FIRST_REJECTION_CODE else 0,
                voltage_v=electrical.voltage_v,
                current_a=electrical.current_a,
                electrical_time_s=at_s,
            )

    def health(self) -> LinkHealth:
        """State of the link with every counter."""
        with self._lock:
            now_s = self._clock.now_s()
            liveness = self._freshness.at(now_s)
            up = liveness in (Liveness.ALIVE, Liveness.DEGRADED) and not self._status_receiver.two_senders
            counters = self._link.counters + self._counters
            for verdict in Verdict:
                counters[_COUNTER_NAMES[verdict]] = self._total(verdict)
            counters["missed"] = sum(r.missed for r in self._receivers.values())
            counters["losses"] = self._freshness.losses
            counters["resent_requests"] = self._handshake.resent
            notes = [liveness.value if liveness is not Liveness.ALIVE else "", self._trouble()]
            if self._settings.protection is Scheme.NONE:
                notes.append("frames are not protected")
            detail = "; ".join(note for note in notes if note)
            return LinkHealth(up, self._freshness.last_s, tuple(sorted(counters.items())), detail)

    def _lost_text(self, now_s: float, liveness: Liveness) -> str:
        trouble, last_s = self._trouble(), self._freshness.last_s
        detail = f" ({trouble})" if trouble else ""
        if last_s is None:
            return f"the charger has not been heard yet{detail}"
        if liveness is Liveness.LOST:
            return f"no valid status from the charger for {now_s - last_s:.2f} s{detail}"
        if liveness is Liveness.RECOVERING:
            return f"the charger was lost and is being heard again{detail}"
        return f"the charger cannot be believed{detail}"

    def _trouble(self) -> str:
        """What is known to be wrong with the bus, else with the frames on it."""
        return self._link.trouble or self._status_receiver.suspicion

    def _total(self, verdict: Verdict) -> int:
        return sum(receiver.counts[verdict] for receiver in self._receivers.values())

    def _receive(self, identifier: int, data: bytes, now_s: float) -> None:
        """A data frame came in: check it, then keep it as the newest of its kind. Runs in the reader thread."""
        codec = self._codecs.get(identifier)
        if codec is None:
            self._counters["foreign_frames"] += 1
            return
        with self._news:
            if now_s - self._heard_s.get(identifier, now_s) > max(self._settings.lost_s, 5.0 * codec.cycle_s):
                self._receivers[identifier].forget()
            self._heard_s[identifier] = now_s
            try:
                self._accept(codec, data, now_s)
            except FrameError as error:
                self._counters["bad_frames"] += 1
                _log.debug("frame dropped: %s", error)

    def _accept(self, codec: Codec, data: bytes, now_s: float) -> None:
        counter = int(codec.decode(data).get("Counter", 0))
        verdict = self._receivers[codec.arbitration_id].check(data, counter)
        is_status = codec.name == contract.STATUS
        if not verdict.accepted:
            if is_status and verdict is not Verdict.INITIAL:
                self._freshness.bad()
            return
        if not is_status:
            self._electrical = (messages.decode_electrical(codec, data), now_s)
            return
        status = messages.decode_status(codec, data)
        if self._status is None:
            self._handshake.adopt(status.ack_sequence)
        self._status = status
        self._freshness.good(now_s)
        self._handshake.acknowledge(status.ack_sequence, status.ack_result)
        self._news.notify_all()

    # --- what the robot says ------------------------------------------------------------------------------------

    def heartbeat(self, beat: Heartbeat) -> None:
        """Send one heartbeat, and request and pose when due. Only the supervisor's tick calls this.

        Raises CommandRejectedError for values that the contract's signals cannot carry.
        """
        with self._lock:
            now_s = self._clock.now_s()
            codec = self._contract[contract.HEARTBEAT]
            try:
                frames = [_message(codec, messages.encode_heartbeat(codec, self._count(codec.name), beat))]
                if self._handshake.due(now_s):
                    frames.append(self._command_frame(now_s))
                frames.extend(self._pose_frames(now_s))
            except FrameError as error:
                raise CommandRejectedError(f"not to be put into a CAN frame: {error}") from error
            self._link.send(frames)

    def request(self, request: ChargerRequest, argument: int = 0) -> int:
        """Start a command hand-shake; returns its sequence number.

        It goes out with the next heartbeat and after it, so that the charger knows what the heartbeat says (the plug
        is mated, say) before it judges the request; what makes safe does not wait. An unfinished earlier request is
        given up as FAILED. Raises CommandRejectedError for an argument outside 0 to 65535.
        """
        if not 0 <= argument <= 0xFFFF:
            raise CommandRejectedError(f"{request.name} cannot take the argument {argument}: 0 to 65535 fit")
        with self._lock:
            now_s = self._clock.now_s()
            sequence = self._handshake.start(request, argument, now_s)
            if request in _AT_ONCE:
                self._link.send([self._command_frame(now_s)])
            return sequence

    def result(self, sequence: int) -> RequestResult:
        """What became of the request with this sequence number."""
        with self._lock:
            try:
                return self._handshake.result(sequence, self._clock.now_s())
            except KeyError:
                raise CommandRejectedError(f"there is no request number {sequence}") from None

    def refusal(self) -> str:
        """The charger's own word for why it refused the newest request; empty when it did not."""
        with self._lock:
            if self._status is None or self._status.ack_result is not RequestResult.REJECTED:
                return ""
            return messages.describe_code(self._contract[contract.STATUS], self._status.code)

    def publish(self, pose: DockPose | None) -> None:
        """Announce a pose with the next heartbeats, or None to withdraw it: a group that says "invalid", then none.

        Raises CommandRejectedError for a pose that is not finite or does not fit; it is withdrawn then.
        """
        with self._lock:
            had_pose, self._pose, self._pose_sent_s = self._pose is not None, None, None
            self._pose_sequence += 1
            self._withdrawals = 3 if had_pose else 0
            if pose is None:
                return
            try:
                messages.encode_pose(self._contract, 0, self._pose_sequence, pose, self._clock.now_s())
            except FrameError as error:
                self._withdrawals = 3
                raise CommandRejectedError(f"the pose cannot be sent to the charger: {error}") from error
            self._pose = pose

    def _command_frame(self, now_s: float) -> can.Message:
        codec = self._contract[contract.COMMAND]
        request, sequence, argument = self._handshake.outgoing()
        frame = messages.encode_command(codec, self._count(codec.name), request, sequence, argument)
        self._handshake.sent(now_s)
        return _message(codec, frame)

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
        modulus = self._settings.protection.counter_modulus
        self._tx_counter[name] = next_counter(self._tx_counter.get(name, -1), modulus)
        return self._tx_counter[name]


_NO_ELECTRICAL = ElectricalFrame(float("nan"), float("nan"), float("nan"), float("nan"))
_COUNTER_NAMES = {
    Verdict.OK: "ok",
    Verdict.LOST: "lost",
    Verdict.INITIAL: "initial",
    Verdict.REPEATED: "repeated",
    Verdict.WRONG_SEQUENCE: "wrong_sequence",
    Verdict.BAD_CRC: "bad_checksums",
}


def _message(codec: Codec, data: bytes) -> can.Message:
    return can.Message(
        arbitration_id=codec.arbitration_id,
        is_extended_id=codec.is_extended,
        is_fd=codec.is_fd,
        bitrate_switch=codec.is_fd,
        data=data,
    )
