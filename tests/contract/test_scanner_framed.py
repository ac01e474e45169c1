"""The framed driver against the mock scanner's process, over a real pty behind a symlink."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import serial

from controller.scanner_files import load_scanner
from drivers.base import LinkLostError, LinkOpenError, MonotonicClock, NullSink
from drivers.scanner.framed import FramedScanner, FramedTimeouts
from drivers.scanner.serial_link import SerialSettings
from tests.contract.scanner_bench import mock, take, until


@contextmanager
def driver(link: Path, **options: object) -> Iterator[FramedScanner]:
    description = load_scanner("wide_xz")
    sink = options.pop("sink", NullSink())
    timeouts = FramedTimeouts(ack_s=2.0, silence_s=5.0)
    settings = SerialSettings(str(link), int(str(options.pop("baud", description.baud_rate))))
    scanner = FramedScanner(settings, description.layout, sink, MonotonicClock(), timeouts)  # type: ignore[arg-type]
    scanner.open()
    try:
        yield scanner
    finally:
        scanner.close()


def groove(number: int) -> np.ndarray:  # type: ignore[type-arg]
    """The mock's made-up picture, written down once more."""
    x = np.linspace(-0.08, 0.08, 1000)
    z = 0.4 + 0.02 * np.exp(-(((x - 0.05 * np.sin(0.05 * number)) / 0.01) ** 2))
    return np.stack([x, z], axis=1)[np.abs(x) <= 0.078]


def counts(scanner: FramedScanner) -> dict[str, int]:
    return dict(scanner.health().counters)


def test_profiles_arrive_as_they_were_measured_in_order_and_complete(tmp_path: Path) -> None:
    with mock(tmp_path / "dev"), driver(tmp_path / "dev") as scanner:
        assert scanner.take() == []
        scanner.start()
        profiles = take(scanner, 30)
        scanner.stop()
        profiles += scanner.take()
        assert [profile.sequence for profile in profiles] == list(range(len(profiles)))
        for profile in profiles:
            assert np.abs(profile.points - groove(profile.sequence)).max() <= 5.01e-6
        device_s = np.array([profile.device_time_s for profile in profiles])
        np.testing.assert_allclose(np.diff(device_s), 1 / 70, atol=2e-6)
        assert counts(scanner)["bytes_dropped"] == counts(scanner)["lost"] == 0
        assert scanner.health().up


def test_the_laser_obeys_and_starts_again(tmp_path: Path) -> None:
    with mock(tmp_path / "dev"), driver(tmp_path / "dev") as scanner:
        for _ in range(3):
            scanner.start()
            take(scanner, 3)
            scanner.stop()
            received = counts(scanner)["bytes"]
            scanner.stop()
            scanner.take()
            time.sleep(0.05)  # four periods: any further frame would show
            assert counts(scanner)["bytes"] == received


def test_the_recorder_gets_every_byte_as_it_was_read(tmp_path: Path) -> None:
    class Sink(NullSink):
        def __init__(self) -> None:
            self.rx, self.tx = b"", b""

        def scanner_bytes(self, direction: str, data: bytes, host_time_ns: int) -> None:
            if direction == "rx":
                self.rx += data
            else:
                self.tx += data

    sink = Sink()
    with mock(tmp_path / "dev"), driver(tmp_path / "dev", sink=sink) as scanner:
        scanner.start()
        take(scanner, 3)
        scanner.stop()
        assert len(sink.rx) == counts(scanner)["bytes"]
        assert sink.tx == b"L1\r\nL0\r\n"
        assert sink.rx.startswith(b"OK L1\r\n\xa5\x5a\xc3\x3c\xe8\x03")
        assert sink.rx.endswith(b"OK L0\r\n")


def test_the_line_is_paced_at_the_clients_baud_rate(tmp_path: Path) -> None:
    """At 460,800 baud a frame takes 87 ms: the device makes 70 a second, the line carries 11, the rest is missing."""
    with mock(tmp_path / "dev"), driver(tmp_path / "dev", baud=460_800) as scanner:
        scanner.start()
        began_s = time.monotonic()
        profiles = take(scanner, 6)
        assert 10 * len(profiles) * 4020 / (time.monotonic() - began_s) < 1.2 * 460_800
        assert profiles[-1].sequence > len(profiles)
        assert counts(scanner)["bytes_dropped"] == 0


