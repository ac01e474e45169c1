"""Dashboard server, port 29999: one command in each line, one line of reply in UR's own words.

A program is a simple script file in a folder given to the mock. Installations, users, operational modes, logs, flight
reports and support files are not simulated beyond the reply.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mocks.ur.controller import Controller
from mocks.ur.sockets import Connection
from mocks.ur.state import PowerMode, RuntimeState, Safety

BANNER = "Connected: Universal Robots Dashboard Server"
_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)


class DashboardClient:
    """The server's side of one connection."""

    def __init__(self, connection: Connection, commands: DashboardCommands) -> None:
        self._connection = connection
        self._commands = commands
        self._buffer = b""
        self._say(BANNER)

    def received(self, data: bytes) -> None:
        """Bytes from the client, in whatever pieces."""
        self._buffer += data
        while b"\n" in self._buffer:
            line, self._buffer = self._buffer.split(b"\n", 1)
            text = line.decode("utf-8", "replace").strip()
            self._say(self._commands.answer(text))
            if text == "quit":
                self._connection.close()

    def closed(self) -> None:
        """Nothing is kept for a connection."""

    def _say(self, text: str) -> None:
        self._connection.send(text.encode() + b"\n")


class DashboardCommands:
    """Commands by name; some take an argument behind it."""

    def __init__(self, controller: Controller, serial_number: str, programs: Path | None = None) -> None:
        self._controller = controller
        self._serial_number = serial_number
        self._programs = programs
        self._loaded = self._script = ""
        self._role = "NONE"
        self._operational_mode = "NONE"
        self._plain: dict[str, Callable[[], str]] = {
            "play": self._play,
            "stop": self._stop,
            "pause": self._pause,
            "quit": lambda: "Disconnected",
            "shutdown": lambda: "Shutting down",
            "running": self._running,
            "robotmode": lambda: f"Robotmode: {self._controller.power.mode.name}",
            "get loaded program": lambda: f"Loaded program: {self._loaded}" if self._loaded else "No program loaded",
            "popup": lambda: "showing popup",
            "close popup": lambda: "closing popup",
            "isProgramSaved": lambda: f"true {self._name()}",
            "programState": self._program_state,
            "PolyscopeVersion": self._polyscope_version,
            "version": self._version,
            "get operational mode": lambda: self._operational_mode,
            "clear operational mode": self._clear_mode,
            "power on": self._power_on,
            "power off": self._power_off,
            "brake release": self._brake_release,
            "safetymode": lambda: f"Safetymode: {self._controller.safety.mode.name}",
            "safetystatus": lambda: f"Safetystatus: {self._controller.safety.mode.name}",
            "unlock protective stop": self._unlock,
            "close safety popup": lambda: "closing safety popup",
            "restart safety": self._restart_safety,
            "is in remote control": lambda: str(self._controller.remote).lower(),
            "getUserRole": lambda: self._role,
            "saveLog": lambda: "Log saved to disk",
            "get serial number": lambda: self._serial_number,
            "get robot model": self._model,
        }
        self._with_argument: dict[str, Callable[[str], str]] = {
            "load installation": lambda name: f"Loading installation: {name}",
            "load": self._load,
            "popup": lambda text: "showing popup",
            "addToLog": lambda text: "Added log message",
            "setUserRole": self._set_role,
            "generate flight report": lambda kind: f"Generating flight report: {kind}",
            "generate support file": lambda path: f"Generating support file: {path}",
            "set operational mode": self._set_mode,
        }

    def answer(self, line: str) -> str:
        """The reply to one line."""
        if line in self._plain:
            return self._plain[line]()
        for name, command in self._with_argument.items():
            if line.startswith(name + " "):
                return command(line[len(name) + 1 :].strip())
        return f"could not understand: '{line}'"

    # --- programs -----------------------------------------------------------------------------------------------------

    def _name(self) -> str:
        return self._controller.program_name or self._loaded or "<unnamed>"

    def _play(self) -> str:
        started = self._controller.remote and (self._controller.play() or self._start())
        return "Starting program" if started else "Failed to execute: play"

    def _start(self) -> bool:
        """Run the loaded program from its beginning."""
        if not self._script or self._controller.runtime_state != RuntimeState.STOPPED:
            return False
        return self._controller.run_script(self._script, self._loaded)

    def _stop(self) -> str:
        if not self._controller.remote:
            return "Failed to execute: stop"
        if self._controller.program is not None:
            self._controller.stop_program()
        return "Stopped"

    def _pause(self) -> str:
        paused = self._controller.remote and self._controller.pause_program()
        return "Pausing program" if paused else "Failed to execute: pause"

    def _running(self) -> str:
        return f"Program running: {str(self._controller.runtime_state == RuntimeState.PLAYING).lower()}"

    def _program_state(self) -> str:
        state = self._controller.runtime_state
        word = {RuntimeState.PLAYING: "PLAYING", RuntimeState.PAUSED: "PAUSED"}.get(state, "STOPPED")
        return f"{word} {self._name()}"

    def _load(self, name: str) -> str:
        """A program is a URScript file of the same name, with .script for .urp, in the programs folder."""
        file = None if self._programs is None else self._programs / Path(name).with_suffix(".script").name
        if file is None or not file.is_file():
            return f"File not found: {name}"
        self._controller.stop_program()
        self._loaded, self._script = name, file.read_text()
        self._controller.program_name = name
        return f"Loading program: {name}"

    # --- the robot ----------------------------------------------------------------------------------------------------

    def _version(self) -> str:
        return ".".join(str(part) for part in self._controller.version)

    def _polyscope_version(self) -> str:
        return f"URSoftware {self._version()} (Jan 01 2024)"

    def _model(self) -> str:
        return self._controller.arm.reference.kinematics.model.name.upper().removesuffix("E")

    def _set_mode(self, mode: str) -> str:
        if mode.upper() not in ("MANUAL", "AUTOMATIC"):
            return f"could not understand: 'set operational mode {mode}'"
        self._operational_mode = mode.upper()
        return f"Operational mode {self._operational_mode} is set"

    def _set_role(self, role: str) -> str:
        self._role = role.upper()
        return f"Setting user role: {role}"

    def _clear_mode(self) -> str:
        mode, self._operational_mode = self._operational_mode, "NONE"
        return f"No longer controlling the operational mode. Current operational mode: '{mode}'."

    def _power_on(self) -> str:
        self._controller.power_up(PowerMode.IDLE)
        return "Powering on"

    def _power_off(self) -> str:
        self._controller.power_off()
        return "Powering off"

    def _brake_release(self) -> str:
        self._controller.power_up(PowerMode.RUNNING)
        return "Brake releasing"

    def _unlock(self) -> str:
        return "Protective stop releasing" if self._controller.unlock_protective_stop() else _TOO_EARLY

    def _restart_safety(self) -> str:
        if self._controller.safety.mode in (Safety.FAULT, Safety.VIOLATION):
            self._controller.restart_safety()
        return "Restarting safety"
