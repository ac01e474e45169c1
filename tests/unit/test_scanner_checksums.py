import zlib

import numpy as np
import pytest
from crccheck.crc import Crc8Smbus, Crc16CcittFalse, CrcModbus
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.frame_format import Checksum
from drivers.scanner.checksums import _crc_function, checksum_function

CRC16_FALSE = Checksum("crc16", poly=0x1021, init=0xFFFF)
CRC16_MODBUS = Checksum("crc16", poly=0x8005, init=0xFFFF, reflected=True)
CRC32 = Checksum("crc32", poly=0x04C11DB7, init=0xFFFFFFFF, xor_out=0xFFFFFFFF, reflected=True)
CRC8 = Checksum("crc8", poly=0x07)


@pytest.fixture(autouse=True)
def _fresh_tables() -> None:
    """Tables are kept for the life of the process; here each test makes its own."""
    _crc_function.cache_clear()


def of(checksum: Checksum, *messages: bytes) -> list[int]:
    frames = np.frombuffer(b"".join(messages), np.uint8).reshape(len(messages), -1)
    return checksum_function(checksum, frames.shape[1])(frames).tolist()


@pytest.mark.parametrize(
    ("checksum", "expected"),
    [
        # check values of "123456789" in R. Williams' catalogue
        (CRC8, 0xF4),
        (CRC16_FALSE, 0x29B1),
        (CRC16_MODBUS, 0x4B37),
        (CRC32, 0xCBF43926),
        (Checksum("crc32", poly=0x04C11DB7, init=0xFFFFFFFF), 0x0376E6E7),  # CRC-32/MPEG-2
        (Checksum("sum8"), sum(b"123456789") & 0xFF),
        (Checksum("xor8"), 0x31),
        (Checksum("none"), 0),
    ],
)
def test_check_values_of_the_catalogue(checksum: Checksum, expected: int) -> None:
    assert of(checksum, b"123456789") == [expected]


@settings(max_examples=200, deadline=None)
@given(st.binary(min_size=1, max_size=60))
def test_any_message_agrees_with_independent_implementations(message: bytes) -> None:
    assert of(CRC32, message) == [zlib.crc32(message)]
    assert of(CRC8, message) == [Crc8Smbus.calc(message)]
    assert of(CRC16_MODBUS, message) == [CrcModbus.calc(message)]
    assert of(CRC16_FALSE, message) == [Crc16CcittFalse.calc(message, initvalue=0xFFFF)]


def test_a_batch_gives_each_frame_its_own_checksum() -> None:
    messages = [bytes([k, 7, 255 - k]) for k in range(5)]
    assert of(CRC32, *messages) == [zlib.crc32(message) for message in messages]


@pytest.mark.parametrize("length", [1, 2, 3, 300])
def test_frames_of_any_length_have_their_checksum(length: int) -> None:
    message = bytes(k % 251 for k in range(length))
    assert of(CRC8, message) == [Crc8Smbus.calc(message)]
    assert of(CRC16_MODBUS, message) == [CrcModbus.calc(message)]
    assert of(CRC16_FALSE, message) == [Crc16CcittFalse.calc(message)]
    assert of(Checksum("sum8"), message) == [sum(message) % 256]
    assert of(Checksum("crc32", poly=0x04C11DB7, init=0xFFFFFFFF, reflected=True), message) == [
        zlib.crc32(message) ^ 0xFFFFFFFF
    ]


def test_two_frames_have_a_sum_and_a_parity_each() -> None:
    assert of(Checksum("sum8"), b"\xff\x02\x03", b"\x01\x01\x01") == [4, 3]
    assert of(Checksum("xor8"), b"\xff\x02\x03", b"\x01\x01\x01") == [0xFE, 1]
    assert of(Checksum("none"), b"\xff\x02\x03", b"\x01\x01\x01") == [0, 0]


def test_where_the_covered_bytes_begin_does_not_change_the_sum_over_them() -> None:
    shifted = Checksum("crc16", from_byte=4, poly=0x1021, init=0xFFFF)
    assert of(shifted, b"123456789") == [0x29B1]


def test_the_checksum_of_zip_is_left_to_the_standard_library() -> None:
    """It needs no table of ours, and takes a fraction of the time."""
    of(CRC32, b"123456789")
    assert _crc_function.cache_info().misses == 0
    of(CRC16_FALSE, b"123456789")
    assert _crc_function.cache_info().misses == 1