def test_a_client_at_another_baud_rate_gets_garbage_and_says_so(tmp_path: Path) -> None:
    with mock(tmp_path / "dev", "--baud", "3000000"), driver(tmp_path / "dev", baud=921_600) as scanner:
        scanner._timeouts = FramedTimeouts(ack_s=0.2)
        with pytest.raises(LinkLostError, match="does not acknowledge") as caught:
            scanner.start()
        assert "baud" in caught.value.remedy


def test_lost_doubled_and_flipped_bytes_cost_profiles_but_never_spoil_one(tmp_path: Path) -> None:
    faults = ("--lost", "2e-5", "--doubled", "2e-5", "--flipped", "2e-5", "--time-scale", "3")
    with mock(tmp_path / "dev", *faults), driver(tmp_path / "dev") as scanner:
        scanner.start()
        profiles = take(scanner, 80)
        for profile in profiles:
            assert np.abs(profile.points - groove(profile.sequence)).max() <= 5.01e-6
        seen = counts(scanner)
        assert seen["lost"] > 0
        assert seen["bytes_dropped"] > 0
        assert seen["bad_checksum"] > 0


def test_silence_while_the_laser_is_on_is_a_lost_link(tmp_path: Path) -> None:
    with mock(tmp_path / "dev") as process, driver(tmp_path / "dev") as scanner:
        scanner.start()
        take(scanner, 3)
        scanner._timeouts = FramedTimeouts(ack_s=0.1, silence_s=0.5)
        process.send_signal(signal.SIGSTOP)
        try:
            with pytest.raises(LinkLostError, match="no valid profile"):
                until(lambda: scanner.take() is None, "never")
            assert not scanner.health().up
        finally:
            process.send_signal(signal.SIGCONT)


def test_an_acknowledgement_that_comes_after_it_was_given_up_is_counted_as_late(tmp_path: Path) -> None:
    with mock(tmp_path / "dev") as process, driver(tmp_path / "dev") as scanner:
        scanner._timeouts = FramedTimeouts(ack_s=0.05, attempts=1)
        process.send_signal(signal.SIGSTOP)
        with pytest.raises(LinkLostError, match="does not acknowledge"):
            scanner.start()
        process.send_signal(signal.SIGCONT)
        until(lambda: counts(scanner)["bytes"] > 0, "the late answer")
        scanner._timeouts = FramedTimeouts(ack_s=5.0)
        scanner.start()
        assert counts(scanner)["late"] == 1
        assert take(scanner, 3)


def test_unplugging_is_noticed_and_replugging_under_another_name_works(tmp_path: Path) -> None:
    with mock(tmp_path / "dev") as process, driver(tmp_path / "dev") as scanner:
        scanner.start()
        take(scanner, 3)
        before = os.readlink(tmp_path / "dev")
        process.send_signal(signal.SIGUSR1)
        began_s = time.monotonic()
        with pytest.raises(LinkLostError) as caught:
            until(lambda: scanner.take() is None, "never")
        assert time.monotonic() - began_s < 5.0
        assert caught.value.remedy
        assert not scanner.health().up
        with pytest.raises(LinkLostError):
            scanner.start()
        scanner.close()
        with pytest.raises(LinkOpenError, match="no serial device"):
            scanner.open()
        process.send_signal(signal.SIGUSR2)
        until((tmp_path / "dev").exists, "the device is back")
        assert os.readlink(tmp_path / "dev") != before
        scanner.open()
        scanner.start()
        assert len(take(scanner, 3)) >= 3


