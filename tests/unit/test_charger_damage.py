"""Damage never passes: every message, every scheme with a checksum, every field, flips, bursts, cuts and additions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.charger.contract import Codec, Contract, FrameError
from drivers.charger.e2e import Receiver, Scheme
from mocks.charger.checksum import fits

CONTRACTS = {scheme: Contract(scheme=scheme) for scheme in (Scheme.J1850, Scheme.P11, Scheme.P5)}
MESSAGES = [(scheme, codec.name) for scheme, contract in CONTRACTS.items() for codec in contract.codecs]
CASES = 100_000
HEADER = ("CRC8", "CRC16", "Counter")

Property = Callable[..., None]


@st.composite
def frames(draw: st.DrawFn, codec: Codec) -> tuple[bytes, dict[str, int]]:
    """A good frame with any raw value in every field, and those values."""
    values = {
        s.name: draw(
            st.integers(-(1 << s.length - 1) if s.is_signed else 0, (1 << s.length - (1 if s.is_signed else 0)) - 1)
        )
        for s in codec.message.signals
        if s.name not in HEADER
    }
    counter = draw(st.integers(0, codec.protection.scheme.counter_modulus - 1))
    return codec.encode_raw(counter, **values), values | {"Counter": counter}


@st.composite
def damaged(draw: st.DrawFn, codec: Codec) -> tuple[bytes, bytes]:
    """A good frame, and what became of it: one or two flipped bits, a burst of up to eight, a cut, an addition."""
    frame, _ = draw(frames(codec))
    bits = 8 * len(frame)
    number = int.from_bytes(frame, "little")
    match draw(st.sampled_from(["flip", "burst", "cut", "grow"])):
        case "flip":
            first, second = draw(st.integers(0, bits - 1)), draw(st.integers(0, bits))
            number ^= 1 << first
            number ^= 0 if second in (first, bits) else 1 << second
        case "burst":  # within eight bits as the checksum sees them: most significant bit of each byte first
            start = draw(st.integers(8 * codec.protection.scheme.crc_bytes, bits - 8))
            pattern = draw(st.integers(1, 255))
            whole = int.from_bytes(frame, "big") ^ pattern << (bits - 8 - start)
            return frame, whole.to_bytes(len(frame), "big")
        case "cut":
            return frame, frame[: draw(st.integers(0, len(frame) - 1))]
        case "grow":
            return frame, frame + draw(st.binary(min_size=1, max_size=64 - len(frame)))
    return frame, number.to_bytes(len(frame), "little")


def _accepted(codec: Codec, data: bytes) -> bool:
    """As the driver's receiving side decides, its counter just before this frame's."""
    try:
        counter = int(codec.decode(data)["Counter"])
    except FrameError:
        return False
    receiver = Receiver(codec.protection, previous=(counter - 1) % codec.protection.scheme.counter_modulus)
    return receiver.check(data, counter).accepted


def _damage_never_passes(scheme: Scheme, name: str, cases: int) -> None:
    codec = CONTRACTS[scheme][name]

    @settings(max_examples=cases, database=None)
    @given(damaged(codec))
    def never(case: tuple[bytes, bytes]) -> None:
        good, bad = case
        assert _accepted(codec, good)
        assert not _accepted(codec, bad)

    never()


@pytest.mark.parametrize(("scheme", "name"), MESSAGES)
def test_a_damaged_frame_is_never_accepted(scheme: Scheme, name: str) -> None:
    _damage_never_passes(scheme, name, 60)


@pytest.mark.long
@pytest.mark.parametrize(("scheme", "name"), MESSAGES)
def test_a_damaged_frame_is_never_accepted_in_a_hundred_thousand_cases(scheme: Scheme, name: str) -> None:
    _damage_never_passes(scheme, name, -(-CASES // len(MESSAGES)))


@pytest.mark.parametrize(("scheme", "name"), MESSAGES)
def test_every_field_comes_back_as_it_was_sent(scheme: Scheme, name: str) -> None:
    codec = CONTRACTS[scheme][name]

    @settings(max_examples=40, database=None)
    @given(frames(codec))
    def same(case: tuple[bytes, dict[str, int]]) -> None:
        frame, values = case
        raw: dict[str, Any] = codec.message.decode(frame, decode_choices=False, scaling=False)
        assert {key: raw[key] for key in values} == values
        assert len(frame) == codec.length

    same()


@pytest.mark.parametrize(("scheme", "name"), MESSAGES)
def test_the_mocks_own_checksum_agrees(scheme: Scheme, name: str) -> None:
    codec = CONTRACTS[scheme][name]

    @settings(max_examples=20, database=None)
    @given(frames(codec))
    def agrees(case: tuple[bytes, dict[str, int]]) -> None:
        assert fits(case[0], scheme.value, codec.protection.data_id)

    agrees()


@given(st.binary(max_size=64))
@example(b"")
def test_whatever_comes_is_judged_without_a_crash(data: bytes) -> None:
    for contract in CONTRACTS.values():
        for codec in contract.codecs:
            _accepted(codec, data)
