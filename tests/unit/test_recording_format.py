"""What lies in the file, checked against literal bytes and published schema names: other programs read it too."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from controller.recording import messages, schemas
from controller.recording.protobuf import Field, Layout, read_varint, varint
from controller.recording.records import (
    ARM_STATE,
    arm_table,
    decode_can_frame,
    decode_scanner_bytes,
    encode_arm_state,
    encode_can_frame,
    encode_scanner_bytes,
)
from controller.recording.records import arm_state as recorded_arm_state
from drivers.base import CanFrame
from tests.unit.recording_samples import arm_state, record_mission, scan_cloud

FLOATS = st.floats(allow_nan=False)


def test_scanner_chunk_is_a_protobuf_message() -> None:
    # field 1 fixed64 (tag 0x09) = 258, field 2 bytes (tag 0x12), 3 bytes long
    literal = bytes.fromhex("09 0201000000000000 12 03 FF0102")
    assert encode_scanner_bytes(258, b"\xff\x01\x02") == literal
    assert decode_scanner_bytes(literal) == (258, b"\xff\x01\x02")


def test_can_frame_is_a_protobuf_message() -> None:
    frame = CanFrame(1.5, "tx", 0x18FF0110, b"\xaa\xbb", is_extended=True, is_error=False, is_fd=True)
    # double 1.5; fixed32 id; bools transmitted, extended, error, fd; bytes
    literal = bytes.fromhex("09 000000000000F83F 15 1001FF18 18 01 20 01 28 00 30 01 3A 02 AABB")
    assert encode_can_frame(frame) == literal
    assert decode_can_frame(literal) == frame


def test_descriptor_is_a_file_descriptor_set() -> None:
    layout = Layout("p.M", (Field("a", "doubles", 3), Field("b", "bytes")))
    assert layout.descriptor() == bytes.fromhex(
        "0A 31"  # FileDescriptorSet.file, 49 bytes
        "0A 09 702E4D2E70726F746F"  # name "p.M.proto"
        "12 01 70"  # package "p"
        "22 19"  # message_type, 25 bytes
        "0A 01 4D"  # name "M"
        "12 09 0A0161 1801 2003 2801"  # a = 1, repeated, double
        "12 09 0A0162 1802 2001 280C"  # b = 2, optional, bytes
        "62 06 70726F746F33"  # syntax "proto3"
    )


@given(st.integers(0, 2**64 - 1))
def test_varints_come_back(value: int) -> None:
    assert read_varint(varint(value), 0) == (value, len(varint(value)))


def test_varint_of_300_is_the_one_of_the_encoding_guide() -> None:
    assert varint(300) == b"\xac\x02"


@given(st.integers(0, 2**64 - 1), st.binary(max_size=4096))
def test_scanner_chunks_come_back_byte_for_byte(time_ns: int, data: bytes) -> None:
    assert decode_scanner_bytes(encode_scanner_bytes(time_ns, data)) == (time_ns, data)


@given(FLOATS, st.booleans(), st.integers(0, 2**29 - 1), st.binary(max_size=64), st.lists(st.booleans(), min_size=3))
def test_can_frames_come_back(time_s: float, sent: bool, identifier: int, data: bytes, flags: list[bool]) -> None:
    frame = CanFrame(time_s, "tx" if sent else "rx", identifier, data, *flags[:3])
    assert decode_can_frame(encode_can_frame(frame)) == frame


@given(st.binary(max_size=80))
def test_arbitrary_bytes_are_refused_as_a_value_error(data: bytes) -> None:
    for decode in (decode_scanner_bytes, decode_can_frame):
        try:
            decode(data)
        except ValueError:
            continue
        assert data[0] == 0x09


@given(st.integers(0, 24), st.binary(min_size=1, max_size=1))
def test_a_record_with_a_wrong_tag_or_length_is_refused(position: int, byte: bytes) -> None:
    good = encode_can_frame(CanFrame(1.0, "rx", 7, b"\x01\x02"))
    bad = good[:position] + byte + good[position + 1 :]
    tags = {0, 9, 14, 16, 18, 20, 22, 23}
    if position in tags and bad != good:
        with pytest.raises(ValueError, match="record of the recording"):
            decode_can_frame(bad)


def test_arm_records_of_another_layout_are_refused() -> None:
    good = encode_arm_state(arm_state(1.0))
    assert len(good) == ARM_STATE.struct.size
    with pytest.raises(ValueError, match="lacks time_s"):
        arm_table([b"\x0a" + good[1:]])
    with pytest.raises(ValueError, match="another length"):
        arm_table([good, good + b"\x00"])


def test_digital_outputs_come_back_and_are_zero_in_older_recordings() -> None:
    record = encode_arm_state(replace(arm_state(1.0), digital_outputs=0b1010_0001))
    assert recorded_arm_state(arm_table([record])[0]).digital_outputs == 0b1010_0001
    older = recorded_arm_state(arm_table([record[:-5]])[0])
    assert (older.digital_outputs, older.speed_scaling) == (0, arm_state(1.0).speed_scaling)
    with pytest.raises(ValueError, match="another length"):
        arm_table([record, record[:-5]])


def test_a_stream_of_arm_states_decodes_as_one_table() -> None:
    table = arm_table([encode_arm_state(arm_state(float(k), force_n=k)) for k in range(5)])
    assert table["time_s"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert np.allclose(np.linalg.norm(table["wrench"][:, :3], axis=1), range(5))


def test_derived_topics_use_the_well_known_schemas(tmp_path: Path) -> None:
    with record_mission(tmp_path / "m.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    named = {c.topic: summary.schemas[c.schema_id] for c in summary.channels.values()}
    expected = {
        "/scan/points": "foxglove.PointCloud",
        "/dock/pose": "foxglove.PoseInFrame",
        "/tf": "foxglove.FrameTransform",
        "/log": "foxglove.Log",
    }
    assert {topic: named[topic].name for topic in expected} == expected
    assert {named[topic].encoding for topic in expected} == {"jsonschema"}
    for topic in ("/scanner/rx", "/scanner/tx", "/can/raw", "/arm/state"):
        assert named[topic].encoding == "protobuf"
    assert len(named) == len(schemas.TOPICS)


def test_every_json_message_has_exactly_the_fields_of_its_schema(tmp_path: Path) -> None:
    seen = set()
    with record_mission(tmp_path / "m.mcap").open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            if channel.message_encoding == "json":
                assert schema is not None
                assert set(json.loads(message.data)) == set(json.loads(schema.data)["properties"])
                seen.add(channel.topic)
    assert seen == {t.name for t in schemas.TOPICS if t.message_encoding == "json"} - {"/recorder/drops"}


def test_point_cloud_is_packed_as_its_fields_say() -> None:
    cloud = scan_cloud()
    message = json.loads(messages.encode_cloud(cloud, 1_500_000_000_123_456_789))
    assert message["timestamp"] == {"sec": 1_500_000_000, "nsec": 123_456_789}
    assert message["fields"] == [{"name": n, "offset": 8 * k, "type": 8} for k, n in enumerate("xyz")]
    assert message["pose"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    assert np.array_equal(messages.decode_cloud(json.dumps(message).encode(), 1.0).cloud.points, cloud.points)


def test_log_levels_are_numbered_as_foxglove_numbers_them() -> None:
    note = messages.Note(1.0, "error", "arm: protective stop")
    message = json.loads(messages.encode_note(note, 5))
    assert message["level"] == 4
    assert messages.decode_note(json.dumps(message).encode(), 1.0) == note
