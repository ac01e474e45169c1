"""The SCIP driver against its mock's process over a real pty, and the conversation that other people's clients hold."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import serial

from drivers.base import LinkLostError, LinkOpenError, MonotonicClock, NullSink
from drivers.scanner.scip import ScipScanner, ScipSettings
from drivers.scanner.serial_link import SerialSettings
from tests.contract.scanner_bench import mock, take, until

PROTOCOL = ("--protocol", "scip")
PATIENT = ScipSettings(answer_s=5.0, silence_s=10.0)


@contextmanager
def driver(link: Path, settings: ScipSettings = PATIENT, baud: int = 750_000) -> Iterator[ScipScanner]:
    scanner = ScipScanner(SerialSettings(str(link), baud), settings, NullSink(), MonotonicClock())
    scanner.open()
    try:
        yield scanner
    finally:
        scanner.close()


def room(profile_time_s: float) -> np.ndarray:  # type: ignore[type-arg]
    """The room that the mock makes up, by the specification's geometry, as points (x to the right, z forward)."""
    steps = np.arange(44, 726)
    dent = 384 + 100 * np.sin(0.3 * round(profile_time_s * 10))
    ranges = np.round(1500 + 400 * np.exp(-(((steps - dent) / 20) ** 2)) + 0.5 * steps) * 1e-3
    angle = np.radians((steps - 384) * 360 / 1024)
    return np.stack([-ranges * np.sin(angle), ranges * np.cos(angle)], axis=1)[10:]


def test_scans_are_the_room_at_their_time(tmp_path: Path) -> None:
    with mock(tmp_path / "dev", *PROTOCOL, "--clock-offset-s", "0"), driver(tmp_path / "dev") as scanner:
        assert scanner.geometry.model == "URG-04LX(mock)"
        assert (scanner.geometry.front_step, scanner.geometry.steps_per_turn) == (384, 1024)
        scanner.start()
        profiles = take(scanner, 3)
        scanner.stop()
        assert scanner.ask("II").status == "00"
        for profile in profiles:
            assert profile.points.shape == (672, 2)
            distance = np.linalg.norm(profile.points, axis=1)
            assert 1.5 < distance.min() < distance.max() < 2.4
        first = profiles[0]
        assert first.device_time_s is not None
        assert np.abs(first.points - room(first.device_time_s)).max() < 1e-6


@pytest.mark.parametrize(
    ("settings", "count"),
    [
        (ScipSettings(first_step=380, last_step=389, two_characters=True), 10),
        (ScipSettings(first_step=380, last_step=389, intensity=True), 10),
        (ScipSettings(first_step=100, last_step=399, cluster=3), 100),
        (ScipSettings(first_step=100, last_step=400, cluster=3, skip=1), 101),
    ],
)
def test_encodings_clusters_and_skips(tmp_path: Path, settings: ScipSettings, count: int) -> None:
    with mock(tmp_path / "dev", *PROTOCOL, "--time-scale", "4"), driver(tmp_path / "dev", settings) as scanner:
        scanner.start()
        profiles = take(scanner, 3)
        assert {len(profile.points) for profile in profiles} == {count}
        if settings.intensity:
            assert profiles[0].intensity is not None
            assert profiles[0].intensity.tolist() == [1000 + step for step in range(380, 390)]


def test_a_device_found_streaming_is_taken_over(tmp_path: Path) -> None:
    with mock(tmp_path / "dev", *PROTOCOL):
        with serial.Serial(str(tmp_path / "dev"), 750_000, timeout=5) as before:
            before.write(b"BM\nMD0044072501000\n")
            assert before.read(100)
            before.write(b"MD00")  # and left in the middle of a command
        with driver(tmp_path / "dev") as scanner:
            scanner.start()
            take(scanner, 2)


def test_the_devices_clock_is_read_and_wraps_after_24_bits(tmp_path: Path) -> None:
    offset = str((1 << 24) / 1000 - 4.0)
    options = (*PROTOCOL, "--clock-offset-s", offset, "--time-scale", "4")
    with mock(tmp_path / "dev", *options), driver(tmp_path / "dev") as scanner:
        assert 0 <= scanner.device_time_s() < (1 << 24) / 1000
        scanner.start()
        profiles = take(scanner, 20)
        times_s = np.array([profile.device_time_s for profile in profiles], float)
        assert (np.diff(times_s) > 0).all()


