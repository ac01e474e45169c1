"""The command hand-shake: one request at a time, acknowledged by its sequence number; pure, time is passed in.

The newest request is repeated cyclically with the same number. Without an acknowledgement it is sent again at once
after each time-out, and given up after the last. A newer request takes the place of an unfinished one.
"""

from __future__ import annotations

from collections import OrderedDict

from drivers.base import ChargerRequest, RequestResult

_KEPT = 64
_OPEN = (RequestResult.PENDING, RequestResult.ACCEPTED, RequestResult.BUSY)


class Handshake:
    """Requests with their sequence numbers and what became of them."""

    def __init__(self, ack_timeout_s: float, resends: int, cycle_s: float) -> None:
        self._ack_timeout_s, self._resends, self._cycle_s = ack_timeout_s, resends, cycle_s
        self._results: OrderedDict[int, RequestResult] = OrderedDict()
        self._request = ChargerRequest.NONE
        self._argument = 0
        self._sequence = 0
        self._attempt_s = 0.0
        self._attempts = 0
        self._sent_s: float | None = None
        self.resent = 0

    def adopt(self, acknowledged: int) -> None:
        """Count on from the charger's last number, so that its memory of an earlier controller does no harm."""
        if not self._results:
            self._sequence = acknowledged

    def start(self, request: ChargerRequest, argument: int, now_s: float) -> int:
        """Begin a request; it is due at once. Returns its sequence number, which goes on the wire modulo 256."""
        if self._results.get(self._sequence) in _OPEN:
            self._results[self._sequence] = RequestResult.FAILED
        self._sequence += 1
        self._request, self._argument = request, argument
        self._results[self._sequence] = RequestResult.PENDING
        while len(self._results) > _KEPT:
            self._results.popitem(last=False)
        self._attempt_s, self._attempts, self._sent_s = now_s, 1, None
        return self._sequence

    def acknowledge(self, wire_sequence: int, result: RequestResult) -> None:
        """Take over what a status frame says."""
        known = self._results.get(self._sequence)
        if known not in _OPEN:
            return
        if wire_sequence == self._sequence % 256:
            if result is not RequestResult.PENDING:
                self._settle(result)
        elif known is RequestResult.ACCEPTED:
            self._settle(RequestResult.FAILED)  # the charger restarted and has forgotten it

    def due(self, now_s: float) -> bool:
        """Whether a command frame is to be sent now; also gives up or begins the next attempt."""
        self._watch(now_s)
        return self._sent_s is None or now_s - self._sent_s >= 0.9 * self._cycle_s

    def sent(self, now_s: float) -> None:
        """A command frame was handed over."""
        self._sent_s = now_s

    def outgoing(self) -> tuple[ChargerRequest, int, int]:
        """Request, sequence number and argument that the next command frame carries: None once the newest is done."""
        if self._results.get(self._sequence) in _OPEN:
            return self._request, self._sequence, self._argument
        return ChargerRequest.NONE, self._sequence, 0

    def result(self, sequence: int, now_s: float) -> RequestResult:
        """What became of a request. Raises KeyError for a number that was never given out or is long gone."""
        self._watch(now_s)
        return self._results[sequence]

    def _watch(self, now_s: float) -> None:
        if self._results.get(self._sequence) is not RequestResult.PENDING:
            return
        if now_s - self._attempt_s < self._ack_timeout_s:
            return
        if self._attempts > self._resends:
            self._settle(RequestResult.TIMED_OUT)
            return
        self._attempts += 1
        self.resent += 1
        self._attempt_s, self._sent_s = now_s, None

    def _settle(self, result: RequestResult) -> None:
        self._results[self._sequence] = result
        if result not in _OPEN:
            self._sent_s = None
