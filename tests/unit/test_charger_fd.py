"""The CAN FD variant: one frame for the pose, a 16-bit checksum and an 8-bit counter."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.base import ChargerRequest, ChargerState, DockPose, Heartbeat, PlugLock
from drivers.charger import messages
from drivers.charger.contract import Contract, bundled_dbc
from drivers.charger.e2e import Receiver, Scheme, Verdict
from mocks.charger.checksum import fits
from perception.errors import InputError
from perception.geometry import Pose

CONTRACT = Contract(scheme=Scheme.P5)
HEARTBEAT = bytes.fromhex("82 1E C8 02 07 ED 01 34 12 00 00 00")
COMMAND = bytes.fromhex("AD CF 0E 04 2A 7D 00 00")
POSE = bytes.fromhex("44 08 07 11 39 65 0C 00 5C 69 FE FF 4A 83 28 00 00 40 00 C0 00 40 00 40 1F C0 17 BB 32 C8 00 00")
STATUS = bytes.fromhex("AE 9B FF 06 92 0A 2A 02 00 00 00 00")
ELECTRICAL = bytes.fromhex("A6 E7 09 D0 0F 83 FF 55 7D 00 00 00")
LITERALS = {
    "RC_Heartbeat": (HEARTBEAT, 0xFF10),
    "RC_Command": (COMMAND, 0xFF11),
    "RC_DockPose": (POSE, 0xFF15),
    "CH_Status": (STATUS, 0xFF20),
    "CH_Electrical": (ELECTRICAL, 0xFF21),
}


def _pose(turn: Rotation, xyz: tuple[float, ...] = (0.812345, -0.1041, 2.65505)) -> DockPose:
    return DockPose(Pose(turn.as_matrix(), np.array(xyz)), 0.000155, 0.935, 0.001, 10.0)


def test_the_bundled_file_is_all_can_fd() -> None:
    assert CONTRACT.is_fd
    assert all(codec.is_fd for codec in CONTRACT.codecs)
    assert CONTRACT.pose_names == ("RC_DockPose",)


def test_literal_frames() -> None:
    beat = Heartbeat(mode=2, state=7, flags=0x01ED, cycle_id=0x1234)
    assert messages.encode_heartbeat(CONTRACT["RC_Heartbeat"], 200, beat) == HEARTBEAT
    turn = Rotation.from_quat([-0.5, 0.5, 0.5, 0.5])
    assert messages.encode_pose(CONTRACT, 7, 200, _pose(turn), now_s=10.38) == [POSE]
    status = messages.decode_status(CONTRACT["CH_Status"], STATUS)
    assert (status.state, status.lock, status.ack_sequence) == (ChargerState.CHARGING, PlugLock.LOCKED, 42)
    asked = messages.encode_command(CONTRACT["RC_Command"], 14, ChargerRequest.ENABLE_POWER, 42, 125)
    assert asked == COMMAND
    values = messages.decode_electrical(CONTRACT["CH_Electrical"], ELECTRICAL)
    assert (values.voltage_v, values.current_a) == pytest.approx((404.8, -12.5))
    assert (values.temperature_c, values.charge_percent) == (35, 62.5)


def test_every_message_has_its_literal() -> None:
    assert set(LITERALS) == {codec.name for codec in CONTRACT.codecs}


@pytest.mark.parametrize(("frame", "data_id"), LITERALS.values())
def test_checksums_agree_with_the_mocks_own(frame: bytes, data_id: int) -> None:
    assert fits(frame, "e2e-p5", data_id)


def test_every_flip_of_one_or_two_bits_of_a_pose_is_noticed() -> None:
    protection = CONTRACT["RC_DockPose"].protection
    whole = int.from_bytes(POSE, "big")
    for one, two in itertools.combinations_with_replacement(range(256), 2):
        mask = 1 << one | 1 << two
        assert not protection.intact((whole ^ mask).to_bytes(32, "big"))


def test_the_counter_runs_through_all_of_its_byte() -> None:
    receiver = Receiver(CONTRACT["CH_Status"].protection)
    codec = CONTRACT["CH_Status"]
    values = {k: v for k, v in codec.decode(STATUS).items() if k not in ("CRC16", "Counter")}
    verdicts = [receiver.check(codec.encode(k % 256, **values), k % 256) for k in range(254, 259)]
    assert verdicts == [Verdict.INITIAL] + [Verdict.OK] * 4


_METRES = st.floats(-100.0, 100.0)


@given(st.tuples(_METRES, _METRES, _METRES), st.integers(0, 2**32))
def test_any_pose_comes_back_within_half_a_bit(xyz: tuple[float, ...], seed: int) -> None:
    turn = Rotation.random(random_state=seed % 2**32)
    values = CONTRACT["RC_DockPose"].decode(messages.encode_pose(CONTRACT, 0, 0, _pose(turn, xyz), 10.0)[0])
    assert np.abs([values[k] / 1e3 - v for k, v in zip("XYZ", xyz, strict=True)]).max() < 0.6e-6
    back = Rotation.from_quat([values[k] for k in ("QX", "QY", "QZ", "QW")])
    assert (back * turn.inv()).magnitude() < 1e-4
    assert values["QW"] >= 0


def test_a_withdrawn_pose_has_no_coordinates_and_no_age() -> None:
    (frame,) = messages.encode_no_pose(CONTRACT, 3, 256 + 9)
    none = "03 00" + "00 00 00 80" * 3 + "00 80" * 4 + "00 F0 FF 00 00 09 00 00"
    assert frame[2:] == bytes.fromhex(none)
    assert fits(frame, "e2e-p5", 0xFF15)


def test_a_poses_sequence_starts_again_after_a_byte() -> None:
    turn = Rotation.from_quat([-0.5, 0.5, 0.5, 0.5])
    assert messages.encode_pose(CONTRACT, 7, 256 + 200, _pose(turn), now_s=10.38) == [POSE]


def test_a_quaternion_has_a_positive_real_part_whatever_the_turn() -> None:
    for turn in (Rotation.from_rotvec([0.0, 0.0, 3.5]), Rotation.from_rotvec([-3.2, 0.0, 0.0])):
        (frame,) = messages.encode_pose(CONTRACT, 0, 0, _pose(turn), 10.0)
        values = CONTRACT["RC_DockPose"].decode(frame)
        assert values["QW"] >= 0
        assert (Rotation.from_quat([values[k] for k in ("QX", "QY", "QZ", "QW")]) * turn.inv()).magnitude() < 1e-4


def test_the_classic_file_lacks_what_this_scheme_needs_and_says_so() -> None:
    with pytest.raises(InputError, match=r"CH_Status\.CRC16"):
        Contract(bundled_dbc(), Scheme.P5)
