"""How the scanner's side keeps up with its line: decoding as a multiple of the line rate, reading, and latency.

All figures are ratios within one run: CPU time of this process against the time that the line takes, or a delay against
that of a bare sleep loop at the same moments.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from controller.scanner_files import load_scanner
from drivers.base import MonotonicClock, NullSink
from drivers.scanner.frame_parser import FrameParser
from drivers.scanner.framed import FramedScanner, FramedTimeouts
from drivers.scanner.profiler2 import Profiler2Settings, points_of
from drivers.scanner.profiler2_codec import PacketReader
from drivers.scanner.scip import ScipGeometry, ScipScanner, ScipSettings
from drivers.scanner.serial_link import SerialLink, SerialSettings
from mocks.scanner import ld19, profiler2, scip, wide_xz
from mocks.scanner.pty_line import PtyLine
from mocks.scanner.turning_views import RoomView
from tests.contract.scanner_bench import mock

pytestmark = [pytest.mark.benchmark_ratio, pytest.mark.timeout(600)]

LINE_BAUD = 4_000_000
WANTED_TIMES = 50.0
CHUNK = 65536
"""What one read takes at most; the reader takes whatever has come."""
Feed = Callable[[bytes], int]
Record = Callable[[str, object], None]


def times_the_line(stream: bytes, decoder: Callable[[], Feed], profiles: int) -> float:
    """Line time over CPU time, best of thirty short runs: what the code takes, not what else the machine does."""
    best = 0.0
    for _ in range(30):
        feed = decoder()
        began_s = time.process_time()
        count = sum(feed(stream[start : start + CHUNK]) for start in range(0, len(stream), CHUNK))
        spent_s = time.process_time() - began_s
        assert count == profiles
        best = max(best, len(stream) * 10 / LINE_BAUD / spent_s)
    return best


def wide_decoder() -> Feed:
    parser = FrameParser(load_scanner("wide_xz").layout)
    return lambda chunk: len(parser.feed(chunk, 0))


def ld19_decoder() -> Feed:
    parser = FrameParser(load_scanner("ld19").layout)
    return lambda chunk: len(parser.feed(chunk, 0))


def profiler2_decoder() -> Feed:
    """Packets to blocks of points; seven blocks are a profile, as the driver puts them together."""
    reader, settings, blocks = PacketReader(), Profiler2Settings(), list[np.ndarray]()  # type: ignore[type-arg]

    def feed(chunk: bytes) -> int:
        done = 0
        for packet in reader.feed(chunk):
            blocks.append(packet.words[2:])
            if len(blocks) == 7:
                points, _ = points_of(np.concatenate(blocks), settings)
                assert len(points) == 832
                blocks.clear()
                done += 1
        return done

    return feed


def scip_decoder() -> Feed:
    settings = SerialSettings("none", 115_200)
    scanner = ScipScanner(settings, ScipSettings(), NullSink(), MonotonicClock())
    scanner._geometry = ScipGeometry("", 20, 5600, 1024, 44, 725, 384, 600)
    scanner._streaming = True

    def feed(chunk: bytes) -> int:
        scanner._on_bytes(chunk, 0)
        return len(scanner.take())

    scanner._silent_s = lambda: 0.0  # type: ignore[method-assign]
    return feed


def wide_stream() -> tuple[bytes, int]:
    x = np.linspace(-0.07, 0.07, 1000)
    frames = [wide_xz.encode(np.stack([x, 0.3 + x * k * 1e-4], axis=1), k, 0.014 * k) for k in range(50)]
    return b"".join(frames), 50


def ld19_stream() -> tuple[bytes, int]:
    return b"".join(ld19.packet(k, k / 375) for k in range(1001)), 1000  # the last one is not confirmed yet


def profiler2_stream() -> tuple[bytes, int]:
    line = np.stack([np.linspace(-0.015, 0.015, 832), np.full(832, 0.1)], axis=1)
    words = profiler2.memory_image(line, 1.0, 0.1)[4:]
    blocks = [words[start : start + 504] for start in range(0, len(words), 504)]
    answers = b"".join(profiler2.packet(0x0002, b"\x03\x06\x20\x04" + block) for block in blocks)
    return answers * 50, 50


def scip_stream() -> tuple[bytes, int]:
    ranges, _ = RoomView(scip.STEPS_SEEN, scip.FRONT).scan(3, 0.3)
    data = scip.encode(ranges, 3) + b"\n"
    heads = [b"MD0044072501000\n99b\n" + scip.encode(np.array([100 * k]), 4) for k in range(100)]
    return b"".join(head + data for head in heads), 100


@pytest.mark.parametrize(
    ("name", "made", "decoder"),
    [
        ("framed wide_xz", wide_stream, wide_decoder),
        ("profiler2", profiler2_stream, profiler2_decoder),
        ("scip", scip_stream, scip_decoder),
    ],
)
def test_decoding_is_fifty_times_faster_than_a_line_of_4_mbaud(
    name: str, made: Callable[[], tuple[bytes, int]], decoder: Callable[[], Feed], record_property: Record
) -> None:
    stream, profiles = made()
    ratio = times_the_line(stream, decoder, profiles)
    record_property(f"{name}: times the line", round(ratio, 1))
    assert ratio >= WANTED_TIMES, f"{name}: {ratio:.1f} times"


def test_an_ld19s_short_packets_are_decoded_fifty_times_faster_than_its_own_line(record_property: Record) -> None:
    """Twelve points a packet: a profile object for every 47 bytes, so not fifty times 4 Mbaud."""
    stream, profiles = ld19_stream()
    ratio = times_the_line(stream, ld19_decoder, profiles)
    record_property("ld19: times 4 Mbaud", round(ratio, 1))
    assert ratio * LINE_BAUD / 230_400 >= WANTED_TIMES


# --- the reader under load ------------------------------------------------------------------------------------------


def _work(stop_s: float) -> None:
    """Stands for perception: numpy on one core, at perception's lower priority."""
    os.nice(10)
    rng = np.random.default_rng(0)
    points = rng.standard_normal((4000, 3))
    while time.monotonic() < stop_s:
        np.linalg.svd(points @ rng.standard_normal((3, 3)), full_matrices=False)


