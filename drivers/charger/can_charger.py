"""A charger's control unit on a CAN bus, as ``drivers.base.Charger``.

It sends nothing by itself: heartbeat, pose and the repeats of a request go out when ``heartbeat`` is called, and only
the supervisor's tick calls that. It believes nothing it did not just receive: a frame counts once its checksum and
counter fit, and the charger is alive while such frames keep coming.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from drivers.base import (
    ByteSink,
    CanFrame,
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
from drivers.charger.bus_link import EVIDENCE_S, BusLink, Connect
from drivers.charger.contract import Contract
from drivers.charger.e2e import Scheme
from drivers.charger.freshness import Liveness
from drivers.charger.incoming import Incoming
from drivers.charger.outgoing import Outgoing
from drivers.charger.settings import CanSettings

_AT_ONCE = (ChargerRequest.ABORT, ChargerRequest.STOP_POWER)


class CanCharger:
    """The charger at the other end of one CAN link. Its methods may be called from any thread."""

    def __init__(
        self, settings: CanSettings, clock: Clock, sink: ByteSink | None = None, connect: Connect = BusLink
    ) -> None:
        """Load the contract. Raises InputError for a DBC that lacks messages or signals.

        ``connect``: what makes the link; a replay gives one that plays recorded frames.
        """
        contract = Contract(settings.dbc, settings.protection, settings.robot_address, settings.charger_address)
        self._settings, self._clock = settings, clock
        self._lock = threading.RLock()
        self._news = threading.Condition(self._lock)
        self._incoming = Incoming(contract, settings)
        self._outgoing = Outgoing(contract, settings)
        filters = [(codec.arbitration_id, codec.is_extended) for codec in contract.from_charger]
        self._link = connect(settings, clock, sink or NullSink(), self._hear, filters, contract.is_fd)
        self._before_loss: tuple[CanFrame, ...] = ()
        self._losses = 0
        self._alarm: Callable[[], None] = lambda: None

    # --- life ---------------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Open the bus and wait for the charger's first valid status. Raises LinkOpenError."""
        self._link.open()
        with self._news:
            answered = self._news.wait_for(lambda: self._incoming.status is not None, self._settings.open_timeout_s)
        if not answered:
            self.close()
            raise self._no_answer()

    def close(self) -> None:
        """Stop listening and close the bus. Idempotent."""
        self._link.close()

    def _no_answer(self) -> LinkOpenError:
        where = f"{self._settings.interface} channel {self._settings.channel}"
        bad = self._incoming.counters()["bad_checksum"]
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
            status = self._incoming.charger_status(now_s)
            if status is None:
                self._keep_evidence()
                raise LinkLostError(self._incoming.why_not(now_s, self._link.trouble))
            return status

    def traffic_before_loss(self) -> tuple[CanFrame, ...]:
        """The bus's traffic from 2 s before the newest loss on, both directions; told once, else empty."""
        with self._lock:
            frames, self._before_loss = self._before_loss, ()
            return frames

    def alert(self, alarm: Callable[[], None]) -> None:
        """Call this, from the reader's thread, as soon as a valid frame says emergency stop, fault or no motion."""
        self._alarm = alarm

    def health(self) -> LinkHealth:
        """State of the link with every counter."""
        with self._lock:
            now_s = self._clock.now_s()
            freshness = self._incoming.freshness
            liveness = freshness.at(now_s)
            counters = dict(self._link.counters)  # copied at once: both threads of the link go on counting
            counters |= self._incoming.counters() | {"resent_requests": self._outgoing.handshake.resent}
            notes = [
                liveness.value if liveness is not Liveness.ALIVE else "",
                self._link.trouble or self._incoming.suspicion,
                "frames are not protected" if self._settings.protection is Scheme.NONE else "",
            ]
            return LinkHealth(
                up=self._incoming.trusted(now_s),
                last_rx_s=freshness.last_s,
                counters=tuple(sorted(counters.items())),
                detail="; ".join(note for note in notes if note),
            )

    def _keep_evidence(self) -> None:
        """Once for each loss."""
        freshness = self._incoming.freshness
        if freshness.losses > self._losses and freshness.last_s is not None:
            self._losses = freshness.losses
            self._before_loss = self._link.tail.since(freshness.last_s - EVIDENCE_S)

    def _hear(self, frame: CanFrame) -> None:
        self._receive(frame.arbitration_id, frame.data, frame.time_s)

    def _receive(self, identifier: int, data: bytes, now_s: float) -> None:
        """A data frame came in. Runs in the reader thread."""
        with self._news:
            before = self._incoming.status
            first = before is None
            if not self._incoming.take(identifier, data, now_s):
                return
            status = self._incoming.status
            assert status is not None
            if first:
                self._outgoing.handshake.adopt(status.ack_sequence)
            self._outgoing.handshake.acknowledge(status.ack_sequence, status.ack_result)
            self._news.notify_all()
        if status.alarming and not (before is not None and before.alarming):
            self._alarm()

    # --- what the robot says ------------------------------------------------------------------------------------

    def heartbeat(self, beat: Heartbeat) -> None:
        """Send one heartbeat, and request and pose when due. Only the supervisor's tick calls this.

        Never waits for the bus. Raises CommandRejectedError for values that the contract's signals cannot carry.
        """
        with self._lock:
            self._link.send(self._outgoing.tick(beat, self._clock.now_s()))

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
            sequence = self._outgoing.handshake.start(request, argument, now_s)
            if request in _AT_ONCE:
                self._link.send([self._outgoing.command(now_s)])
            return sequence

    def result(self, sequence: int) -> RequestResult:
        """What became of the request with this sequence number."""
        with self._lock:
            try:
                return self._outgoing.handshake.result(sequence, self._clock.now_s())
            except KeyError:
                raise CommandRejectedError(f"there is no request number {sequence}") from None

    def refusal(self) -> str:
        """The charger's own word for why it refused the newest request; empty when it did not."""
        with self._lock:
            return self._incoming.refusal()

    def publish(self, pose: DockPose | None) -> None:
        """Announce a pose with the next heartbeats, or None to withdraw it: a group that says "invalid", then none.

        Raises CommandRejectedError for a pose that is not finite or does not fit; it is withdrawn then.
        """
        with self._lock:
            self._outgoing.announce(pose, self._clock.now_s())
