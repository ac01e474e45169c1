"""The driver's own two conversations, dashboard and RTDE stream, against literal bytes."""

from __future__ import annotations

import itertools
import socket
import struct
import threading
from contextlib import contextmanager

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.arm.dashboard import Dashboard
from drivers.arm.errors import ArmAbsentError
from drivers.arm.rtde_stream import RawSample, RtdeStream, controller_version, decode
from drivers.base import LinkLostError, ProtocolError
from tests.arm_rig import own_address

BANNER = b"Connected: Universal Robots Dashboard Server\n"


@contextmanager
def scripted_server(port: int, script: list[tuple[bytes, bytes]], greeting: bytes = b""):
    """Sends ``greeting``, then for each pair waits for exactly the first and sends the second; then hangs up."""
    host = own_address()
    seen: list[bytes] = []
    server = socket.create_server((host, port))

    def run() -> None:
        link, _ = server.accept()
        with link:
            link.settimeout(5.0)
            link.sendall(greeting)
            for expected, answer in script:
                data = b""
                while len(data) < len(expected):
                    chunk = link.recv(len(expected) - len(data))
                    if not chunk:
                        break
                    data += chunk
                seen.append(data)
                link.sendall(answer)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield host, seen
    finally:
        thread.join(5.0)
        server.close()


def test_the_dashboard_speaks_lines() -> None:
    script = [(b"robotmode\n", b"Robotmode: RUNNING\n"), (b"safetystatus\n", b"Safetystatus: PROTECTIVE_STOP\n")]
    with scripted_server(29999, script, BANNER) as (host, seen), Dashboard(host) as dashboard:
        assert dashboard.robot_mode() == "RUNNING"
        assert dashboard.safety_status() == "PROTECTIVE_STOP"
    assert seen == [b"robotmode\n", b"safetystatus\n"]


def test_a_refused_stop_is_reported_with_the_servers_words() -> None:
    script = [(b"stop\n", b"Failed to execute: stop\n")]
    with (
        scripted_server(29999, script, BANNER) as (host, _),
        Dashboard(host) as dashboard,
        pytest.raises(ProtocolError, match="Failed to execute"),
    ):
        dashboard.stop()


def test_a_server_that_hangs_up_is_a_lost_link() -> None:
    with (
        scripted_server(29999, [(b"running\n", b"Program run")], BANNER) as (host, _),
        Dashboard(host) as dashboard,
        pytest.raises(LinkLostError),
    ):
        dashboard.program_running()


def test_another_server_at_the_port_is_recognised() -> None:
    with scripted_server(29999, [], b"220 ftp ready\n") as (host, _), pytest.raises(ProtocolError):
        Dashboard(host)


VERSION = (bytes.fromhex("0005560002"), bytes.fromhex("00045601"))
CONTROLLER = (bytes.fromhex("000376"), bytes.fromhex("001376 00000005 0000000f 00000002 00000063"))
NAMES = (
    b"timestamp,actual_q,actual_qd,actual_TCP_pose,actual_TCP_speed,actual_TCP_force,robot_mode,safety_mode,"
    b"runtime_state,speed_scaling,target_speed_fraction,payload,payload_cog,actual_digital_output_bits"
)
KINDS = b"DOUBLE,VECTOR6D,VECTOR6D,VECTOR6D,VECTOR6D,VECTOR6D,INT32,INT32,UINT32,DOUBLE,DOUBLE,DOUBLE,VECTOR3D,UINT64"
OUTPUTS = (bytes.fromhex("00d14f 405f400000000000") + NAMES, bytes.fromhex("006f4f 01") + KINDS)
START = (bytes.fromhex("000353"), bytes.fromhex("00045301"))
ONE, TWO, HALF = (bytes.fromhex(text) for text in ("3ff0000000000000", "4000000000000000", "3fe0000000000000"))
SAMPLE = (
    bytes.fromhex("014055 01")
    + TWO  # time stamp
    + ONE * 6  # q
    + HALF * 6  # qd
    + TWO * 6  # pose
    + ONE * 6  # speed
    + HALF * 6  # force
    + bytes.fromhex("00000007 00000001 00000002")  # RUNNING, NORMAL, PLAYING
    + ONE  # speed scaling
    + HALF  # slider
    + TWO  # payload
    + ONE * 3  # centre of gravity
    + bytes.fromhex("0000000000000005")  # digital outputs 0 and 2
)
LATER = SAMPLE.replace(bytes.fromhex("01") + TWO, bytes.fromhex("01 4008000000000000"), 1)


