"""One robot cell as the mission uses it: three devices, a clock, and the one way by which commands reach a device."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

from controller.car_evidence import Opinion, in_words, opinion
from controller.commands import (
    Announce,
    AskCharger,
    BackOff,
    Command,
    Comply,
    Laser,
    Motion,
    MoveJoints,
    MoveLinear,
    MoveVelocity,
    SetOutput,
    StopMotion,
    ZeroForce,
    described,
)
from controller.faults import FaultCode, MissionFault
from controller.planning import ReachCheck
from controller.safety import check, makes_safe
from controller.situation import Limits, Situation
from controller.states import State
from controller.supervisor import Supervisor
from drivers.base import (
    Arm,
    ArmState,
    Car,
    Charger,
    ChargerRequest,
    ChargerStatus,
    Clock,
    LinkHealth,
    LinkLostError,
    RequestResult,
    Scanner,
)
from perception.errors import PortdockError
from perception.estimate import PortEstimate, Prior
from perception.geometry import Pose
from perception.scan import Cloud

log = logging.getLogger(__name__)

CAUSE_TICKS = 25
"""So long may the state link lag behind the control link in telling why a command failed."""


class Locator(Protocol):
    """Perception in its worker process."""

    def submit(self, clouds: Sequence[Cloud], prior: Prior) -> Future[PortEstimate]: ...


class CommandLog(Protocol):
    """What the recorder offers to the gate."""

    def command(self, name: str, detail: str, allowed: bool, reason: str) -> None: ...


@dataclass(slots=True)
class Cell:
    """The devices, and ``do``: the only place from which a command reaches a driver."""

    arm: Arm
    scanner: Scanner
    charger: Charger
    locator: Locator
    supervisor: Supervisor
    clock: Clock
    wall: Clock
    limits: Limits
    reach: ReachCheck
    records: CommandLog
    profile_latency_s: float = 0.0
    """Least delay from a profile's device time stamp to its last byte, in the device's seconds."""
    time_scale: float = 1.0
    """Device seconds per wall second: not 1 only where mocks run fast."""
    recorded_since_s: float = -math.inf
    """What the arm said before is not in the mission's recording, and decides nothing in it."""
    T_base_port: Pose | None = None
    """The port pose that the gate holds motions against once there is a plan."""
    car: Car | None = None
    """What listens to the vehicle's own protocol, where the site has it."""
    coarse: Scanner | None = None
    """What looks first, where the site has it: here for its health only, the coarse stage drives it."""
    on_sweep: Callable[[int, float, float], None] = lambda profiles, arm_first_s, arm_last_s: None
    """Told what each sweep was made of (``Recorder.swept``)."""
    _request_sequence: int = 0

    # --- commands

    def do(self, command: Command) -> None:
        """Ask the gate, then the driver. Raises MissionFault: gate-refused, what a driver's refusal means, or the trip.

        After a trip nothing is given but what makes safe, and the one motion for which the supervisor makes an
        exception: out of contact, away from the vehicle, when only the charger is silent (``back_off``). A trip that
        comes while a motion is being given may have sent its stop before it: the arm is stopped once more.
        """
        if not makes_safe(command) and not (isinstance(command, BackOff) and self.supervisor.lets_back_off):
            self._raise_trip()
        refusal = check(command, self.situation(), self.limits)
        name, detail = type(command).__name__, described(command)
        self.records.command(name, detail, refusal is None, "" if refusal is None else str(refusal))
        if refusal is not None:
            raise self.explained(FaultCode.GATE_REFUSED, f"{name} ({detail}): {refusal}")
        try:
            self._give(command)
        except LinkLostError as error:
            raise self.explained(_LINK_OF.get(type(command), FaultCode.ARM_LINK_LOST), error.cause) from error
        except PortdockError as error:
            raise self.explained(FaultCode.MOTION_FAILED, error.cause) from error
        if isinstance(command, Motion) and self.supervisor.tripped_meanwhile:
            self.arm.stop()
            self._raise_trip()

    def _raise_trip(self) -> None:
        if (trip := self.supervisor.trip) is not None:
            raise MissionFault(trip.code, trip.detail)

    def explained(self, code: FaultCode, detail: str) -> MissionFault:
        """The fault, or the one behind it: a stop or a lost link shows in what it makes fail before a tick names it.

        Raises PauseRequested if what is behind it is only a pause, such as a person in the protected zone.
        """
        try:
            self.supervisor.wait_ticks(CAUSE_TICKS)
        except MissionFault as cause:
            return cause
        self.supervisor.raise_if_paused()
        return MissionFault(code, detail)

    def situation(self) -> Situation:
        """What the gate judges by, as fresh as the links have it."""
        facts = self.supervisor.facts
        return Situation(facts.state, self.arm_state(), self.charger_status(), self.T_base_port, facts.mated)

    def _give(self, command: Command) -> None:
        match command:
            case MoveJoints(target, speed, acceleration):
                self.arm.move_joints(target, speed, acceleration)
            case MoveLinear(target, speed, acceleration) | BackOff(target, speed, acceleration):
                self.arm.move_linear(target, speed, acceleration)
            case MoveVelocity(velocity, acceleration):
                self.arm.move_velocity(velocity, acceleration)
            case Comply(compliance):
                self.arm.comply(compliance)
            case StopMotion():
                self.arm.stop()
            case ZeroForce():
                self.arm.zero_force_sensor()
            case Laser(on=True):
                self.scanner.start()
            case Laser(on=False):
                self.scanner.stop()
            case SetOutput(number, level):
                self.arm.set_output(number, level)
            case AskCharger(request):
                self._request_sequence = self.charger.request(request)
            case Announce(pose):
                self.charger.publish(pose)

    # --- what the devices say

    def arm_state(self) -> ArmState | None:
        """The newest arm state, None when it is not fresh."""
        try:
            return self.arm.state()
        except LinkLostError:
            return None

    def charger_status(self) -> ChargerStatus | None:
        """The newest charger status, None when it is not fresh."""
        try:
            return self.charger.status()
        except LinkLostError:
            return None

    def charger_says(self, wanted: Callable[[ChargerStatus], bool]) -> bool:
        """Whether a fresh charger status fulfils ``wanted``."""
        status = self.charger_status()
        return status is not None and wanted(status)

    def compare_with_car(self, least_current_a: float) -> Opinion:
        """Ask the vehicle, where it can be heard, whether it is being charged; the answer goes into the log."""
        charger, car = self.charger_status(), None if self.car is None else self.car.status()
        said = opinion(charger, car, least_current_a)
        if said is not Opinion.NOBODY_LISTENS:
            log.log(
                logging.WARNING if said is Opinion.CONTRADICTED else logging.INFO,
                "second source: %s",
                in_words(said, charger, car),
            )
        return said

    # --- commands with an end

    def travel(self, command: MoveJoints | MoveLinear, timeout_s: float) -> None:
        """Give a motion and wait for its end. Raises MissionFault when the arm gives it up or time runs out."""
        self.do(command)
        if not self.supervisor.wait(lambda: not self.arm.motion().running, timeout_s):
            raise MissionFault(FaultCode.MOTION_FAILED, f"{type(command).__name__} did not end in {timeout_s:.0f} s")
        progress = self.arm.motion()
        if progress.failed:
            raise self.explained(FaultCode.MOTION_FAILED, progress.detail or f"{type(command).__name__} failed")

    def ask(self, request: ChargerRequest, timeout_s: float) -> RequestResult:
        """Give the charger a request and wait for its answer."""
        self.do(AskCharger(request))
        sequence = self._request_sequence
        open_results = (RequestResult.PENDING, RequestResult.ACCEPTED, RequestResult.BUSY)
        self.supervisor.wait(lambda: self.charger.result(sequence) not in open_results, timeout_s)
        return self.charger.result(sequence)

    def settle(self, still_m_s: float, timeout_s: float) -> None:
        """Wait until the TCP is at rest."""

        def still() -> bool:
            state = self.arm_state()
            return state is not None and bool(abs(state.tcp_speed[:3]).max() < still_m_s) and not state.moving

        if not self.supervisor.wait(still, timeout_s):
            raise MissionFault(FaultCode.MOTION_FAILED, "the arm does not come to rest")

    def healths(self) -> tuple[tuple[str, LinkHealth], ...]:
        """(name, health) of each device that the site has."""
        devices: dict[str, Arm | Scanner | Charger | Car | None] = {
            "arm": self.arm,
            "scanner": self.scanner,
            "charger": self.charger,
            "car": self.car,
            "coarse": self.coarse,
        }
        return tuple((name, device.health()) for name, device in devices.items() if device is not None)

    def recover_arm(self) -> None:
        """A new control link after a pause, with no memory of old motions. Raises MissionFault."""
        try:
            self.arm.recover()
        except PortdockError as error:
            raise self.explained(FaultCode.ARM_NOT_READY, error.cause) from error

    def restore_links(self) -> None:
        """For an operator's reset: what was lost is opened again. Raises DriverError; the arm does not move.

        A scanner that stays lost is the next dock's matter: a plug is taken out without one.
        """
        try:
            self.restore_scanner()
        except PortdockError as error:
            log.error("the scanner stays lost: %s", error)
        self.arm.recover()

    def restore_scanner(self) -> None:
        """Open the scanner again if its line is down: an adapter may have gone and come. Raises DriverError."""
        if not self.scanner.health().up:
            self.scanner.close()
            self.scanner.open()

    def freeze(self, *, scanning: bool) -> None:
        """Stop what moves and measures. A scanner that is not in use keeps no plug in a port: its trouble is logged."""
        self.do(StopMotion())
        try:
            self.do(Laser(on=False))
        except PortdockError as error:
            if scanning:
                raise
            log.error("%s", error)

    def make_safe(self) -> None:
        """On entry to FAULT: nothing moves, no laser, no power wanted. Each is tried, whatever the others do."""
        for command in (StopMotion(), Laser(on=False), Announce(None), AskCharger(ChargerRequest.ABORT)):
            try:
                self.do(command)
            except PortdockError as error:
                log.error("making safe: %s", error)

    def enter(self, state: State, stay_s: float | None) -> None:
        """Tell supervisor and gate that the mission is in ``state`` now."""
        self.supervisor.enter(state, stay_s)


_LINK_OF: dict[type, FaultCode] = {
    Laser: FaultCode.SCANNER_LINK_LOST,
    AskCharger: FaultCode.CHARGER_LINK_LOST,
    Announce: FaultCode.CHARGER_LINK_LOST,
}
