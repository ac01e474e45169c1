"""The controller's dashboard server: what RTDE cannot tell, and a way to stop a program that needs no control link.

A connection for each use: the server drops idle clients and forgets them at mode switches. Nothing here powers on,
releases brakes, plays a program or unlocks a protective stop: those are an operator's.
"""

from __future__ import annotations

import re
import socket

from drivers.base import LinkLostError, ProtocolError

PORT = 29999
BANNER = "Connected"


class Dashboard:
    """A short conversation with the dashboard server; use as a context manager."""

    def __init__(self, host: str, timeout_s: float = 1.0) -> None:
        """Raises LinkLostError if nothing answers."""
        try:
            self._socket = socket.create_connection((host, PORT), timeout_s)
        except OSError as error:
            raise LinkLostError(f"no dashboard server answers at {host}:{PORT} ({error})") from error
        self._stream = self._socket.makefile("rw", encoding="utf-8", errors="replace", newline="\n")
        if not self._line().startswith(BANNER):
            self.close()
            raise ProtocolError(f"what answers at {host}:{PORT} is not a robot's dashboard server")

    def __enter__(self) -> Dashboard:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the conversation."""
        self._stream.close()
        self._socket.close()

    def ask(self, command: str) -> str:
        """The reply to one command. Raises LinkLostError."""
        try:
            self._stream.write(command + "\n")
            self._stream.flush()
        except OSError as error:
            raise LinkLostError(f"the dashboard server went away ({error})") from error
        return self._line()

    def _line(self) -> str:
        try:
            line = self._stream.readline()
        except OSError as error:
            raise LinkLostError(f"the dashboard server does not answer ({error})") from error
        if not line.endswith("\n"):
            raise LinkLostError("the dashboard server closed the connection")
        return line.strip()

    def remote_control(self) -> bool:
        """Whether programs from the network are obeyed."""
        return self.ask("is in remote control").lower() == "true"

    def model(self) -> str:
        """Such as UR10."""
        return self.ask("get robot model")

    def serial(self) -> str:
        """Serial number, digits."""
        return self.ask("get serial number")

    def robot_mode(self) -> str:
        """Such as RUNNING, IDLE, POWER_OFF."""
        return self._value(self.ask("robotmode"))

    def safety_status(self) -> str:
        """Such as NORMAL, PROTECTIVE_STOP, ROBOT_EMERGENCY_STOP."""
        return self._value(self.ask("safetystatus"))

    def program_running(self) -> bool:
        """Whether any program is running."""
        return self._value(self.ask("running")).lower() == "true"

    def stop(self) -> None:
        """Stop the program, which stops the arm. Raises ProtocolError if the server refuses."""
        reply = self.ask("stop")
        if reply != "Stopped":
            raise ProtocolError(f"the dashboard server did not stop the program: {reply}")

    @staticmethod
    def _value(reply: str) -> str:
        match = re.fullmatch(r"[^:]+:\s*(\S.*)", reply)
        if match is None:
            raise ProtocolError(f"unexpected reply of the dashboard server: {reply}")
        return match.group(1)
