"""A recorded conversation is played back byte for byte, and a client that says something else is found out."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import serial

from controller.recording.reader import read_recording
from controller.recording.recorder import Recorder
from controller.scanner_files import load_scanner
from drivers.base import ByteSink, LinkOpenError, MonotonicClock, NullSink, Scanner
from drivers.playback import Playback
from drivers.scanner.framed import FramedScanner, FramedTimeouts
from drivers.scanner.played_line import Dialogue, PlayedLine
from drivers.scanner.played_scanners import PlayedProfiler2, PlayedScanner, PlayedScip, Taken
from drivers.scanner.profiler2 import Profiler2, Profiler2Settings
from drivers.scanner.scip import ScipScanner, ScipSettings
from drivers.scanner.serial_link import SerialSettings
from perception.scan import Profile
from tests.contract.scanner_bench import mock, take, until


def framed(link: Path, sink: ByteSink, name: str = "wide_xz") -> Scanner:
    description = load_scanner(name)
    settings = SerialSettings(str(link), description.baud_rate)
    return FramedScanner(settings, description.layout, sink, MonotonicClock(), FramedTimeouts(5.0, 3, 10.0))


def profiler2(link: Path, sink: ByteSink) -> Scanner:
    settings = Profiler2Settings(thinning=8, answer_s=5.0, silence_s=10.0)
    return Profiler2(SerialSettings(str(link), 921_600), settings, sink, MonotonicClock())


def scip(link: Path, sink: ByteSink) -> Scanner:
    settings = ScipSettings(answer_s=5.0, silence_s=10.0)
    return ScipScanner(SerialSettings(str(link), 750_000), settings, sink, MonotonicClock())


def swept(scanner: Scanner, count: int) -> list[Profile]:
    scanner.open()
    try:
        scanner.start()
        profiles = take(scanner, count)
        scanner.stop()
        return (profiles + scanner.take())[:count]
    finally:
        scanner.close()


def recorded(scanner: Scanner, recorder: Recorder, count: int) -> list[Profile]:
    try:
        return swept(scanner, count)
    finally:
        recorder.close()


def test_a_streaming_scanners_bytes_come_again_as_they_were(tmp_path: Path) -> None:
    file, dev = tmp_path / "sweep.mcap", tmp_path / "dev"
    recorder = Recorder(file, MonotonicClock())
    with mock(dev):
        first = recorded(framed(dev, recorder), recorder, 10)
    again = Recorder(tmp_path / "again.mcap", MonotonicClock())
    with mock(dev, "--recording", str(file)) as process:
        second = recorded(framed(dev, again), again, 10)
        process.terminate()
        assert process.wait(10) == 0
    rx = [b"".join(c.data for c in read_recording(p).scanner_chunks("rx")) for p in (file, tmp_path / "again.mcap")]
    assert rx[1] == rx[0]
    for a, b in zip(first, second, strict=True):
        assert (a.sequence, a.device_time_s) == (b.sequence, b.device_time_s)
        np.testing.assert_array_equal(a.points, b.points)


@pytest.mark.parametrize(("protocol", "scanner"), [("profiler2", profiler2), ("scip", scip)])
def test_a_device_that_is_asked_answers_the_recorded_questions(
    tmp_path: Path, protocol: str, scanner: Callable[[Path, ByteSink], Scanner]
) -> None:
    """Taken over from an unknown state, read, and left, as recorded."""
    file, dev = tmp_path / "sweep.mcap", tmp_path / "dev"
    recorder = Recorder(file, MonotonicClock())
    with mock(dev, "--protocol", protocol):
        first = recorded(scanner(dev, recorder), recorder, 4)
    with mock(dev, "--recording", str(file)) as process:
        second = swept(scanner(dev, NullSink()), 4)
        process.terminate()
        assert process.wait(10) == 0
    for a, b in zip(first, second, strict=True):
        assert a.device_time_s == b.device_time_s
        np.testing.assert_array_equal(a.points, b.points)


def dialogue_of(file: Path) -> Dialogue:
    recording = read_recording(file)
    rx, tx = ([(c.host_time_ns, c.data) for c in recording.scanner_chunks(side)] for side in ("rx", "tx"))  # type: ignore[arg-type]
    return Dialogue("tx", rx, tx)


def played_framed(dialogue: Dialogue, playback: Playback, taken: Taken) -> Scanner:
    line = partial(PlayedLine, playback=playback, dialogue=dialogue)
    layout = load_scanner("wide_xz").layout
    return FramedScanner(SerialSettings("", 3_000_000), layout, NullSink(), playback, connect=line)


def played_profiler2(dialogue: Dialogue, playback: Playback, taken: Taken) -> Scanner:
    return PlayedProfiler2(SerialSettings("", 921_600), Profiler2Settings(thinning=8), playback, dialogue, taken)


def played_scip(dialogue: Dialogue, playback: Playback, taken: Taken) -> Scanner:
    return PlayedScip(SerialSettings("", 750_000), ScipSettings(), NullSink(), playback, dialogue)


@pytest.mark.parametrize(
    ("protocol", "scanner", "played"),
    [("framed", framed, played_framed), ("profiler2", profiler2, played_profiler2), ("scip", scip, played_scip)],
)
def test_in_recorded_time_the_driver_gives_each_profile_when_it_came(
    tmp_path: Path,
    protocol: str,
    scanner: Callable[[Path, ByteSink], Scanner],
    played: Callable[[Dialogue, Playback, Taken], Scanner],
) -> None:
    """Two sweeps; the played driver is opened late, as for a mission whose recording begins with its job."""
    file, dev, clock = tmp_path / "sweep.mcap", tmp_path / "dev", MonotonicClock()
    recorder, sweeps, asked_to_stop_s, over_s = Recorder(file, clock), [], [], []
    with mock(dev, "--protocol", protocol):
        live = scanner(dev, recorder)
        live.open()
        opened_s = clock.now_s()
        for _ in range(2):
            live.start()
            profiles = take(live, 4)
            asked_to_stop_s.append(clock.now_s())
            live.stop()
            sweeps.append(profiles + live.take())
            over_s.append(clock.now_s())
        live.close()
    recorder.close()
    playback = Playback(opened_s)
    taken = [(time_s, len(profiles)) for time_s, profiles in zip(over_s, sweeps, strict=True)]
    again = PlayedScanner(played(dialogue_of(file), playback, taken), playback, taken)
    again.open()
    assert again.health().up
    for profiles, stop_s, end_s in zip(sweeps, asked_to_stop_s, over_s, strict=True):
        again.start()
        early = again.take()
        assert all(profile.time_s <= playback.now_s() for profile in early)
        playback.run_until(stop_s)
        again.stop()
        playback.run_until(end_s)
        late = again.take()
        for a, b in zip(profiles, early + late, strict=True):
            assert (a.time_s, a.device_time_s) == (b.time_s, b.device_time_s)
            np.testing.assert_array_equal(a.points, b.points)


def test_a_range_finder_whose_parameters_were_not_recorded_is_refused_by_name() -> None:
    playback = Playback(0.0)
    with pytest.raises(LinkOpenError, match="PP") as refused:
        played_scip(Dialogue("tx", [(1, b"QT\n00P\n\n")], ()), playback, ()).open()
    assert "replay" in refused.value.remedy


def test_a_client_that_says_something_else_ends_the_replay_with_exit_code_1(tmp_path: Path) -> None:
    file, dev = tmp_path / "sweep.mcap", tmp_path / "dev"
    recorder = Recorder(file, MonotonicClock())
    with mock(dev):
        recorded(framed(dev, recorder), recorder, 2)
    with mock(dev, "--recording", str(file)) as process:
        with serial.Serial(str(dev), 3_000_000, timeout=0.2) as other:
            other.write(b"L7\r\n")
            until(lambda: other.out_waiting == 0, "the question is taken")
            assert other.read(100) == b""
        process.terminate()
        assert process.wait(10) == 1


def test_an_ld19_streams_by_itself_and_is_read_by_its_description(tmp_path: Path) -> None:
    with mock(tmp_path / "dev", "--preset", "ld19"):
        scanner = framed(tmp_path / "dev", NullSink(), "ld19")
        profiles = swept(scanner, 60)
    for profile in profiles:
        ranges_mm = np.linalg.norm(profile.points, axis=1) * 1e3
        degrees = np.degrees(np.arctan2(profile.points[:, 0], profile.points[:, 1])) % 360
        expected = 2000 - 500 * np.exp(-(((degrees - 90.0) / 10.0) ** 2))
        assert np.abs(ranges_mm - expected).max() < 1.5
    counters = dict(scanner.health().counters)
    assert counters["frames"] >= 60
