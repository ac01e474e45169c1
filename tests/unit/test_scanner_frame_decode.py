"""Raw numbers of a frame become metres in the laser plane, whichever way the device writes them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.frame_format import Field, FrameFormat, PointArray, Scaling
from drivers.scanner.frame_decode import decode_points

X, Z, RANGE, LIGHT = Field("x", "i16"), Field("z", "u16"), Field("range", "u16"), Field("intensity", "u8")
ANGLES = (Field("first", "u16"), Field("last", "u16"))


def frames(layout: FrameFormat, *octets: str) -> Any:
    return np.frombuffer(bytes.fromhex("".join(octets)), layout.dtype)


def polar(count: int, **changes: Any) -> FrameFormat:
    values: dict[str, Any] = {"first_angle": "first", "last_angle": "last", "angle_unit_rad": np.deg2rad(0.01)}
    points = PointArray("polar", count, (RANGE,), Scaling(1e-3), (0,), **values | changes)
    return FrameFormat(b"\xaa", "big", ANGLES, points)


def test_both_coordinates_of_a_pair_have_their_own_scale_and_offset() -> None:
    points = PointArray("xz", 2, (X, Z), Scaling(1e-4, 0.1), (0xFFFF, 0), x_scaling=Scaling(1e-3, -0.05))
    xz, valid, light = decode_points(
        frames(FrameFormat(b"\xaa", "big", (), points), "AA FFFF 0100 0002 FFFF", "AA 0003 0000 0004 0001"),
        FrameFormat(b"\xaa", "big", (), points),
    )
    np.testing.assert_allclose(xz[0, 0], [-0.051, 0.1256])
    np.testing.assert_allclose(xz[1], [[-0.047, 0.1], [-0.046, 0.1001]])
    assert valid.tolist() == [[True, False], [False, True]]
    assert light is None


def test_depths_alone_stand_on_a_grid() -> None:
    points = PointArray("z", 3, (Z, LIGHT), Scaling(1e-3, 0.2), x_start_m=-0.01, x_step_m=0.004)
    layout = FrameFormat(b"\xaa", "big", (), points)
    xz, valid, light = decode_points(frames(layout, "AA 0001 07 0002 08 0003 FF", "AA 0004 00 0005 01 0006 02"), layout)
    np.testing.assert_allclose(xz[0], [[-0.010, 0.201], [-0.006, 0.202], [-0.002, 0.203]])
    np.testing.assert_allclose(xz[1, :, 0], [-0.010, -0.006, -0.002])
    assert valid.all()
    assert valid.shape == (2, 3)
    assert light is not None
    assert light.dtype == np.float64
    assert light.tolist() == [[7, 8, 255], [0, 1, 2]]


def test_a_depth_that_is_no_number_was_not_measured() -> None:
    points = PointArray("z", 3, (Field("z", "f32"),), Scaling(1.0))
    layout = FrameFormat(b"\xaa", "big", (), points)
    _, valid, _ = decode_points(frames(layout, "AA 3F800000 7FC00000 7F800000"), layout)
    assert valid.tolist() == [[True, False, False]]


@pytest.mark.parametrize(
    ("octets", "changes", "degrees"),
    [
        ("AA 0000 2328 03E8 03E8 03E8", {}, [0, 45, 90]),  # 0 to 90 degrees, 1000 mm
        ("AA 88B8 03E8 03E8 03E8 03E8", {}, [350, 0, 10]),  # 350 degrees, on through 0, to 10
        ("AA 0000 2328 03E8 03E8 03E8", {"angle_sign": -1}, [0, -45, -90]),
        ("AA 0000 2328 03E8 03E8 03E8", {"angle_offset_rad": np.deg2rad(30.0)}, [30, 75, 120]),
        ("AA 03E8 0BB8 03E8 03E8 03E8", {"angle_sign": -1, "angle_offset_rad": np.deg2rad(5.0)}, [-5, -15, -25]),
    ],
)
def test_ranges_stand_at_even_angles_from_the_first_to_the_last(
    octets: str, changes: dict[str, Any], degrees: list[float]
) -> None:
    layout = polar(3, **changes)
    xz, valid, _ = decode_points(frames(layout, octets), layout)
    angles = np.deg2rad(degrees)
    np.testing.assert_allclose(xz[0], np.stack([np.sin(angles), np.cos(angles)], axis=1), atol=1e-12)
    assert valid.all()


def test_each_frame_of_a_batch_has_its_own_angles_and_nothing_measured_is_said_so() -> None:
    layout = polar(2)
    xz, valid, _ = decode_points(frames(layout, "AA 0000 2328 03E8 0000", "AA 2328 4650 07D0 03E8"), layout)
    np.testing.assert_allclose(xz[:, 0], [[0.0, 1.0], [2.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(xz[1, 1], [0.0, -1.0], atol=1e-12)
    assert valid.tolist() == [[True, False], [True, True]]


def test_a_single_range_stands_at_the_first_angle() -> None:
    layout = polar(1)
    xz, _, _ = decode_points(frames(layout, "AA 2328 4650 03E8"), layout)
    np.testing.assert_allclose(xz[0, 0], [1.0, 0.0], atol=1e-12)


def test_a_range_has_an_offset_too() -> None:
    points = PointArray("polar", 1, (RANGE,), Scaling(1e-3, 0.5), (), first_angle="first", last_angle="last")
    layout = FrameFormat(b"\xaa", "big", ANGLES, points)
    xz, _, _ = decode_points(frames(layout, "AA 0000 0000 03E8"), layout)
    np.testing.assert_allclose(xz[0, 0], [0.0, 1.5])