@contextmanager
def busy_cores(seconds: float) -> Iterator[None]:
    """Both cores kept busy at lower priority."""
    context = get_context("spawn")
    workers = [context.Process(target=_work, args=(time.monotonic() + seconds,), daemon=True) for _ in range(2)]
    for worker in workers:
        worker.start()
    try:
        yield
    finally:
        for worker in workers:
            worker.terminate()
            worker.join()


def test_a_minute_at_921_600_baud_loses_no_byte_and_takes_less_than_a_tenth_of_a_core(
    tmp_path: Path, record_property: Record
) -> None:
    minute_s = 60.0
    description = load_scanner("wide_xz")
    link = tmp_path / "dev"
    with busy_cores(minute_s + 30.0), mock(link, "--rate-hz", "22"):
        scanner = FramedScanner(
            SerialSettings(str(link), 921_600),
            description.layout,
            NullSink(),
            MonotonicClock(),
            FramedTimeouts(5, 3, 20),
        )
        scanner.open()
        scanner.start()
        began_s, cpu_s = time.monotonic(), time.process_time()
        profiles = 0
        while time.monotonic() - began_s < minute_s:
            time.sleep(0.5)
            profiles += len(scanner.take())
        share = (time.process_time() - cpu_s) / (time.monotonic() - began_s)
        scanner.stop()
        profiles += len(scanner.take())
        counters = dict(scanner.health().counters)
        scanner.close()
    record_property("share of a core", round(share, 4))
    record_property("bytes", counters["bytes"])
    assert counters["bytes_dropped"] == counters["bad_checksum"] == counters["lost"] == counters["overruns"] == 0
    assert profiles == counters["frames"]
    assert counters["bytes"] > 0.9 * 22 * 4020 * minute_s
    assert share < 0.10


def test_a_profile_is_there_soon_after_its_last_byte(tmp_path: Path, record_property: Record) -> None:
    """99 % of all: no later than a bare sleep of 10 ms is in the same run, plus 5 ms."""
    line = PtyLine(tmp_path / "dev")
    line.plug_in()
    layout = replace(load_scanner("ld19").layout, confirmed_by_next=False)  # short frames: none waits for room
    parser, arrived = FrameParser(layout), dict[int, float]()

    def on_bytes(chunk: bytes, host_time_ns: int) -> None:
        for profile in parser.feed(chunk, host_time_ns):
            arrived[profile.sequence] = time.monotonic()

    link = SerialLink(SerialSettings(str(tmp_path / "dev"), 230_400), NullSink(), on_bytes)
    link.open()
    lateness, stopping = list[float](), threading.Event()

    def sleep_loop() -> None:
        while not stopping.is_set():
            began_s = time.monotonic()
            time.sleep(0.010)
            lateness.append(time.monotonic() - began_s - 0.010)

    sleeper = threading.Thread(target=sleep_loop)
    sent = list[float]()
    with busy_cores(60.0):
        sleeper.start()
        for number in range(1500):
            frame = ld19.packet(number, number / 375)
            line.write(frame[:30])
            time.sleep(0.005)
            sent.append(time.monotonic())
            line.write(frame[30:])
            time.sleep(0.005)
        deadline_s = time.monotonic() + 20.0
        while len(arrived) < len(sent) and time.monotonic() < deadline_s:
            time.sleep(0.01)
        stopping.set()
        sleeper.join()
    link.close()
    line.unplug()
    assert len(arrived) == len(sent)
    delays = np.array([arrived[number] - sent[number] for number in range(len(sent))])
    p99_s, bare_s = float(np.quantile(delays, 0.99)), float(np.quantile(lateness, 0.99))
    record_property("p99 of the delay, ms", round(p99_s * 1e3, 3))
    record_property("p99 of the bare loop's lateness, ms", round(bare_s * 1e3, 3))
    assert p99_s <= bare_s + 0.005