def test_spoiled_scans_are_dropped_and_counted(tmp_path: Path) -> None:
    faults = ("--flipped", "1e-4", "--lost", "1e-4", "--time-scale", "5")
    with mock(tmp_path / "dev", *PROTOCOL, *faults):
        scanner = ScipScanner(
            SerialSettings(str(tmp_path / "dev"), 750_000),
            ScipSettings(answer_s=1.0, attempts=10, silence_s=10.0),
            NullSink(),
            MonotonicClock(),
        )
        scanner.open()
        try:
            scanner.start()
            for profile in take(scanner, 25):
                assert np.linalg.norm(profile.points, axis=1).min() > 1.4
                assert np.linalg.norm(profile.points, axis=1).max() < 2.5
            assert dict(scanner.health().counters)["bad_checksum"] > 0
        finally:
            scanner.close()


def test_nobody_there_and_unplugging(tmp_path: Path) -> None:
    impatient = ScipSettings(answer_s=0.1, attempts=2)
    silent = pytest.raises(LinkOpenError, match="does not answer")
    with mock(tmp_path / "dev", *PROTOCOL, "--stall-at-s", "0"), silent, driver(tmp_path / "dev", impatient):
        pass
    with mock(tmp_path / "dev", *PROTOCOL) as process, driver(tmp_path / "dev") as scanner:
        scanner.start()
        take(scanner, 1)
        process.send_signal(signal.SIGUSR1)
        with pytest.raises(LinkLostError):
            until(lambda: scanner.take() is None, "never")


def test_the_conversation_of_hokuyos_own_library(tmp_path: Path) -> None:
    """A lone line feed, QT, PP, one MD scan, time stamps: as urg_library holds it, written from the specification."""
    with mock(tmp_path / "dev", *PROTOCOL), serial.Serial(str(tmp_path / "dev"), 115_200, timeout=10) as client:

        def ask(command: bytes) -> list[bytes]:
            client.write(command + b"\n")
            return client.read_until(b"\n\n").split(b"\n")

        client.write(b"\n")
        assert ask(b"QT") == [b"QT", b"00P", b"", b""]
        keys = [line.partition(b":")[0] for line in ask(b"PP")[2:-2]]
        assert keys == [b"MODL", b"DMIN", b"DMAX", b"ARES", b"AMIN", b"AMAX", b"AFRT", b"SCAN"]
        assert ask(b"BM")[1] == b"00P"
        assert ask(b"MD0044072500001")[:2] == [b"MD0044072500001", b"00P"]
        scan = client.read_until(b"\n\n").split(b"\n")
        assert scan[:2] == [b"MD0044072500000", b"99b"]
        assert sum(len(line) - 1 for line in scan[3:-2]) == 682 * 3
        assert ask(b"TM0")[1] == b"00P"
        assert len(ask(b"TM1")[2]) == 5
        assert ask(b"TM2")[1] == b"00P"
        assert ask(b"QT")[1] == b"00P"


def test_what_hokuyos_samples_want_of_each_reply(tmp_path: Path) -> None:
    """Number of lines, firmware up to its bracket, sums, endless scans with intensity that end when told, baud rate."""
    with mock(tmp_path / "dev", *PROTOCOL), serial.Serial(str(tmp_path / "dev"), 115_200, timeout=10) as client:

        def reply() -> list[bytes]:
            lines = client.read_until(b"\n\n").split(b"\n")[:-2]
            for line in lines[1:]:
                content = line[:-1]
                sums = {(sum(part) & 0x3F) + 0x30 for part in (content, content.removesuffix(b";"))}
                assert line[-1] in sums, line
            return lines

        def ask(command: bytes) -> list[bytes]:
            client.write(command + b"\n")
            return reply()

        assert [len(ask(command)) for command in (b"VV", b"PP", b"II")] == [7, 10, 9]
        firmware = next(line for line in ask(b"VV") if line.startswith(b"FIRM:"))
        assert firmware.removeprefix(b"FIRM:").partition(b"(")[1]
        assert ask(b"TM0")[1] == b"00P"
        assert ask(b"QT")[1] == b"00P", "it may be found adjusting its clock"
        assert ask(b"SS115200")[1] == b"03S", "already so"
        assert ask(b"ME0380038901000")[1] == b"00P"
        stamps = []
        for _ in range(3):
            echo, status, stamp, data = reply()
            assert (echo, status, len(stamp), len(data)) == (b"ME0380038901000", b"99b", 5, 10 * 6 + 1)
            stamps.append(stamp[:4])
        assert stamps == sorted(set(stamps))
        client.write(b"QT\n")
        last = reply()
        while last[0] != b"QT":  # scans that were on their way
            last = reply()
        assert last == [b"QT", b"00P"]
        client.timeout = 0.3
        assert client.read(1) == b""
