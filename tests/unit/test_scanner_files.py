import math
from pathlib import Path

import pytest

from controller.scanner_files import ScannerFileError, bundled_scanners, load_scanner, parse_scanner
from perception.errors import PortdockError

MINIMAL = """
name: tiny
baud_rate: 115200
profile_rate_hz: 10
range_noise_um: 50
sync: "AA"
byte_order: big
points:
  {layout: z, count: 3, item: [{name: z, type: u16}], z: {scale_um: 10, offset_mm: 20}, x_start_mm: -1, x_step_um: 500}
"""


def test_every_bundled_description_is_valid() -> None:
    assert {"wide_xz", "ld19"} <= set(bundled_scanners())
    for name in bundled_scanners():
        assert load_scanner(name).name == name


def test_units_in_keys_become_si() -> None:
    description = parse_scanner(MINIMAL, "tiny.yaml")
    assert description.range_noise_m == pytest.approx(50e-6)
    points = description.layout.points
    assert (points.scaling.scale_m, points.scaling.offset_m) == (pytest.approx(1e-5), pytest.approx(0.02))
    assert (points.x_start_m, points.x_step_m) == (pytest.approx(-1e-3), pytest.approx(5e-4))
    assert description.layout.size == 7


def test_the_lidars_angle_unit_is_a_hundredth_of_a_degree() -> None:
    assert load_scanner("ld19").layout.points.angle_unit_rad == pytest.approx(math.radians(0.01))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("sync:", "synk:"), "sync"),
        (('"AA"', '"A"'), "hexadecimal"),
        (('"AA"', "170"), "hexadecimal"),
        (("count: 3", "count: 0"), "points.count"),
        (("baud_rate: 115200", "baud_rate: 0"), "baud_rate"),
        (("type: u16", "type: u12"), "points.item.0.type"),
        (("x_step_um: 500", "x_step_um: 0"), "x_step_um"),
        (("layout: z", "layout: xz"), "scaling"),
        (("{name: z", "{name: y"), "need the items"),
        (("name: tiny", "name: [tiny"), "not YAML"),
        (("byte_order: big", "clock: {field: t, unit_us: 1, modulus: 65536}\nbyte_order: big"), "'t'"),
        (("byte_order: big", "checksum: {algorithm: crc8, from_byte: 99}\nbyte_order: big"), "checksum"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(change: tuple[str, str], said: str) -> None:
    with pytest.raises(ScannerFileError, match=r"tiny\.yaml") as caught:
        parse_scanner(MINIMAL.replace(*change), "tiny.yaml")
    assert said in caught.value.cause
    assert "\n" not in caught.value.cause
    assert caught.value.remedy


@pytest.mark.parametrize("text", ["", "3", "[]", "a: b"])
def test_a_file_of_something_else_is_refused(text: str) -> None:
    with pytest.raises(ScannerFileError):
        parse_scanner(text, "other.yaml")


def test_missing_and_binary_files_are_refused_with_the_bundled_names(tmp_path: Path) -> None:
    with pytest.raises(PortdockError, match="no scanner description") as caught:
        load_scanner(str(tmp_path / "none.yaml"))
    assert "wide_xz" in caught.value.remedy
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScannerFileError, match="text"):
        load_scanner(str(tmp_path / "binary.yaml"))
