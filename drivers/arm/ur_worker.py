"""The process that owns ur_rtde's control link, and nothing else.

The client library can take its whole process down when the robot's link drops, waits for minutes inside a call, and
starts to reconnect on its own; so it lives here and the parent survives it. This process decides nothing: it executes
one command at a time, and stops the arm and ends when the parent is gone.
"""

from __future__ import annotations

import os
import socket
import sys
from multiprocessing.connection import Connection
from typing import Any

from drivers.arm import messages as m
from drivers.arm.control_loop import ControlLoop
from drivers.arm.worker_link import Link

RTDE_PORT = 30004


def open_control(start: m.Start) -> Any:
    """ur_rtde's control interface with its script running, TCP and payload set."""
    from rtde_control import RTDEControlInterface  # here, so that this module's logic can be tested without it

    flags = RTDEControlInterface.FLAG_UPLOAD_SCRIPT
    if start.upper_registers:
        # Recipe 23 shares external_force_torque with the lower range's client: leave it out.
        flags = flags | RTDEControlInterface.FLAG_UPPER_RANGE_REGISTERS | RTDEControlInterface.FLAG_NO_EXT_FT
    control = RTDEControlInterface(start.host, start.frequency_hz, int(flags))
    if not control.setPayload(start.payload_kg, list(start.centre_of_gravity_m)):
        raise RuntimeError("the controller did not take the payload")
    if not control.setTcp(list(start.tcp)):
        raise RuntimeError("the controller did not take the TCP")
    return control


class OwnSocket:
    """The very socket of the control link, to notice when the library has given it up.

    It reconnects by itself from a thread of its own, uploads the script anew, without a watchdog, and often crashes.
    """

    def __init__(self) -> None:
        """Find it among this process's open files. Raises RuntimeError."""
        for entry in os.listdir("/proc/self/fd"):
            if self._peer_port(int(entry)) == RTDE_PORT:
                self._fd = int(entry)
                self._inode = os.fstat(self._fd).st_ino
                return
        raise RuntimeError("the control link closed while it was opened")

    def same(self) -> bool:
        """Whether the link still runs over it."""
        try:
            return os.fstat(self._fd).st_ino == self._inode
        except OSError:
            return False

    @staticmethod
    def _peer_port(fd: int) -> int | None:
        try:
            with socket.fromfd(fd, socket.AF_INET, socket.SOCK_STREAM) as copy:
                return int(copy.getpeername()[1])
        except (OSError, IndexError):
            return None


def serve(connection: Connection) -> None:
    """The worker's life: start, serve, end."""
    link = Link(connection)
    start: m.Start = link.receive()
    link.start_beat()
    try:
        control = open_control(start)
        link.guard(OwnSocket().same)
        link.send(m.Started(tuple(control.getTCPOffset())))
    except Exception as error:  # whatever the library raises belongs to the parent
        link.send(m.StartFailed(str(error)))
        return
    loop = ControlLoop(link, control, start.frequency_hz, start.watchdog_hz)
    try:
        loop.run()
    except EOFError:  # the parent is gone
        loop.leave()
    except Exception as error:  # a lost link, and whatever the library raises when it notices that
        link.send(m.Ended(str(error) or type(error).__name__))


def main() -> None:
    """Entry point of the process: the socket's file descriptor is the only argument."""
    try:
        serve(Connection(int(sys.argv[1])))
    finally:
        sys.stderr.flush()
        os._exit(0)  # ur_rtde's destructor would wait, reconnect or crash


if __name__ == "__main__":
    main()
