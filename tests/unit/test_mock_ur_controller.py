"""Power, safety and programs of the emulated controller, without sockets."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocks.ur.script_server import ScriptClient
from mocks.ur.script_text import moves_in, parse_call
from mocks.ur.state import PowerMode, RuntimeState, Safety
from tests.unit.mock_ur_parts import JOINTS, Wire, new_controller, run

CONTROL = "def rtde_control():\n  # float register offset\n0\n  # int register offset\n0\nend\n"
UPPER = CONTROL.replace("\n0\n", "\n24\n")
FAR = "def far():\n  movej([1.0,-1.5708,1.5708,-1.5708,-1.5708,0.0], a=1.4, v=1.0)\nend\n"


def _send(controller, text: str, piece: int = 4096) -> None:
    client = ScriptClient(Wire(), controller)  # type: ignore[arg-type]
    data = text.encode()
    for start in range(0, len(data), piece):
        client.received(data[start : start + piece])


def _command(controller, number: int, doubles: list[float] = [], integers: list[int] = [], offset: int = 0):  # noqa: B006
    values = {f"input_int_register_{offset}": (number,)}
    values |= {f"input_int_register_{offset + 1 + k}": (value,) for k, value in enumerate(integers)}
    values |= {f"input_double_register_{offset + k}": (value,) for k, value in enumerate(doubles)}
    controller.write_inputs(values)


# --- programs ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("piece", [1, 7, 4096])
def test_a_script_runs_once_its_end_has_arrived(piece: int) -> None:
    controller = new_controller()
    _send(controller, FAR.removesuffix("end\n"), piece)
    assert controller.program is None
    _send(controller, FAR, piece)
    assert controller.runtime_state == RuntimeState.PLAYING
    run(controller, 4.0)
    assert controller.runtime_state == RuntimeState.STOPPED
    assert controller.arm.q[0] == pytest.approx(1.0)


def test_a_bare_line_is_a_program_of_its_own() -> None:
    controller = new_controller()
    _send(controller, "set_digital_out(3, True)\n")
    run(controller, 0.05)
    assert controller.io.digital_out == 8 and controller.runtime_state == RuntimeState.STOPPED


def test_a_new_script_replaces_the_running_one() -> None:
    controller = new_controller()
    _send(controller, FAR)
    run(controller, 0.3)
    _send(controller, "def other():\n  sleep(10.0)\nend\n")
    run(controller, 2.0)
    assert controller.program_name == "other" and controller.arm.steady
    assert controller.arm.q[0] < 0.5


def test_local_mode_ignores_scripts_without_a_word() -> None:
    controller = new_controller()
    controller.remote = False
    _send(controller, FAR)
    assert controller.program is None and controller.runtime_state == RuntimeState.STOPPED


def test_registers_and_settings_from_a_simple_script() -> None:
    controller = new_controller()
    lines = (
        "write_output_integer_register(0 +24, 1)",
        "write_output_float_register(3, -0.25)",
        "write_output_integer_register(99, 1)",
        "set_tcp(p[0,0,0.1,0,0,0])",
        "set_payload(2.5, [0,0,0.04])",
        "undefined_function(1, 2)",
        "x = 3",
    )
    _send(controller, "def settings():\n" + "".join(f"\t{line}\n" for line in lines) + "end\n")
    run(controller, 0.05)
    assert controller.registers.out_int[24] == 1 and controller.registers.out_double[3] == -0.25
    assert controller.arm.reference.T_flange_tcp[2, 3] == pytest.approx(0.1)
    assert controller.payload.mass_kg == 2.5 and controller.payload.cog == pytest.approx([0, 0, 0.04])


@settings(max_examples=30, deadline=None)
@given(st.text(max_size=120))
def test_no_script_text_makes_the_controller_fail(text: str) -> None:
    controller = new_controller()
    _send(controller, f"def any():\n  {text}\nend\n")
    run(controller, 0.05)


@given(st.text(alphabet="movejl()p[]=,.-+e0123456789 a", max_size=60))
def test_no_line_makes_the_reader_of_calls_fail(line: str) -> None:
    parse_call(line)


def test_calls_are_read_with_named_and_positional_numbers() -> None:
    call = parse_call("\tmovel(p[0.1,-.2,3e-1,0,3.14,0],a=4,v=0.5,r=0.099)")
    assert call is not None and call.is_move and call.is_pose
    assert call.vector == pytest.approx([0.1, -0.2, 0.3, 0, 3.14, 0])
    assert (call.value("a", 0, 9.0), call.value("v", 1, 9.0), call.value("t", 2, 9.0)) == (4.0, 0.5, 9.0)


def test_an_injected_path_is_found_behind_its_marker() -> None:
    path = "\tsignal_async_progress(0)\n\tmovej([1,2,3,4,5,6],a=1,v=2,r=0)\n"
    text = f"a\n# inject move path\n{path}    end\nmovej([0,0,0,0,0,0])\n"
    moves = moves_in(text)
    assert [move.name for move in moves] == ["movej"] and moves[0].vector == pytest.approx([1, 2, 3, 4, 5, 6])
    assert moves_in("no marker") == []


# --- the control script -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("text", "offset"), [(CONTROL, 0), (UPPER, 24)])
def test_a_command_is_done_once_and_taken_back(text: str, offset: int) -> None:
    controller = new_controller()
    out = controller.registers.out_int
    _send(controller, text)
    run(controller, 0.02)
    assert out[offset] == 1
    _command(controller, 29, [0.0, 0.0, 0.2, 0.0, 0.0, 0.0], offset=offset)
    run(controller, 0.02)
    assert out[offset] == 2 and controller.arm.reference.T_flange_tcp[2, 3] == 0.2
    controller.arm.set_tcp(np.eye(4))
    run(controller, 0.1)
    assert controller.arm.reference.T_flange_tcp[2, 3] == 0.0  # not carried out again while the register holds it
    _command(controller, 0, offset=offset)
    run(controller, 0.02)
    assert out[offset] == 1


def test_progress_of_an_asynchronous_move_is_written_no_later_than_done() -> None:
    controller = new_controller()
    out = controller.registers.out_int
    _send(controller, CONTROL)
    run(controller, 0.02)
    _command(controller, 1, [0.5, *JOINTS[1:], 1.0, 1.4], [1])
    while out[0] != 2:
        controller.tick(0.002)
    running, operation = out[2] >> 15 & 1, out[2] >> 24 & 127
    assert (running, operation) == (1, 1)
    run(controller, 3.0)
    assert (out[2] >> 15 & 1, out[2] >> 24 & 127) == (0, 1)
    assert controller.arm.q[0] == pytest.approx(0.5)


def test_a_streamed_command_overwritten_within_one_step_is_still_carried_out() -> None:
    controller = new_controller()
    _send(controller, CONTROL)
    run(controller, 0.02)
    _command(controller, 10, [0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.5, 0.0])
    _command(controller, 0)
    run(controller, 0.2)
    assert controller.tool_speed[2] == pytest.approx(0.02, abs=1e-4)


def test_stop_script_ends_the_program_and_the_motion() -> None:
    controller = new_controller()
    _send(controller, CONTROL)
    run(controller, 0.02)
    _command(controller, 10, [0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 0.5, 0.0])
    run(controller, 0.2)
    _command(controller, 255)
    run(controller, 0.3)
    assert controller.runtime_state == RuntimeState.STOPPED and controller.arm.steady


def test_positions_that_are_no_numbers_end_the_script_and_move_nothing() -> None:
    for number, doubles in (
        (3, [np.nan] * 6 + [0.1, 0.5]),
        (1, [np.nan] * 6 + [0.1, 0.5]),
        (10, [np.nan] * 6 + [0.5, 0]),
    ):
        controller = new_controller()
        _send(controller, CONTROL)
        run(controller, 0.02)
        _command(controller, number, doubles, [0])
        run(controller, 0.1)
        assert controller.runtime_state == RuntimeState.STOPPED
        assert controller.arm.q == pytest.approx(JOINTS)


# --- power and safety -------------------------------------------------------------------------------------------------


def test_power_comes_back_step_by_step_and_goes_at_once() -> None:
    controller = new_controller()
    controller.power_off()
    assert controller.power.mode == PowerMode.POWER_OFF
    controller.power_up(PowerMode.IDLE)
    seen = {controller.power.mode}
    for _ in range(200):
        controller.tick(0.008)
        seen.add(controller.power.mode)
    assert seen == {PowerMode.POWER_OFF, PowerMode.POWER_ON, PowerMode.IDLE}
    controller.power_up(PowerMode.RUNNING)
    run(controller, 1.0)
    assert controller.power.mode == PowerMode.RUNNING


def test_without_power_no_script_starts() -> None:
    controller = new_controller()
    controller.power_off()
    _send(controller, FAR)
    assert controller.program is None


@pytest.mark.parametrize("pauses", [True, False])
def test_a_protective_stop_pauses_or_stops_the_program(pauses: bool) -> None:
    controller = new_controller(stop_pauses=pauses)
    _send(controller, FAR)
    run(controller, 0.4)
    controller.protective_stop()
    run(controller, 0.5)
    held = controller.arm.q.copy()
    assert controller.arm.steady and controller.safety_status_bits == 0x404
    assert controller.runtime_state == (RuntimeState.PAUSED if pauses else RuntimeState.STOPPED)
    assert not controller.unlock_protective_stop()
    run(controller, 5.0)
    assert controller.unlock_protective_stop()
    run(controller, 0.5)
    assert controller.arm.q == pytest.approx(held)
    assert controller.play() is pauses
    run(controller, 3.0)
    assert controller.arm.q[0] == pytest.approx(1.0 if pauses else held[0])


def test_stopping_the_program_before_the_unlock_forgets_the_old_motion() -> None:
    controller = new_controller()
    _send(controller, FAR)
    run(controller, 0.4)
    controller.protective_stop()
    run(controller, 5.2)
    controller.stop_program()
    held = controller.arm.q.copy()
    assert controller.unlock_protective_stop() and not controller.play()
    run(controller, 1.0)
    assert controller.arm.q == pytest.approx(held)


def test_unlocking_releases_no_other_stop() -> None:
    controller = new_controller()
    controller.emergency_stop()
    run(controller, 6.0)
    assert controller.unlock_protective_stop()
    assert controller.safety.mode == Safety.ROBOT_EMERGENCY_STOP


def test_an_emergency_stop_ends_the_program_and_needs_power_afterwards() -> None:
    controller = new_controller()
    _send(controller, FAR)
    run(controller, 0.4)
    controller.emergency_stop()
    assert controller.arm.steady and controller.power.mode == PowerMode.POWER_OFF
    assert controller.runtime_state == RuntimeState.STOPPED and controller.safety_status_bits == 0x4C0
    controller.power_up(PowerMode.RUNNING)
    run(controller, 1.0)
    assert controller.power.mode == PowerMode.POWER_OFF  # the button is still in
    controller.release_emergency_stop()
    controller.power_up(PowerMode.RUNNING)
    run(controller, 1.5)
    assert controller.power.mode == PowerMode.RUNNING and controller.safety.mode == Safety.NORMAL


def test_too_much_force_is_a_protective_stop() -> None:
    controller = new_controller()

    class Wall:
        def step(self, T_base_flange: np.ndarray, dt: float) -> np.ndarray:
            return np.array([0.0, 251.0, 0.0, 0.0, 0.0, 0.0])

    controller.arm.environment = Wall()
    controller.tick(0.008)
    assert controller.safety.mode == Safety.PROTECTIVE_STOP


def test_pause_and_play_continue_the_same_motion() -> None:
    controller = new_controller()
    _send(controller, FAR)
    run(controller, 0.4)
    assert controller.pause_program() and controller.runtime_state == RuntimeState.PAUSED
    run(controller, 1.0)
    assert controller.arm.steady and controller.play()
    run(controller, 3.0)
    assert controller.arm.q[0] == pytest.approx(1.0)
