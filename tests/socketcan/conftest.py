"""These tests need a kernel with CAN: user-mode Linux brings one (see ``run_in_uml.py``)."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip, loudly, everything in this folder on a kernel without CAN."""
    why = _why_not()
    for item in items:
        if why and Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.skip(reason=why))


def _why_not() -> str:
    if "PORTDOCK_IN_UML" not in os.environ:
        return "real SocketCAN runs in user-mode Linux only: make test-socketcan"
    try:
        socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return f"this kernel has no CAN: {error}"
    return ""
