"""The mock charger's own rules, without a bus: what it grants, refuses and does by itself."""

from __future__ import annotations

import pytest

from mocks.charger.controls import parse
from mocks.charger.node import ChargerNode
from mocks.charger.supervision import RobotView, RobotWatch

HOLDS, CLEAR, MATED = 1 << 2, 1 << 4, 1 << 5
ALIVE = RobotView(alive=True, lost=False, flags=HOLDS | MATED)
LOST = RobotView(alive=False, lost=True, flags=HOLDS | MATED)
LOST_CLEAR = RobotView(alive=False, lost=True, flags=CLEAR)
STEP_S = 0.02


class Session:
    """A node with a clock, a plug and a robot that a test can change."""

    def __init__(self) -> None:
        self.node = ChargerNode()
        self.now_s = 0.0
        self.plugged = self.estop = False
        self.robot = ALIVE
        self._sequence = 0
        self.run(0.5)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self.node.step(self.now_s, self.plugged, self.estop, self.robot)

    def ask(self, name: str, argument: int = 0, seconds: float = 4.0) -> str:
        self._sequence += 1
        self.run(STEP_S)
        self.node.command(name, self._sequence, argument)
        self.run(seconds)
        return self.node.answer.result

    def charge(self) -> None:
        assert self.ask("Reserve") == self.ask("UnlockDock") == "Done"
        self.plugged = True
        assert self.ask("LockPlug") == self.ask("EnablePower") == "Done"
        assert self.node.state == "Charging"


@pytest.fixture
def session() -> Session:
    return Session()


def test_states_and_pilot_through_a_session(session: Session) -> None:
    node = session.node
    seen = [(node.state, node.status()["Pilot"])]
    for request in ("Reserve", "UnlockDock"):
        session.ask(request)
        seen.append((node.state, node.status()["Pilot"]))
    session.plugged = True
    session.ask("LockPlug")
    seen.append((node.state, node.status()["Pilot"]))
    session.ask("EnablePower")
    seen.append((node.state, node.status()["Pilot"]))
    session.ask("StopPower")
    seen.append((node.state, node.status()["Pilot"]))
    session.ask("UnlockPlug")
    session.plugged = False
    session.ask("Release")
    seen.append((node.state, node.status()["Pilot"]))
    assert seen == [
        ("Idle", "A"),
        ("Reserved", "A"),
        ("Ready", "A"),
        ("Ready", "B"),
        ("Charging", "C"),
        ("Finished", "B"),
        ("Idle", "A"),
    ]


def test_power_comes_by_handshake_and_pre_charge_before_the_contactor(session: Session) -> None:
    session.ask("Reserve")
    session.ask("UnlockDock")
    session.plugged = True
    session.ask("LockPlug")
    session.run(STEP_S)
    session.node.command("EnablePower", 99, 0)
    states, at_closing = [], None
    for _ in range(200):
        session.run(STEP_S)
        if not states or states[-1] != session.node.state:
            states.append(session.node.state)
        if session.node.power.contactor_closed and at_closing is None:
            at_closing = (session.node.power.voltage_v, session.node.power.current_a)
    assert states == ["Handshake", "PreCharge", "Charging"]
    assert at_closing is not None
    assert at_closing[0] >= 380.0
    assert at_closing[1] < 5.0


def test_the_current_ramps_and_stays_at_its_limit(session: Session) -> None:
    session.charge()
    session.run(10.0)
    assert session.node.electrical()["Current"] == 125.0
    assert session.node.electrical()["TempDC"] > 22
    before = session.node.power.charge_percent
    session.run(60.0)
    assert session.node.power.charge_percent > before


def test_the_contactor_opens_only_below_five_amperes(session: Session) -> None:
    session.charge()
    session.run(5.0)
    session.node.command("StopPower", 77, 0)
    while session.node.power.contactor_closed:
        current_a = session.node.power.current_a
        session.run(STEP_S)
    assert current_a < 10.0, "the step before it opened"
    assert session.node.answer.result == "Done"


@pytest.mark.parametrize(
    ("request_name", "reason"),
    [("UnlockDock", "WrongState"), ("LockPlug", "WrongState"), ("EnablePower", "WrongState"), ("Pirouette", "Unknown")],
)
def test_an_idle_charger_refuses(session: Session, request_name: str, reason: str) -> None:
    assert session.ask(request_name) == "Rejected"
    assert session.node.answer.reason.startswith(reason)


def test_a_repeated_number_is_acted_on_once(session: Session) -> None:
    session.charge()
    session.node.command("Abort", 50, 0)
    session.run(3.0)
    assert session.node.state == "Finished"
    session.node.process.fault = "None"
    session.node.command("Release", 50, 0)
    assert session.node.answer.result == "Done"
    assert session.node.state == "Finished", "the same number is no new request"


def test_a_busy_request_is_taken_up_when_it_is_repeated_later(session: Session) -> None:
    session.ask("Reserve")
    session.ask("UnlockDock")
    session.plugged = True
    session.run(STEP_S)
    session.node.command("LockPlug", 60, 0)
    session.node.command("UnlockPlug", 61, 0)
    assert session.node.answer.result == "Busy"
    session.run(2.0)
    session.node.command("UnlockPlug", 61, 0)
    assert session.node.answer.result == "Accepted"


@pytest.mark.parametrize("robot", [LOST, RobotView(alive=False, lost=True, flags=0)])
def test_a_lost_robot_at_the_plug_ends_the_charging(session: Session, robot: RobotView) -> None:
    session.charge()
    session.robot = robot
    session.run(3.0)
    assert session.node.state == "Fault"
    assert session.node.status()["FaultCode"] == "RobotLost"
    assert session.node.lock.state == "Locked"
    assert not session.node.power.contactor_closed