def opened(host: str) -> RtdeStream:
    stream = RtdeStream(host, 2.0)
    stream.start(125.0)
    return stream


def read_all(stream: RtdeStream, count: int) -> list[RawSample]:
    samples: list[RawSample] = []
    while len(samples) < count:
        samples += stream.read(2.0)
    return samples


def test_the_stream_asks_for_version_and_data_and_decodes_a_sample() -> None:
    script = [VERSION, CONTROLLER, OUTPUTS, (START[0], START[1] + SAMPLE)]
    with scripted_server(30004, script) as (host, seen):
        stream = opened(host)
        (sample,) = read_all(stream, 1)
        stream.close()
    assert seen == [expected for expected, _ in script]
    assert stream.version == (5, 15, 2, 99)
    assert sample == RawSample(
        2.0, (1.0,) * 6, (0.5,) * 6, (2.0,) * 6, (1.0,) * 6, (0.5,) * 6, 7, 1, 2, 1.0, 0.5, 2.0, (1.0,) * 3, 5
    )


def test_every_queued_sample_is_read_and_other_packages_are_passed_over() -> None:
    message = bytes.fromhex("000a4d 02 6869 02 6d65 01")
    foreign = bytes.fromhex("014055 02") + SAMPLE[4:]
    flood = SAMPLE + message + foreign + LATER
    script = [VERSION, (CONTROLLER[0], message + CONTROLLER[1]), OUTPUTS, (START[0], message + START[1] + flood)]
    with scripted_server(30004, script) as (host, _):
        stream = opened(host)
        assert [sample.timestamp_s for sample in read_all(stream, 2)] == [2.0, 3.0]
        with pytest.raises(OSError, match="closed"):
            stream.read(2.0)
        stream.close()


def connected() -> tuple[RtdeStream, socket.socket]:
    """A stream to which recipe 1 has been promised, and the controller's end of its socket."""
    ours, theirs = socket.socketpair()
    theirs.settimeout(5.0)
    stream = RtdeStream.__new__(RtdeStream)
    stream._socket, stream._buffer, stream._recipe, stream._where = ours, bytearray(), 1, "here"
    return stream, theirs


@given(cuts=st.lists(st.integers(1, 2 * len(SAMPLE) - 1), max_size=8))
@settings(max_examples=50, deadline=None)
def test_packages_are_found_however_the_network_cuts_them(cuts) -> None:
    stream, theirs = connected()
    data = SAMPLE + LATER
    samples: list[RawSample] = []
    for begin, end in itertools.pairwise([0, *sorted(set(cuts)), len(data)]):
        theirs.sendall(data[begin:end])
        samples += stream.read(1.0)
    assert [sample.timestamp_s for sample in samples] == [2.0, 3.0]
    stream.close()
    theirs.close()


@pytest.mark.parametrize(
    "other",
    [
        bytes.fromhex("00034d"),  # a header without a payload
        bytes.fromhex("9c434d") + bytes(40_000),  # longer than a signed size
        bytes.fromhex("0004ff 01"),  # a type that no signed byte holds
    ],
)
def test_a_package_of_any_size_and_type_is_passed_over_whole(other: bytes) -> None:
    stream, theirs = connected()
    theirs.sendall(other + SAMPLE)
    assert [sample.timestamp_s for sample in read_all(stream, 1)] == [2.0]
    stream.close()
    theirs.close()


