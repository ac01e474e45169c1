"""``portdock model``: the user's own models from CAD and scans, found by name; bad input changes nothing."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from controller.cli.main import app
from controller.port_files import load_port
from controller.port_library import as_stl, library_folder
from controller.port_models import port_model
from perception.errors import DegenerateCloudError, PortdockError, UnknownPortError
from perception.geometry import Pose
from perception.mesh_io import read_mesh
from perception.port_solid import build_mesh
from perception.scan_mesh import mesh_from_points
from perception.surface import sample_mesh


@pytest.fixture(autouse=True)
def _library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORTDOCK_MODELS", str(tmp_path / "models"))


@pytest.fixture
def cad_mm(tmp_path: Path) -> Path:
    vertices, faces = build_mesh(load_port("nacs").shape)
    path = tmp_path / "inlet.stl"
    path.write_bytes(as_stl(vertices * 1e3, faces))
    return path


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["model", *map(str, arguments)])
    if isinstance(result.exception, PortdockError):
        return 2, result.exception.cause
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def test_cad_in_millimetres_becomes_a_model_found_by_name(cad_mm: Path) -> None:
    code, output = run("add", cad_mm, "--unit", "mm", "--name", "my-port", "--mated-depth-mm", 30)
    assert code == 0, output
    model = port_model("my-port")
    assert model.name == "my-port"
    assert model.T_port_tcp.translation[2] == pytest.approx(-0.030)
    bundled = port_model("nacs").surface.points
    assert np.allclose(model.surface.points.max(axis=0), bundled.max(axis=0), atol=1e-4)
    assert "my-port" in run("list")[1]


def test_a_pose_moves_the_cad_into_the_port_frame(cad_mm: Path, tmp_path: Path) -> None:
    T_file_port = Pose.from_rotvec([0.0, 0.0, np.pi / 2], [0.010, 0.0, 0.0])
    (tmp_path / "pose.json").write_text(json.dumps({"T": T_file_port.matrix.tolist()}))
    assert run("add", cad_mm, "--unit", "mm", "--name", "turned", "--pose", tmp_path / "pose.json")[0] == 0
    turned, _ = read_mesh(library_folder() / "turned.stl")
    straight, _ = read_mesh(cad_mm, "mm")
    assert np.allclose(np.ptp(turned, axis=0)[:2], np.ptp(straight, axis=0)[[1, 0]], atol=1e-6)


def test_a_scan_becomes_a_surface_on_its_points() -> None:
    vertices, faces = build_mesh(load_port("nacs").shape)
    points, normals = sample_mesh(vertices, faces, 0.0005)
    made, triangles = mesh_from_points(points[normals[:, 2] > 0.5])
    assert len(triangles) > 5000
    assert np.ptp(made[:, 0]) == pytest.approx(np.ptp(points[:, 0]), abs=0.002)


def test_too_few_points_are_no_model() -> None:
    with pytest.raises(DegenerateCloudError):
        mesh_from_points(np.random.default_rng(1).uniform(0, 0.05, (300, 3)))


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["--unit", "m", "--name", "x"], "measures"),
        (["--unit", "inch", "--name", "x"], "unknown length unit"),
        (["--unit", "mm", "--name", "../x"], "no name"),
        (["--unit", "mm", "--name", "ccs2"], "bundled"),
    ],
)
def test_bad_input_is_refused_and_stores_nothing(cad_mm: Path, arguments: list[str], cause: str) -> None:
    code, output = run("add", cad_mm, *arguments)
    assert code == 2
    assert cause in output
    assert not library_folder().exists()


def test_a_model_is_overwritten_only_on_request(cad_mm: Path) -> None:
    assert run("add", cad_mm, "--unit", "mm", "--name", "mine")[0] == 0
    assert "already" in run("add", cad_mm, "--unit", "mm", "--name", "mine")[1]
    assert run("add", cad_mm, "--unit", "mm", "--name", "mine", "--replace")[0] == 0


@pytest.mark.parametrize("content", [b"", b"not a mesh", b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"])
def test_broken_files_are_refused_with_a_cause(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad.ply").write_bytes(content)
    assert run("add", tmp_path / "bad.ply", "--unit", "mm", "--name", "bad")[0] == 2


def test_a_scan_without_the_port_frame_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "scan.npz", points=np.random.default_rng(1).uniform(0, 0.1, (5000, 3)))
    assert "where in it the port frame is" in run("add", tmp_path / "scan.npz", "--unit", "m", "--name", "s")[1]


def test_show_draws_a_picture(tmp_path: Path) -> None:
    code, output = run("show", "nacs", "--out", tmp_path / "nacs.png")
    assert code == 0
    assert "samples" in output
    assert (tmp_path / "nacs.png").read_bytes().startswith(b"\x89PNG")


def test_build_writes_every_bundled_port_as_its_description_says(tmp_path: Path) -> None:
    assert run("build", tmp_path / "meshes")[0] == 0
    built, _ = read_mesh(tmp_path / "meshes" / "type2.stl")
    assert len(list((tmp_path / "meshes").glob("*.stl"))) == 8
    assert np.ptp(built[:, 0]) == pytest.approx(0.084, abs=1e-5)


def test_an_unknown_name_is_answered_with_the_users_own_too(cad_mm: Path) -> None:
    run("add", cad_mm, "--unit", "mm", "--name", "mine")
    with pytest.raises(UnknownPortError) as caught:
        port_model("mein")
    assert "mine" in caught.value.remedy
