"""The SCIP mock before a client that nobody here wrote: ``hokuyolx``, which speaks TCP, through a bridge to the pty.

Hokuyo's own urg_library is in no package registry; the conversation that it holds is in ``test_scanner_scip.py`` as
bytes. ``hokuyolx`` checks every sum itself and raises for what it does not understand.
"""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial

from tests.contract.scanner_bench import mock

hokuyolx = pytest.importorskip("hokuyolx", reason="pip install hokuyolx: an independent SCIP client")


@contextmanager
def bridge(port: serial.Serial) -> Iterator[tuple[str, int]]:
    """A TCP address behind which the serial line is."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def carry() -> None:
            connection, _ = server.accept()
            with connection:
                while True:
                    ready, _, _ = select.select([connection, port], [], [])
                    if connection in ready:
                        if not (data := connection.recv(4096)):
                            return
                        port.write(data)
                    if port in ready:
                        connection.sendall(port.read(65536))

        thread = threading.Thread(target=carry, daemon=True)
        thread.start()
        yield server.getsockname()
    thread.join(5.0)


class OneReplyAtATime:
    """hokuyolx takes all that one ``recv`` gives for one reply, and drops what came along with it on a busy machine."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._rest = b""

    def recv(self, size: int) -> bytes:
        while b"\n\n" not in self._rest:
            chunk = self._connection.recv(size)
            if not chunk:
                raise ConnectionError("the bridge is closed")
            self._rest += chunk
        reply, end, self._rest = self._rest.partition(b"\n\n")
        return reply + end

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)


@pytest.fixture
def laser(tmp_path: Path) -> Iterator[Any]:
    with (
        mock(tmp_path / "dev", "--protocol", "scip"),
        serial.Serial(str(tmp_path / "dev"), 750_000, timeout=0) as port,
        bridge(port) as address,
    ):
        client = hokuyolx.HokuyoLX(addr=address, time_tolerance=60_000, timeout=20)  # TM0..2, PP, BM on the way
        client._sock = OneReplyAtATime(client._sock)
        yield client
        client.close()


def test_parameters_state_and_version(laser: Any) -> None:
    assert (laser.dmin, laser.dmax, laser.ares, laser.amin, laser.amax, laser.aforw) == (20, 5600, 1024, 44, 725, 384)
    assert laser.scan_freq == 10
    assert laser.sensor_state()["LASR"] == "ON"
    laser.standby()
    assert laser.laser_state() == (0, "Standby state")
    assert laser.activate()[0] == 0
    assert laser.laser_state() == (3, "Single scan state")


def test_single_scans_with_grouping_and_intensity(laser: Any) -> None:
    _, ranges = laser.get_dist()
    assert ranges.shape == (682,)
    assert ranges[:10].tolist() == [7] * 10
    assert 1500 < ranges[10:].min() < ranges.max() < 2400
    _, grouped = laser.get_dist(start=380, end=389, grouping=2)
    assert grouped.shape == (5,)
    _, both = laser.get_intens()
    assert both.shape == (682, 2)
    np.testing.assert_array_equal(both[:, 1], 1000 + np.arange(44, 726))


def test_streamed_scans_count_down_and_carry_growing_times(laser: Any) -> None:
    scans = list(laser.iter_dist(scans=3))
    assert [left for _, _, left in scans] == [2, 1, 0]
    assert np.all(np.diff([stamp for _, stamp, _ in scans]) > 50)
    with_intensity = list(laser.iter_intens(scans=2, start=380, end=389, skips=1))
    assert [scan.shape for scan, _, _ in with_intensity] == [(10, 2)] * 2


def test_reset_puts_it_on_standby(laser: Any) -> None:
    laser.reset()
    assert laser.laser_state()[0] == 0
