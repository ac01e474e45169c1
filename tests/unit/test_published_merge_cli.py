"""``portdock merge``: two scan files in, one cloud out, nothing half-written when it fails."""

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from controller.cli.merge import merge
from perception.cloud_io import read_cloud
from perception.errors import InputError
from perception.geometry import Pose
from tests.unit.test_published_locate_cli import unusable
from tests.unit.test_published_pipeline import inlet

app = typer.Typer()
app.command()(merge)
SECOND = Pose.from_rotvec([0.05, -0.03, 0.04], [0.004, -0.003, 0.006])


@pytest.fixture
def scans(tmp_path):
    paths = []
    for k, pose in enumerate((Pose.identity(), SECOND)):
        points = inlet(np.random.default_rng(k), 9000) / 1e3
        paths.append(tmp_path / f"view-{k}.npz")
        np.savez(paths[-1], points=pose.apply(points))
    return paths


@pytest.mark.parametrize("kind", ["ply", "npz"])
def test_two_scans_become_one_cloud_in_the_first_ones_frame(scans, tmp_path, kind):
    out = tmp_path / f"merged.{kind}"
    result = CliRunner().invoke(app, [*map(str, scans), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "overlap" in result.output
    merged = read_cloud(out).points
    assert len(merged) == 18_000
    first, second = read_cloud(scans[0]).points, SECOND.inverse().apply(read_cloud(scans[1]).points)
    assert np.abs(merged[:9000] - first).max() < 1e-6
    assert np.linalg.norm(merged[9000:] - second, axis=1).max() < 0.0008


def test_a_file_that_cannot_be_written_is_refused_before_any_work(scans, tmp_path):
    for name in ("merged.stl", "absent/merged.ply"):
        result = CliRunner().invoke(app, [*map(str, scans), "--out", str(tmp_path / name)])
        assert isinstance(result.exception, InputError)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["view-0.npz", "view-1.npz"]


def test_one_scan_alone_is_refused(scans, tmp_path):
    result = CliRunner().invoke(app, [str(scans[0]), "--out", str(tmp_path / "merged.ply")])
    assert isinstance(result.exception, InputError)
    assert not (tmp_path / "merged.ply").exists()


@pytest.mark.parametrize("bad", ["planar", "collinear", "identical", "nan", "empty", "millimetres", "fewer-than-k"])
def test_a_scan_that_cannot_be_merged_is_named_and_nothing_is_written(scans, tmp_path, bad):
    np.savez(scans[1], points=unusable()[bad])
    result = CliRunner().invoke(app, [*map(str, scans), "--out", str(tmp_path / "merged.ply")])
    assert isinstance(result.exception, InputError)
    assert result.exception.cause
    assert not (tmp_path / "merged.ply").exists()
