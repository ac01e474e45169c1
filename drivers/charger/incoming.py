"""What the charger says: each frame checked, the newest of each kind kept, its silence measured. Its owner locks."""

from __future__ import annotations

import logging
from collections import Counter

from drivers.base import ChargerStatus, RequestResult
from drivers.charger import contract, messages
from drivers.charger.contract import Codec, Contract, FrameError
from drivers.charger.e2e import Receiver, Verdict
from drivers.charger.freshness import Freshness, Liveness
from drivers.charger.messages import ElectricalFrame, StatusFrame
from drivers.charger.settings import CanSettings

_log = logging.getLogger(__name__)
_NOT_MEASURED = (ElectricalFrame(float("nan"), float("nan"), float("nan"), float("nan")), float("-inf"))
_COUNTER_NAMES = {
    Verdict.OK: "ok",
    Verdict.LOST: "lost",
    Verdict.INITIAL: "initial",
    Verdict.REPEATED: "repeated",
    Verdict.WRONG_SEQUENCE: "wrong_sequence",
    Verdict.BAD_CRC: "bad_checksum",
}


class Incoming:
    """The receiving side of the contract."""

    def __init__(self, the_contract: Contract, settings: CanSettings) -> None:
        self._codecs = {codec.arbitration_id: codec for codec in the_contract.from_charger}
        self._receivers = {i: Receiver(codec.protection) for i, codec in self._codecs.items()}
        self._status_codec = the_contract[contract.STATUS]
        self._status_receiver = self._receivers[self._status_codec.arbitration_id]
        self._lost_s = settings.lost_s
        self._stale_s = max(settings.lost_s, 5.0 * the_contract[contract.ELECTRICAL].cycle_s)
        self._heard_s: dict[int, float] = {}
        self._counters: Counter[str] = Counter()
        self._electrical = _NOT_MEASURED
        self.freshness = Freshness(settings.degraded_s, settings.lost_s, settings.recovery_frames)
        self.status: StatusFrame | None = None

    def take(self, identifier: int, data: bytes, now_s: float) -> bool:
        """Check one data frame and keep it if it counts. True if it was a status that does."""
        codec = self._codecs.get(identifier)
        if codec is None:
            self._counters["foreign_frames"] += 1
            return False
        if now_s - self._heard_s.get(identifier, now_s) > max(self._lost_s, 5.0 * codec.cycle_s):
            self._receivers[identifier].forget()
        self._heard_s[identifier] = now_s
        try:
            return self._accept(codec, data, now_s)
        except FrameError as error:
            self._counters["bad_frames"] += 1
            _log.debug("frame dropped: %s", error)
            return False

    def _accept(self, codec: Codec, data: bytes, now_s: float) -> bool:
        counter = int(codec.decode(data).get("Counter", 0))
        verdict = self._receivers[codec.arbitration_id].check(data, counter)
        is_status = codec is self._status_codec
        if not verdict.accepted:
            if is_status and verdict is not Verdict.INITIAL:
                self.freshness.bad()
            return False
        if is_status:
            self.status = messages.decode_status(codec, data)
            self.freshness.good(now_s)
        else:
            self._electrical = (messages.decode_electrical(codec, data), now_s)
        return is_status

    def trusted(self, now_s: float) -> bool:
        """Whether the newest status may be believed."""
        alive = self.freshness.at(now_s) in (Liveness.ALIVE, Liveness.DEGRADED)
        return alive and self.status is not None and not self._status_receiver.two_senders

    def charger_status(self, now_s: float) -> ChargerStatus | None:
        """The newest status with the newest electrical values; None while it is not to be believed."""
        status, last_s = self.status, self.freshness.last_s
        if status is None or last_s is None or not self.trusted(now_s):
            return None
        electrical, electrical_s = self._electrical
        if now_s - electrical_s > self._stale_s:
            electrical = _NOT_MEASURED[0]
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
            electrical_time_s=electrical_s,
        )

    def why_not(self, now_s: float, trouble: str) -> str:
        """One line that says why the charger is not believed; ``trouble`` is what is wrong with the bus itself."""
        trouble, last_s = trouble or self.suspicion, self.freshness.last_s
        liveness, detail = self.freshness.at(now_s), f" ({trouble})" if trouble else ""
        if last_s is None:
            return f"the charger has not been heard yet{detail}"
        if liveness is Liveness.LOST:
            return f"no valid status from the charger for {now_s - last_s:.2f} s{detail}"
        if liveness is Liveness.RECOVERING:
            return f"the charger was lost and is being heard again{detail}"
        return f"the charger cannot be believed{detail}"

    @property
    def suspicion(self) -> str:
        """What the last status frames point to, when they are not one sender's; empty otherwise."""
        return self._status_receiver.suspicion

    def refusal(self) -> str:
        """The charger's word for why it refused the newest request; empty when it did not."""
        if self.status is None or self.status.ack_result is not RequestResult.REJECTED:
            return ""
        return messages.describe_code(self._status_codec, self.status.code)

    def counters(self) -> Counter[str]:
        """How many frames met which verdict."""
        total = self._counters.copy()
        for verdict, name in _COUNTER_NAMES.items():
            total[name] = sum(receiver.counts[verdict] for receiver in self._receivers.values())
        total["missed"] = sum(receiver.missed for receiver in self._receivers.values())
        total["late"], total["losses"] = self.freshness.late, self.freshness.losses
        return total
