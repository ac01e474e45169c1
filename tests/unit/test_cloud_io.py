"""Scan files: every format gives the same cloud, and every kind of broken file gives a plain error."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perception.cloud_io import read_cloud
from perception.errors import EmptyScanError, InputError, PortdockError, ScanFileError, UnitError
from perception.ply import parse_ply

POINTS = np.random.default_rng(1).uniform(-0.1, 0.1, (400, 3)).astype(np.float32).astype(np.float64)


def write_ply(path: Path, points: np.ndarray, order: str = "<") -> Path:
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = f"ply\nformat {name} 1.0\nelement vertex {len(points)}\n"
    header += "property float x\nproperty float y\nproperty float z\nend_header\n"
    path.write_bytes(header.encode() + points.astype(order + "f4").tobytes())
    return path


def write_pcd(path: Path, points: np.ndarray, data: str) -> Path:
    header = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
    header += f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA {data}\n"
    table = np.column_stack([points, np.ones(len(points))]).astype("<f4")
    body = (
        table.tobytes() if data == "binary" else "\n".join(" ".join(map(repr, map(float, r))) for r in table).encode()
    )
    path.write_bytes(header.encode() + body)
    return path


def write_as(path: Path, points: np.ndarray) -> Path:
    if path.suffix == ".ply":
        return write_ply(path, points, ">" if "big" in path.stem else "<")
    if path.suffix == ".pcd":
        return write_pcd(path, points, "binary" if "binary" in path.stem else "ascii")
    if path.suffix == ".npz":
        np.savez(path, points=points)
    else:
        np.savetxt(path, points, fmt="%.9g")
    return path


@pytest.mark.parametrize("name", ["a.ply", "big.ply", "binary.pcd", "text.pcd", "a.xyz", "a.npz"])
def test_every_format_gives_the_same_cloud(tmp_path: Path, name: str) -> None:
    cloud = read_cloud(write_as(tmp_path / name, POINTS))
    assert np.abs(cloud.points - POINTS).max() < 1e-8
    assert cloud.frame == "scanner"


def test_millimetres_become_metres(tmp_path: Path) -> None:
    cloud = read_cloud(write_ply(tmp_path / "a.ply", POINTS * 1000), "mm")
    assert np.abs(cloud.points - POINTS).max() < 1e-7


@pytest.mark.parametrize("factor", [1000.0, 0.001])
def test_a_unit_that_is_off_by_a_thousand_is_refused_with_the_option_to_use(tmp_path: Path, factor: float) -> None:
    with pytest.raises(UnitError) as caught:
        read_cloud(write_ply(tmp_path / "a.ply", POINTS * factor))
    assert "--scan-unit" in caught.value.remedy


def test_points_that_are_not_finite_are_dropped_and_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    points = POINTS.copy()
    points[3, 1], points[5, 0] = np.nan, np.inf
    cloud = read_cloud(write_ply(tmp_path / "a.ply", points))
    assert len(cloud) == len(POINTS) - 2
    assert "2 of 400" in caplog.text


@pytest.mark.parametrize("content", [b"", b"nan nan nan\n", b"0.1 0.2 0.3\n0.2 0.2 0.3\n", b"# nothing\n"])
def test_too_few_points_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.xyz").write_bytes(content)
    with pytest.raises(EmptyScanError):
        read_cloud(tmp_path / "a.xyz")


def test_a_missing_file_an_unknown_type_and_a_folder_are_told_plainly(tmp_path: Path) -> None:
    (tmp_path / "folder.ply").mkdir()
    for name in ("missing.ply", "scan.docx", "folder.ply"):
        with pytest.raises(ScanFileError) as caught:
            read_cloud(tmp_path / name)
        assert "\n" not in caught.value.cause


def test_a_cut_off_file_is_refused(tmp_path: Path) -> None:
    path = write_ply(tmp_path / "a.ply", POINTS)
    path.write_bytes(path.read_bytes()[:-7])
    with pytest.raises(ScanFileError):
        read_cloud(path)


@given(st.binary(max_size=300), st.sampled_from([".ply", ".pcd", ".xyz", ".npz"]))
def test_arbitrary_bytes_never_give_anything_but_an_input_error(tmp_path_factory, data: bytes, suffix: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path_factory.mktemp("any") / f"scan{suffix}"
    head = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n" if suffix == ".ply" else b""
    path.write_bytes(head + data)
    with pytest.raises(PortdockError) as caught:
        read_cloud(path)
    assert isinstance(caught.value, InputError)


def test_a_ply_mesh_with_quads_comes_back_as_triangles() -> None:
    text = b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    text += (
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"
    )
    vertices, faces = parse_ply(text)
    assert vertices.shape == (4, 3)
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3]]
