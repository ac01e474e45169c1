"""A recording that was cut or damaged gives back everything before and around the damage, and says what is missing."""

import contextlib
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap import records
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from controller.recording import recovery as recording_recovery
from controller.recording.errors import RecordingFileError
from controller.recording.reader import read_recording
from controller.recording.recovery import recover
from drivers.base import CanFrame
from tests.unit.recording_samples import new_recorder, record_mission

FRAMES_PER_CHUNK = 20
CHUNKS = 6


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A recording of six chunks with twenty frames each, and an attachment after the third."""
    path = tmp_path_factory.mktemp("recording") / "m.mcap"
    recorder = new_recorder(path)
    for k in range(CHUNKS * FRAMES_PER_CHUNK):
        recorder.can_frame(CanFrame(float(k), "rx", k, bytes(8)))
        if k % FRAMES_PER_CHUNK == FRAMES_PER_CHUNK - 1:
            recorder.flush()
        if k == 3 * FRAMES_PER_CHUNK - 1:
            recorder.attach("config.yaml", b"x" * 300, "application/yaml")
    recorder.close()
    return path.read_bytes()


@pytest.fixture(scope="module")
def whole_mission(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return record_mission(tmp_path_factory.mktemp("recording") / "m.mcap").read_bytes()


def chunk_spans(data: bytes) -> list[tuple[int, int]]:
    """(first byte, byte behind the last one) of each chunk, taken from the index at the end of the file."""
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    return [(c.chunk_start_offset, c.chunk_start_offset + c.chunk_length) for c in summary.chunk_indexes]


def test_the_sample_has_the_chunks_the_tests_speak_of(mission: bytes, tmp_path: Path) -> None:
    assert len(chunk_spans(mission)) == CHUNKS
    (tmp_path / "m.mcap").write_bytes(mission)
    recording = read_recording(tmp_path / "m.mcap")
    assert recording.complete
    assert len(recording.can_frames()) == CHUNKS * FRAMES_PER_CHUNK


@pytest.mark.parametrize("chunk", range(CHUNKS))
@pytest.mark.parametrize("cut", ["at its start", "in its header", "in its middle", "one byte short", "at its end"])
def test_cut_anywhere_the_chunks_before_the_cut_are_there(mission: bytes, tmp_path: Path, chunk: int, cut: str) -> None:
    start, end = chunk_spans(mission)[chunk]
    place = {
        "at its start": start,
        "in its header": start + 5,
        "in its middle": (start + end) // 2,
        "one byte short": end - 1,
        "at its end": end,
    }[cut]
    (tmp_path / "cut.mcap").write_bytes(mission[:place])
    recording = read_recording(tmp_path / "cut.mcap")
    whole_chunks = chunk + (1 if cut == "at its end" else 0)
    assert [f.arbitration_id for f in recording.can_frames()] == list(range(whole_chunks * FRAMES_PER_CHUNK))
    assert not recording.complete
    assert "breaks off" in recording.damage[-1]
    assert ("config.yaml" in recording.attachments) == (chunk >= 3)


def test_cut_at_any_byte_it_never_raises_and_never_gives_back_less(mission: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    last = 0
    for place in range(8, len(mission), 31):
        path.write_bytes(mission[:place])
        count = len(read_recording(path).can_frames())
        assert count >= last
        last = count
    assert last == CHUNKS * FRAMES_PER_CHUNK


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_a_damaged_chunk_costs_only_itself(mission: bytes, tmp_path: Path, chunk: int) -> None:
    start, end = chunk_spans(mission)[chunk]
    damaged = bytearray(mission)
    damaged[end - 20] ^= 0x55
    (tmp_path / "m.mcap").write_bytes(damaged)
    recording = read_recording(tmp_path / "m.mcap")
    lost = range(chunk * FRAMES_PER_CHUNK, (chunk + 1) * FRAMES_PER_CHUNK)
    expected = [k for k in range(CHUNKS * FRAMES_PER_CHUNK) if k not in lost]
    assert [f.arbitration_id for f in recording.can_frames()] == expected
    assert len(recording.damage) == 1
    assert "damaged and left out" in recording.damage[0]
    assert start < end


def test_a_bit_that_turned_inside_stored_bytes_is_noticed(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).bytes(5000)  # cannot be compressed, so it lies in the file as it is
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.scanner_bytes("rx", noise, 1)
    recorder.close()
    data = bytearray((tmp_path / "m.mcap").read_bytes())
    data[data.index(noise[2000:2100]) + 50] ^= 1
    (tmp_path / "m.mcap").write_bytes(data)
    recording = read_recording(tmp_path / "m.mcap")
    assert recording.scanner_chunks() == []
    assert "damaged and left out" in recording.damage[0]


def test_both_directions_of_the_serial_line_come_in_order_of_time(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    for k, direction in enumerate(("tx", "rx", "rx", "tx", "rx")):
        recorder.scanner_bytes(direction, bytes([k]), 1000 + k)  # type: ignore[arg-type]
    recorder.close()
    chunks = read_recording(tmp_path / "m.mcap").scanner_chunks()
    assert [(c.direction, c.data) for c in chunks] == [
        ("tx", b"\0"),
        ("rx", b"\1"),
        ("rx", b"\2"),
        ("tx", b"\3"),
        ("rx", b"\4"),
    ]


def test_without_any_name_of_a_topic_the_rest_is_still_there(mission: bytes, tmp_path: Path) -> None:
    """The chunk that declares the topics is damaged and the summary that repeats them is cut off."""
    spans = chunk_spans(mission)
    damaged = bytearray(mission[: spans[-1][1]])
    damaged[spans[0][1] - 20] ^= 0x55
    (tmp_path / "m.mcap").write_bytes(damaged)
    recording = read_recording(tmp_path / "m.mcap")
    assert [len(messages) for messages in recording.topics.values()] == [(CHUNKS - 1) * FRAMES_PER_CHUNK]
    assert recording.can_frames() == []
    saved = recover(tmp_path / "m.mcap", tmp_path / "whole.mcap")
    assert (saved.messages, saved.attachments) == (0, 1)


def test_a_recovery_that_the_disk_ends_leaves_nothing_behind(
    mission: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    (tmp_path / "m.mcap").write_bytes(mission)
    monkeypatch.setattr(recording_recovery.os, "fsync", full)
    with pytest.raises(RecordingFileError, match="No space left"):
        recover(tmp_path / "m.mcap", tmp_path / "new.mcap")
    assert [p.name for p in tmp_path.iterdir()] == ["m.mcap"]


def test_recovery_makes_a_file_that_standard_readers_accept(mission: bytes, tmp_path: Path) -> None:
    (start, end) = chunk_spans(mission)[4]
    (tmp_path / "cut.mcap").write_bytes(mission[: (start + end) // 2])
    with pytest.raises(McapError), (tmp_path / "cut.mcap").open("rb") as stream:
        list(make_reader(stream).iter_messages())
    saved = recover(tmp_path / "cut.mcap", tmp_path / "whole.mcap")
    assert (saved.messages, saved.attachments) == (4 * FRAMES_PER_CHUNK, 1)
    with (tmp_path / "whole.mcap").open("rb") as stream:
        messages = [m for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()]
    originals = [r for r in StreamReader(io.BytesIO(mission)).records if isinstance(r, records.Message)]
    keys = [(m.log_time, m.publish_time, m.sequence, m.data) for m in messages]
    assert keys == [(m.log_time, m.publish_time, m.sequence, m.data) for m in originals[: len(messages)]]
    recovered = read_recording(tmp_path / "whole.mcap")
    assert recovered.attachments["config.yaml"].data == b"x" * 300
    assert "recovered" in recovered.damage[0]


def test_recovery_of_a_damaged_first_chunk_keeps_the_names_of_the_topics(mission: bytes, tmp_path: Path) -> None:
    damaged = bytearray(mission)
    damaged[chunk_spans(mission)[0][1] - 20] ^= 0x55
    (tmp_path / "m.mcap").write_bytes(damaged)
    recover(tmp_path / "m.mcap", tmp_path / "whole.mcap")
    frames = read_recording(tmp_path / "whole.mcap").can_frames()
    assert len(frames) == (CHUNKS - 1) * FRAMES_PER_CHUNK


def test_recovery_overwrites_nothing_and_leaves_nothing_half_written(mission: bytes, tmp_path: Path) -> None:
    (tmp_path / "m.mcap").write_bytes(mission)
    (tmp_path / "other.mcap").write_bytes(b"precious")
    with pytest.raises(RecordingFileError, match="exists already"):
        recover(tmp_path / "m.mcap", tmp_path / "other.mcap")
    with pytest.raises(RecordingFileError, match="cannot write"):
        recover(tmp_path / "m.mcap", tmp_path / "missing" / "new.mcap")
    assert (tmp_path / "other.mcap").read_bytes() == b"precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m.mcap", "other.mcap"]


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\n", b"\x89MCAP"])
def test_a_file_of_another_kind_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(RecordingFileError, match="not an MCAP file"):
        read_recording(tmp_path / "x.mcap")


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.mcap", tmp_path):
        with pytest.raises(RecordingFileError, match="cannot read"):
            read_recording(path)


def test_a_mission_without_an_end_has_no_summary(tmp_path: Path) -> None:
    whole = record_mission(tmp_path / "m.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    assert read_recording(tmp_path / "cut.mcap").summary() is None


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_bytes_gone_wrong_are_never_more_than_one_clear_error(
    whole_mission: bytes, tmp_path: Path, data: st.DataObject
) -> None:
    damaged = bytearray(whole_mission)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "m.mcap").write_bytes(damaged)
    try:
        recording = read_recording(tmp_path / "m.mcap")
    except RecordingFileError:
        assert damaged[:8] != whole_mission[:8]
        return
    for take in (
        recording.transitions,
        recording.can_frames,
        recording.arm_states,
        recording.estimates,
        recording.scans,
    ):
        with contextlib.suppress(RecordingFileError):
            take()
    recording.summary()


def test_a_recording_of_another_version_is_one_clear_error(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.scanner_bytes("rx", b"abc", 1)
    recorder.close()
    recording = read_recording(tmp_path / "m.mcap")
    (message,) = recording.topics["/scanner/rx"]
    recording.topics["/scanner/rx"] = [replace(message, data=b"another layout")]
    with pytest.raises(RecordingFileError, match="cannot read topic /scanner/rx") as raised:
        recording.scanner_chunks()
    assert "version" in raised.value.remedy