def test_a_lost_robot_that_is_clear_changes_nothing_but_the_inhibits(session: Session) -> None:
    session.charge()
    session.robot = LOST_CLEAR
    session.run(3.0)
    assert session.node.state == "Charging"
    assert session.node.status()["MotionInhibit"] == 1
    assert session.node.status()["DockEnable"] == 0


@pytest.mark.parametrize("prepared", ["Reserve", "UnlockDock"])
def test_a_loss_before_power_needs_a_reset(session: Session, prepared: str) -> None:
    session.ask("Reserve")
    session.ask(prepared)
    session.robot = LOST
    session.run(0.5)
    session.robot = ALIVE
    session.run(0.5)
    assert session.node.status()["MotionInhibit"] == 1
    assert session.ask("ResetFault") == "Done"
    assert session.node.status()["MotionInhibit"] == 0


def test_an_idle_charger_forgives_a_robot_that_was_away(session: Session) -> None:
    session.robot = LOST
    session.run(0.5)
    assert session.node.status()["MotionInhibit"] == 1
    session.robot = ALIVE
    session.run(0.5)
    assert session.node.status()["MotionInhibit"] == 0


def test_motion_is_inhibited_exactly_while_something_is_live_or_wrong(session: Session) -> None:
    session.ask("Reserve")
    session.ask("UnlockDock")
    session.plugged = True
    session.ask("LockPlug")
    assert session.node.status()["MotionInhibit"] == 0
    session.node.command("EnablePower", 90, 0)
    session.run(STEP_S)
    assert session.node.status()["MotionInhibit"] == 1
    session.run(4.0)
    assert session.ask("StopPower") == "Done"
    assert session.node.status()["MotionInhibit"] == 0


def test_an_emergency_stop_fails_what_was_going_on(session: Session) -> None:
    session.ask("Reserve")
    session.ask("UnlockDock")
    session.plugged = True
    session.ask("LockPlug")
    session.node.command("EnablePower", 90, 0)
    session.estop = True
    session.run(STEP_S)
    assert session.node.answer.result == "Failed"
    assert session.node.status()["Pilot"] == "E"


def test_a_full_battery_ends_the_charging(session: Session) -> None:
    session.charge()
    session.node.power.charge_percent = 99.999
    session.run(30.0)
    assert session.node.state == "Finished"


def test_a_pause_holds_the_current_at_zero_with_the_contactor_closed(session: Session) -> None:
    session.charge()
    session.node.process.paused = True
    session.run(3.0)
    assert (session.node.state, session.node.power.current_a) == ("Paused", 0.0)
    assert session.node.power.contactor_closed
    session.node.process.paused = False
    session.run(5.0)
    assert session.node.state == "Charging"
    assert session.node.power.current_a == 125.0


def test_the_release_button_ends_the_charging_and_is_seen_in_the_proximity(session: Session) -> None:
    session.charge()
    session.run(3.0)
    session.node.process.release_pressed = True
    session.run(STEP_S)
    assert session.node.status()["Prox"] == "ReleasePressed"
    session.run(3.0)
    assert session.node.state == "Finished"
    assert not session.node.power.contactor_closed
    assert session.node.lock.state == "Locked", "a button opens no lock"


def test_a_voltage_that_does_not_rise_is_a_fault_and_the_contactor_stays_open(session: Session) -> None:
    session.ask("Reserve")
    session.ask("UnlockDock")
    session.plugged = True
    session.ask("LockPlug")
    session.node.power.precharge_fails = True
    assert session.ask("EnablePower", seconds=8.0) == "Failed"
    assert session.node.status()["FaultCode"] == "PreChargeFailed"
    assert session.node.status()["Pilot"] == "F"
    assert not session.node.power.contactor_closed


def test_every_pilot_state_can_be_seen(session: Session) -> None:
    seen = {session.node.status()["Pilot"]}
    session.charge()
    seen.add(session.node.status()["Pilot"])
    session.node.process.ventilation = True
    seen.add(session.node.status()["Pilot"])
    session.ask("StopPower")
    seen.add(session.node.status()["Pilot"])
    session.estop = True
    session.run(STEP_S)
    seen.add(session.node.status()["Pilot"])
    seen.add(ChargerNode().status()["Pilot"])
    assert seen == set("ABCDEF")


# --- supervision --------------------------------------------------------------------------------------------------


def test_the_robot_is_alive_after_three_good_heartbeats_and_lost_after_250_ms() -> None:
    watch = RobotWatch(0.25, 15)
    alive = []
    for k in range(5):
        watch.heartbeat(k, 0, 0.05 * k)
        alive.append(watch.view(0.05 * k).alive)
    assert alive == [False, False, False, True, True], "the first only sets the counter"
    assert not watch.view(0.2 + 0.25).lost
    assert watch.view(0.2 + 0.26).lost


def test_a_heartbeat_that_repeats_itself_is_silence() -> None:
    watch = RobotWatch(0.25, 15)
    for k in range(5):
        watch.heartbeat(k, 0, 0.05 * k)
    for k in range(5, 12):
        watch.heartbeat(4, 0, 0.05 * k)
    assert watch.view(0.05 * 12).lost


@pytest.mark.parametrize("line", ["", "[1]", "nonsense", '{"silnet": true}'])
def test_a_control_line_that_is_not_understood_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match=r"control|JSON"):
        parse(line)
