"""Where the daemon's files are: socket, lock, memory. Under systemd in its folders, else in the user's."""

from __future__ import annotations

import os
import re
from pathlib import Path

from controller.service_config import ServiceConfig

SOCKET_NAME = "portdock.sock"
SYSTEM_SOCKET = Path("/run/portdock") / SOCKET_NAME
SOCKET_VARIABLE = "PORTDOCK_SOCKET"


def socket_of_daemon(service: ServiceConfig) -> Path:
    """Where a daemon listens."""
    if service.socket is not None:
        return Path(service.socket)
    runtime = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return (Path(runtime) if runtime else _user_runtime()) / SOCKET_NAME


def socket_for_client(given: Path | None) -> Path:
    """Where a client looks for the daemon: as told, as the environment says, the system's service, the user's."""
    if given is not None:
        return given
    if named := os.environ.get(SOCKET_VARIABLE):
        return Path(named)
    return SYSTEM_SOCKET if SYSTEM_SOCKET.exists() else _user_runtime() / SOCKET_NAME


def state_folder(service: ServiceConfig, robot: str) -> Path:
    """Where one robot's memory lies; the same for every daemon of this user, wherever it was started."""
    under_systemd = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    base = service.state_folder or under_systemd or Path.home() / ".local" / "state" / "portdock"
    return Path(base) / (re.sub(r"[^A-Za-z0-9.-]", "_", robot) or "robot")


def _user_runtime() -> Path:
    folder = os.environ.get("XDG_RUNTIME_DIR")
    return Path(folder) / "portdock" if folder else Path("/tmp") / f"portdock-{os.getuid()}"