def test_a_size_below_the_headers_own_is_an_error() -> None:
    stream, theirs = connected()
    theirs.sendall(bytes.fromhex("000255"))
    with pytest.raises(ProtocolError, match="size of 2 bytes"):
        stream.read(2.0)
    stream.close()
    theirs.close()


def test_what_is_sent_has_an_unsigned_size_and_type() -> None:
    stream, theirs = connected()
    stream.send(0xFF, bytes(40_000))
    with theirs.makefile("rb") as heard:
        assert heard.read(3) == bytes.fromhex("9c43ff")
    stream.close()
    theirs.close()


def test_silence_gives_no_samples_and_does_not_last() -> None:
    stream, theirs = connected()
    assert stream.read(0.01) == []
    stream.close()
    theirs.close()


def test_a_sample_of_another_size_is_an_error_not_a_shift() -> None:
    with pytest.raises(ProtocolError, match="bytes"):
        decode(SAMPLE[3:-1], 1)


def test_a_variable_that_the_controller_does_not_know_is_named() -> None:
    kinds = KINDS.replace(b"VECTOR3D", b"NOT_FOUND")
    answer = bytes.fromhex("00694f 00") + kinds
    with (
        scripted_server(30004, [VERSION, CONTROLLER, (OUTPUTS[0], answer)]) as (host, _),
        pytest.raises(ProtocolError, match="payload_cog as NOT_FOUND"),
    ):
        opened(host)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_controller_that_stops_answering_is_absent(count) -> None:
    script = [VERSION, CONTROLLER, OUTPUTS][:count]
    with scripted_server(30004, script) as (host, _), pytest.raises(ArmAbsentError):
        opened(host)


def test_a_controller_whose_types_are_too_few_or_no_text_is_refused() -> None:
    for kinds, words in ((KINDS.rpartition(b",")[0], "does not send the state"), (b"\xff" + KINDS[1:], "timestamp as")):
        answer = struct.pack(">HB", 4 + len(kinds), ord("O")) + b"\x01" + kinds
        with (
            scripted_server(30004, [VERSION, CONTROLLER, (OUTPUTS[0], answer)]) as (host, _),
            pytest.raises(ProtocolError, match=words),
        ):
            opened(host)


def test_a_controller_that_does_not_start_is_refused() -> None:
    script = [VERSION, CONTROLLER, OUTPUTS, (START[0], bytes.fromhex("00045300"))]
    with scripted_server(30004, script) as (host, _), pytest.raises(ProtocolError, match="does not send the state"):
        opened(host)


def test_a_version_is_four_unsigned_numbers_whatever_follows_them() -> None:
    newer = bytes.fromhex("001776 00000005 0000000f 00000002 ffffffff 01020304")
    with scripted_server(30004, [VERSION, (CONTROLLER[0], newer)]) as (host, _):
        assert controller_version(host, 2.0) == (5, 15, 2, 0xFFFFFFFF)


def test_a_controller_that_accepts_and_says_nothing_is_absent_after_the_time_out() -> None:
    silent = [(VERSION[0] + b"more, which never comes", b"")]
    with scripted_server(30004, silent) as (host, _), pytest.raises(ArmAbsentError, match=f"{host}:30004 .*timed out"):
        RtdeStream(host, 0.05)


def test_where_no_controller_listens_the_address_is_named() -> None:
    host = own_address()
    with pytest.raises(ArmAbsentError, match=f"no robot controller answers at {host}:30004"):
        controller_version(host, 2.0)


def test_a_controller_that_refuses_the_protocol() -> None:
    with (
        scripted_server(30004, [(VERSION[0], bytes.fromhex("00045600"))]) as (host, _),
        pytest.raises(ArmAbsentError, match="RTDE 2"),
    ):
        RtdeStream(host, 2.0)