def test_a_client_that_does_not_read_loses_whole_profiles_and_recovers(tmp_path: Path) -> None:
    options = ("--buffer-bytes", "8192", "--time-scale", "4")
    with mock(tmp_path / "dev", *options):
        with serial.Serial(str(tmp_path / "dev"), 3_000_000, timeout=5, exclusive=True) as lazy:
            lazy.write(b"L1\r\n")
            time.sleep(0.5)  # two emulated seconds unread: far more than pty and buffer hold
        with driver(tmp_path / "dev") as scanner:
            scanner.start()
            profiles = take(scanner, 5)
            for profile in profiles:
                assert np.abs(profile.points - groove(profile.sequence)).max() <= 5.01e-6


def test_a_device_that_is_taken_is_refused(tmp_path: Path) -> None:
    dev = tmp_path / "dev"
    with mock(dev), driver(dev), pytest.raises(LinkOpenError, match="in use") as caught, driver(dev):
        pass
    assert "fuser" in caught.value.remedy


def test_no_such_device_a_plain_file_and_no_permission_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(LinkOpenError, match="no serial device"), driver(tmp_path / "missing"):
        pass
    (tmp_path / "file").write_text("not a tty")
    with pytest.raises(LinkOpenError, match="cannot be opened"), driver(tmp_path / "file"):
        pass
    if os.geteuid() != 0:
        (tmp_path / "file").chmod(0)
        with pytest.raises(LinkOpenError, match="permission"), driver(tmp_path / "file"):
            pass


def test_the_mock_removes_its_symlink_when_it_ends(tmp_path: Path) -> None:
    with mock(tmp_path / "dev"):
        assert (tmp_path / "dev").is_symlink()
    assert not (tmp_path / "dev").is_symlink()


def test_a_recorded_sweep_is_played_from_its_first_profile_after_each_laser_on(tmp_path: Path) -> None:
    x = np.tile(np.linspace(-0.05, 0.05, 200), (7, 1))
    z = 0.3 + 0.001 * np.arange(7)[:, None] + np.zeros((7, 200))
    z[:, 0] = np.nan
    np.savez(tmp_path / "sweep.npz", profile_x_m=x, profile_z_m=z)
    with mock(tmp_path / "dev", "--source", str(tmp_path / "sweep.npz")), driver(tmp_path / "dev") as scanner:
        for _ in range(2):
            scanner.start()
            profiles = take(scanner, 9)
            scanner.stop()
            scanner.take()
            assert [len(profile.points) for profile in profiles[:9]] == [199] * 9
            depths = [round(float(profile.points[0, 1]) * 1e3) for profile in profiles[:9]]
            assert depths == [300, 301, 302, 303, 304, 305, 306, 300, 301]


def test_a_laser_that_a_pulled_cable_left_on_is_off_once_the_line_is_open_again(tmp_path: Path) -> None:
    with mock(tmp_path / "dev") as process, driver(tmp_path / "dev") as scanner:
        scanner.start()
        take(scanner, 3)
        process.send_signal(signal.SIGUSR1)
        until(lambda: scanner._link.lost, "the cable is out")
        for _ in range(2):  # at the end of the sweep, and once more when everything is made safe
            with pytest.raises(LinkLostError):
                scanner.stop()
        scanner.close()
        process.send_signal(signal.SIGUSR2)
        until((tmp_path / "dev").exists, "the device is back")
        scanner.open()
        received = counts(scanner)["bytes"]
        time.sleep(0.05)  # four periods: any further frame would show
        assert counts(scanner)["bytes"] == received
        scanner.stop()  # nothing is left to do
        assert counts(scanner)["bytes"] == received


def test_a_laser_that_a_killed_process_left_on_is_off_once_the_next_one_has_opened_the_line(tmp_path: Path) -> None:
    with mock(tmp_path / "dev"):
        with driver(tmp_path / "dev") as killed:
            killed.start()
            take(killed, 3)
            killed._link.close()  # without a word to the device
        with driver(tmp_path / "dev") as scanner:
            received = counts(scanner)["bytes"]
            time.sleep(0.05)  # four periods: any further frame would show
            assert counts(scanner)["bytes"] == received > 0
            scanner.start()
            assert len(take(scanner, 3)) >= 3
