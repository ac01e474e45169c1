"""The Profiler 2 driver against its mock's process: questions and answers over a real pty."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from drivers.base import LinkLostError, MonotonicClock, NullSink
from drivers.scanner.profiler2 import Profiler2, Profiler2Settings
from drivers.scanner.serial_link import SerialSettings
from tests.contract.scanner_bench import mock, take, until

PROTOCOL = ("--protocol", "profiler2")


@contextmanager
def driver(link: Path, settings: Profiler2Settings | None = None, baud: int = 921_600) -> Iterator[Profiler2]:
    settings = settings or Profiler2Settings(silence_s=10.0)
    scanner = Profiler2(SerialSettings(str(link), baud), settings, NullSink(), MonotonicClock())
    scanner.open()
    try:
        yield scanner
    finally:
        scanner.close()


def groove(number: int) -> np.ndarray:  # type: ignore[type-arg]
    """The mock's made-up picture at 200 profiles a second, written down once more."""
    x = np.linspace(-0.015, 0.015, 832)
    z = 0.1 + 0.00375 * np.exp(-(((x - 0.009375 * np.sin(0.05 * number)) / 0.001875) ** 2))
    return np.stack([x, z], axis=1)[np.abs(x) <= 0.975 * 0.015]


@pytest.mark.parametrize("in_words", [False, True])
def test_profiles_are_what_was_measured_at_their_device_time(tmp_path: Path, in_words: bool) -> None:
    options = ("--address-in-words",) if in_words else ()
    settings = Profiler2Settings(silence_s=10.0, address_in_words=in_words)
    with mock(tmp_path / "dev", *PROTOCOL, *options), driver(tmp_path / "dev", settings) as scanner:
        scanner.start()
        profiles = take(scanner, 5)
        scanner.stop()
        for profile in profiles:
            assert profile.device_time_s is not None
            number = round(profile.device_time_s * 200)
            assert np.abs(profile.points - groove(number)).max() <= 0.51e-6
            assert profile.quality == pytest.approx(811 / 832, abs=0.003)
        times_s = np.array([profile.device_time_s for profile in profiles], float)
        assert (np.diff(times_s) > 0).all()
        assert dict(scanner.health().counters)["lost"] == 0


def test_thinning_reads_each_fourth_point_only(tmp_path: Path) -> None:
    settings = Profiler2Settings(silence_s=10.0, thinning=4)
    with mock(tmp_path / "dev", *PROTOCOL), driver(tmp_path / "dev", settings) as scanner:
        scanner.start()
        profile = take(scanner, 1)[0]
        assert profile.device_time_s is not None
        expected = groove(round(profile.device_time_s * 200))
        spacing = np.diff(profile.points[:, 0])
        np.testing.assert_allclose(spacing, 4 * 0.030 / 831, atol=1.1e-6)
        assert len(profile.points) == pytest.approx(len(expected) / 4, abs=1)


def test_lost_and_flipped_bytes_are_asked_for_again(tmp_path: Path) -> None:
    faults = ("--lost", "2e-4", "--flipped", "2e-4", "--time-scale", "4")
    settings = Profiler2Settings(answer_s=0.1, attempts=4, silence_s=10.0)
    with mock(tmp_path / "dev", *PROTOCOL, *faults), driver(tmp_path / "dev", settings) as scanner:
        scanner.start()
        profiles = take(scanner, 8)
        for profile in profiles:
            inside = np.abs(profile.points[:, 1] - 0.1) < 0.004
            assert inside.all()
        seen = dict(scanner.health().counters)
        assert seen["timeouts"] > 0
        assert seen["bytes_dropped"] > 0


def test_a_device_that_does_not_speak_is_a_lost_link(tmp_path: Path) -> None:
    settings = Profiler2Settings(answer_s=0.1, attempts=2)
    dev = tmp_path / "dev"
    silent = pytest.raises(LinkLostError, match="does not answer")
    with mock(dev, *PROTOCOL, "--stall-at-s", "0"), driver(dev, settings) as scanner, silent:
        scanner.start()


def test_falling_silent_and_unplugging_are_noticed(tmp_path: Path) -> None:
    settings = Profiler2Settings(answer_s=0.5, silence_s=2.0)
    with mock(tmp_path / "dev", *PROTOCOL) as process, driver(tmp_path / "dev", settings) as scanner:
        scanner.start()
        take(scanner, 2)
        process.send_signal(signal.SIGUSR1)
        with pytest.raises(LinkLostError):
            until(lambda: scanner.take() is None, "never")
        assert not scanner.health().up
