"""The recorder never makes a caller wait, loses no event, says what it drops, and fails once and quietly."""

import errno
import json
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from controller.recording import file as recording_file
from controller.recording.errors import RecordingError, RecordingTargetError
from controller.recording.reader import read_recording
from controller.recording.recorder import Recorder
from drivers.base import ArmCommandRecord, ArmState, ByteSink, CanFrame
from perception.geometry import Pose
from tests.unit.recording_samples import (
    ManualClock,
    arm_state,
    estimate,
    new_recorder,
    record_mission,
    scan_cloud,
    summary,
)


def wait_until(condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "condition not met in time"
        time.sleep(0.005)


class Disk:
    """Stands between the recorder and the operating system: can be full or hang."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room = 10**12
        self.open = threading.Event()
        self.open.set()
        self.blocked = threading.Event()
        self._write = os.write
        monkeypatch.setattr(recording_file.os, "write", self.write)

    def write(self, descriptor: int, data: bytes) -> int:
        if not self.open.is_set():
            self.blocked.set()
            assert self.open.wait(30.0)
        if self.room <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = self._write(descriptor, data[: self.room])
        self.room -= written
        return written


def test_it_is_the_sink_that_drivers_expect(tmp_path: Path) -> None:
    sink: ByteSink = new_recorder(tmp_path / "m.mcap")
    assert isinstance(sink, Recorder)
    sink.close()


def test_what_is_read_back_is_what_was_recorded(tmp_path: Path) -> None:
    recording = read_recording(record_mission(tmp_path / "m.mcap"))
    assert recording.complete
    assert recording.summary() == summary()
    assert [t.to_state for t in recording.transitions()][-1] == "READY"
    assert len(recording.can_frames()) == 600
    assert [c.data for c in recording.scanner_chunks("rx")] == [bytes([k]) * (k + 1) for k in range(40)]
    assert recording.arm_commands()[0].arguments == (0.1, -1.5, 1.6, -1.4, -1.5, 0.2, 0.5, 0.8)
    assert np.array_equal(recording.scans()[0].cloud.points, scan_cloud().points)
    assert recording.attachments["config.yaml"].data.startswith(b"arm:")
    assert recording.metadata["versions"]["portdock"] == "0.1.0"


def test_poses_and_forces_come_back_to_the_last_bit(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    sent = arm_state(101.123456789, force_n=47.1)
    recorder.arm_state(sent)
    recorder.estimate(estimate())
    recorder.close()
    recording = read_recording(tmp_path / "m.mcap")
    (got,) = recording.arm_states()
    assert np.array_equal(got.T_base_tcp.matrix, sent.T_base_tcp.matrix)
    assert np.array_equal(got.T_base_flange.matrix, sent.T_base_flange.matrix)
    assert np.array_equal(got.wrench, sent.wrench)
    assert np.array_equal(got.joints, sent.joints)
    assert np.array_equal(got.tcp_speed, sent.tcp_speed)
    plain = ("time_s", "device_time_s", "mode", "safety", "moving", "program_running", "speed_scaling")
    assert [getattr(got, name) for name in plain] == [getattr(sent, name) for name in plain]
    located = recording.estimates()[0].estimate
    assert np.array_equal(located.T_ref_port.matrix, estimate().T_ref_port.matrix)
    assert located.reasons == estimate().reasons
    assert located.timings_s == estimate().timings_s


def test_each_message_carries_host_time_and_wall_time(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap", ManualClock(100.0))
    recorder.scanner_bytes("rx", b"abc", 101_000_000_007)
    recorder.close()
    (message,) = read_recording(tmp_path / "m.mcap").topics["/scanner/rx"]
    assert message.publish_time_ns == 101_000_000_007
    assert message.log_time_ns == 1_760_000_001_000_000_007


def test_flush_returns_when_the_file_can_be_read_without_closing_it(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.can_frame(CanFrame(1.0, "rx", 5, b"\x01"))
    recorder.flush()
    recording = read_recording(tmp_path / "m.mcap")
    assert len(recording.can_frames()) == 1
    assert not recording.complete
    recorder.close()


def test_a_transition_reaches_the_disk_without_anyone_waiting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced = threading.Event()
    fsync = os.fsync
    monkeypatch.setattr(recording_file.os, "fsync", lambda descriptor: (fsync(descriptor), synced.set()))
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.transition("READY", "dock", "STAGING", 1.0)
    assert synced.wait(20.0)
    assert read_recording(tmp_path / "m.mcap").transitions()[0].to_state == "STAGING"
    recorder.close()


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "m.mcap").write_bytes(b"evidence")
    with pytest.raises(RecordingTargetError, match="exists already") as raised:
        new_recorder(tmp_path / "m.mcap")
    assert "--out" in raised.value.remedy
    assert (tmp_path / "m.mcap").read_bytes() == b"evidence"


def test_a_folder_that_cannot_be_made_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingTargetError, match="cannot write the recording"):
        new_recorder(tmp_path / "file" / "sub" / "m.mcap")


def test_many_threads_may_record_at_once(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")

    def send(thread: int) -> None:
        for k in range(300):
            recorder.can_frame(CanFrame(float(k), "rx", thread, k.to_bytes(2, "big")))

    threads = [threading.Thread(target=send, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    recorder.close()
    frames = read_recording(tmp_path / "m.mcap").can_frames()
    for thread_number in range(4):
        assert [f.time_s for f in frames if f.arbitration_id == thread_number] == [float(k) for k in range(300)]


def test_a_hanging_disk_blocks_no_caller_and_costs_only_named_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(monkeypatch)
    recorder = new_recorder(tmp_path / "m.mcap", backlog_bytes=10_000)
    disk.open.clear()
    recorder.transition("READY", "dock", "STAGING", 1.0)
    assert disk.blocked.wait(20.0)
    for _ in range(50):
        recorder.scanner_bytes("rx", bytes(1000), 1)
    for k in range(50):
        recorder.arm_command(ArmCommandRecord(1.0, "stopL", (float(k),), "accepted"))
    assert recorder.dropped == 40
    disk.open.set()
    recorder.flush(timeout_s=30.0)
    recorder.scanner_bytes("rx", b"after the gap", 2)
    recorder.close()
    recording = read_recording(tmp_path / "m.mcap")
    assert recorder.failure is None
    assert [message.sequence for message in recording.topics["/scanner/rx"]] == [*range(10), 50]
    assert [(d.topic, d.count) for d in recording.drops()] == [("/scanner/rx", 40)]
    assert len(recording.arm_commands()) == 50


def test_flush_says_so_when_the_disk_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    recorder = new_recorder(tmp_path / "m.mcap")
    disk.open.clear()
    recorder.note("info", "something to write")
    with pytest.raises(RecordingError, match="not on the disk"):
        recorder.flush(timeout_s=0.1)
    disk.open.set()
    recorder.close()
    assert recorder.failure is None


def test_a_full_disk_is_told_once_to_the_controller_and_never_to_a_reader_thread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(monkeypatch)
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.transition("OFFLINE", "start", "SELF_CHECK", 1.0)
    recorder.flush()
    disk.room = 100
    for k in range(50):
        recorder.scanner_bytes("rx", np.random.default_rng(k).bytes(2000), k)
    with pytest.raises(RecordingError, match="No space left") as raised:
        recorder.flush()
    assert "disk space" in raised.value.remedy
    assert recorder.failure is raised.value
    recorder.scanner_bytes("rx", b"more", 3)
    recorder.arm_state(arm_state(2.0))
    recorder.transition("SELF_CHECK", "ok", "READY", 2.0)
    recorder.flush()
    recorder.close(summary())
    recording = read_recording(tmp_path / "m.mcap")
    assert [t.to_state for t in recording.transitions()] == ["SELF_CHECK"]
    assert not recording.complete


def test_a_value_that_cannot_be_written_costs_only_itself(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    broken = arm_state(1.0)
    recorder.arm_state(
        ArmState(**{**{name: getattr(broken, name) for name in ArmState.__slots__}, "joints": np.zeros(5)})
    )
    recorder.arm_state(arm_state(2.0))
    recorder.close()
    recording = read_recording(tmp_path / "m.mcap")
    assert [state.time_s for state in recording.arm_states()] == [2.0]
    assert [(d.topic, d.count) for d in recording.drops()] == [("/arm/state", 1)]
    assert recorder.failure is None


def test_an_estimate_that_was_refused_is_recorded_but_is_no_dock_pose(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.estimate(estimate(accepted=False, reasons=("too few points on the rim",)))
    recorder.close()
    recording = read_recording(tmp_path / "m.mcap")
    assert recording.estimates()[0].estimate.reasons == ("too few points on the rim",)
    assert "/dock/pose" not in recording.topics


def test_transforms_follow_the_arm_ten_times_a_second(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    for k in range(1000):
        recorder.arm_state(arm_state(100.0 + 0.002 * k))
    recorder.close()
    messages = [json.loads(message.data) for message in read_recording(tmp_path / "m.mcap").topics["/tf"]]
    assert {(m["parent_frame_id"], m["child_frame_id"]) for m in messages} == {("base", "flange"), ("flange", "tcp")}
    assert 38 <= len(messages) <= 42


def test_transforms_are_the_arm_s_own_poses(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.arm_state(arm_state(1.0))
    recorder.close()
    flange, tcp = (_pose(message.data) for message in read_recording(tmp_path / "m.mcap").topics["/tf"])
    assert np.allclose((flange @ tcp).matrix, arm_state(1.0).T_base_tcp.matrix)
    assert np.allclose(flange.matrix, arm_state(1.0).T_base_flange.matrix)


def _pose(message: bytes) -> Pose:
    """As a viewer reads foxglove.FrameTransform: translation, and a quaternion (x, y, z, w)."""
    values = json.loads(message)
    x, y, z, w = (values["rotation"][axis] for axis in "xyzw")
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return Pose(rotation, np.array([values["translation"][axis] for axis in "xyz"]))


def test_close_is_idempotent_and_what_comes_later_is_ignored(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.close(summary())
    recorder.close()
    recorder.can_frame(CanFrame(1.0, "rx", 1, b""))
    recorder.note("warning", "too late")
    recorder.transition("READY", "late", "READY", 1.0)
    recorder.flush()
    assert read_recording(tmp_path / "m.mcap").complete


def test_no_thread_is_left_behind(tmp_path: Path) -> None:
    before = threading.active_count()
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.close()
    wait_until(lambda: threading.active_count() == before)


def test_a_disk_without_any_room_leaves_neither_a_descriptor_nor_a_file_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: object, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "no space left")

    monkeypatch.setattr(recording_file._UnbufferedFile, "write", full)
    before = len(os.listdir("/proc/self/fd"))
    for k in range(20):
        with pytest.raises(RecordingTargetError):
            new_recorder(tmp_path / f"{k}" / "mission.mcap")
    assert len(os.listdir("/proc/self/fd")) == before
    assert not list(tmp_path.glob("*/*.mcap"))
