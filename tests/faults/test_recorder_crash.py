"""A recording outlives its process being killed and its disk filling up, with real signals and real limits."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

from controller.recording.reader import read_recording
from controller.recording.recovery import recover

PRELUDE = """
import sys, time
from pathlib import Path
from controller.recording.recorder import Recorder
from controller.recording.errors import RecordingError
from drivers.base import CanFrame, MonotonicClock
recorder = Recorder(Path(sys.argv[1]), MonotonicClock())
"""


def start(script: str, path: Path) -> subprocess.Popen[str]:
    code = PRELUDE + textwrap.dedent(script)
    return subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True)


def test_kill_9_loses_nothing_that_was_flushed(tmp_path: Path) -> None:
    path = tmp_path / "m.mcap"
    process = start(
        """
        recorder.attach("config.yaml", b"a: 1", "application/yaml")
        for k in range(1000):
            recorder.can_frame(CanFrame(float(k), "rx", k, b"12345678"))
            if k % 100 == 0:
                recorder.transition(f"S{k}", "step", f"S{k + 100}", float(k))
        recorder.flush()
        print("flushed", flush=True)
        while True:
            recorder.can_frame(CanFrame(5000.0, "rx", 5000, b"unflushed"[:8]))
            time.sleep(0.0005)
        """,
        path,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "flushed\n"
    os.kill(process.pid, signal.SIGKILL)
    process.wait(30)
    recording = read_recording(path)
    frames = [frame for frame in recording.can_frames() if frame.arbitration_id < 1000]
    assert [frame.arbitration_id for frame in frames] == list(range(1000))
    assert len(recording.transitions()) == 10
    assert recording.attachments["config.yaml"].data == b"a: 1"
    assert not recording.complete
    assert recording.summary() is None
    assert recover(path, tmp_path / "whole.mcap").messages >= 1010


def test_kill_9_loses_at_most_the_last_second_without_any_flush(tmp_path: Path) -> None:
    path = tmp_path / "m.mcap"
    process = start(
        """
        for k in range(100):
            recorder.can_frame(CanFrame(float(k), "rx", k, b"12345678"))
        size = Path(sys.argv[1]).stat().st_size
        while Path(sys.argv[1]).stat().st_size == size:
            time.sleep(0.01)
        print("a chunk came by itself", flush=True)
        time.sleep(60)
        """,
        path,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "a chunk came by itself\n"
    process.kill()
    process.wait(30)
    assert len(read_recording(path).can_frames()) == 100


def test_a_full_disk_ends_the_recording_but_not_the_mission(tmp_path: Path) -> None:
    path = tmp_path / "m.mcap"
    process = start(
        """
        import os, resource
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
        errors = 0
        for k in range(100):
            for n in range(5):
                recorder.scanner_bytes("rx", os.urandom(1000), k)
            recorder.transition("A", "e", "B", float(k))
            try:
                recorder.flush()
            except RecordingError as error:
                errors += 1
        recorder.close()
        print(errors, k, recorder.failure.code, flush=True)
        """,
        path,
    )
    out, _ = process.communicate(timeout=60)
    assert out == "1 99 recording\n"
    assert process.returncode == 0
    assert path.stat().st_size <= 200_000
    recording = read_recording(path)
    assert len(recording.scanner_chunks()) > 100
    assert not recording.complete
