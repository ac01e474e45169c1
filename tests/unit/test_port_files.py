"""Port descriptions: what is read, and what is refused with a helpful word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from controller.port_files import PortFileError, bundled_ports, load_port, parse_port
from perception.errors import UnknownPortError
from perception.port_shape import Disc, Hull

MINIMAL = """
name: tiny
title: A tiny port
grade: M
teach_before_docking: true
mated_depth_mm: 20
capture_radius_mm: 1
capture_tilt_deg: 2
shape:
  rim: {disc: {diameter_mm: 50}}
  cavity: {outline: {disc: {diameter_mm: 40, flat_top_mm: 15}}, depth_mm: 30}
"""


def test_all_eight_ports_are_bundled_and_named_as_their_file() -> None:
    assert bundled_ports() == ("ccs1", "ccs2", "chademo", "gbt_ac", "gbt_dc", "j1772", "nacs", "type2")
    assert all(load_port(name).name == name == load_port(name).shape.name for name in bundled_ports())


def test_what_is_only_from_memory_must_be_taught_before_docking() -> None:
    for name in bundled_ports():
        port = load_port(name)
        assert port.teach_before_docking == (port.grade == "M"), name


def test_units_become_si() -> None:
    port = parse_port(MINIMAL, "tiny.yaml")
    assert port.mated_depth_m == pytest.approx(0.020)
    assert port.capture_tilt_rad == pytest.approx(np.deg2rad(2.0))
    assert port.shape.cavity.outline == Disc(0.04, (0.0, 0.0), 0.015)
    assert port.shape.cavity.depth_m == pytest.approx(0.030)


def test_mated_plug_points_into_the_vehicle() -> None:
    pose = load_port("type2").T_port_tcp
    assert pose.rotate(np.array([0.0, 0.0, 1.0])) == pytest.approx([0.0, 0.0, -1.0])
    assert pose.rotate(np.array([1.0, 0.0, 0.0])) == pytest.approx([1.0, 0.0, 0.0])
    assert pose.translation == pytest.approx([0.0, 0.0, -0.035])


def test_ccs2_holds_nine_contacts_and_a_hull() -> None:
    shape = load_port("ccs2").shape
    assert [contact.name for contact in shape.contacts] == ["PE", "N", "L1", "L2", "L3", "CP", "PP", "DC+", "DC-"]
    assert isinstance(shape.cavity.outline, Hull)


def test_a_description_of_ones_own_is_read_by_its_path(tmp_path: Path) -> None:
    (tmp_path / "tiny.yaml").write_text(MINIMAL)
    assert load_port(tmp_path / "tiny.yaml").name == "tiny"


def test_an_unknown_port_names_the_nearest() -> None:
    with pytest.raises(UnknownPortError, match=r"'typ2'.*'type2'") as error:
        load_port("typ2")
    assert "ccs2" in error.value.remedy


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("capture_radius_mm", "capture_radius_m", r"'capture_radius_m'; did you mean 'capture_radius_mm'"),
        ("diameter_mm: 50", "diametre_mm: 50", r"rim\.disc: unknown key 'diametre_mm'; did you mean 'diameter_mm'"),
        ("rim: {disc:", "rim: {disk:", r"unknown outline 'disk'; did you mean 'disc'"),
        ("depth_mm: 30", "depth_mm: deep", r"depth_mm: a number is wanted, not 'deep'"),
        ("depth_mm: 30", "depth_mm: .nan", r"a number is wanted"),
        ("depth_mm: 30", "depth_mm: true", r"a number is wanted"),
        ("depth_mm: 30", "depth_mm: 30000", r"more than 1000 mm"),
        ("grade: M", "grade: Z", r"'Z' is none of A, B, P, M"),
        ("teach_before_docking: true", "teach_before_docking: 3", r"bool is wanted, not 3"),
        ("mated_depth_mm: 20\n", "", r"mated_depth_mm is missing"),
        ("title: A tiny port", "title: [", r"is not YAML"),
        ("rim: {disc: {diameter_mm: 50}}", "rim: {hull: []}", r"a list of outlines is wanted"),
        ("rim: {disc: {diameter_mm: 50}}", "rim: {disc: {diameter_mm: 50, centre_mm: [1]}}", r"\[x, y\] is wanted"),
        (
            "  rim: {disc: {diameter_mm: 50}}\n",
            "  rim: {disc: {diameter_mm: 50}}\n  contacts: 3\n",
            r"a list is wanted",
        ),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_place(old: str, new: str, message: str) -> None:
    assert old in MINIMAL
    with pytest.raises(PortFileError, match=message) as error:
        parse_port(MINIMAL.replace(old, new), "tiny.yaml")
    assert "tiny.yaml" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "[]", "3", "shape: 3"])
def test_a_file_that_is_no_description_is_refused(text: str) -> None:
    with pytest.raises(PortFileError):
        parse_port(text, "odd.yaml")


def test_a_missing_or_binary_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PortFileError, match="cannot be read"):
        load_port(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(PortFileError, match="cannot be read"):
        load_port(tmp_path / "binary.yaml")
