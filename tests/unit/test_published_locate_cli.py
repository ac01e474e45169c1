"""``portdock locate --method``: whatever a scan file holds, a profile never claims a pose that the scan cannot fix."""

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from controller.cli.locate import locate
from perception.errors import InputError

app = typer.Typer()
app.command()(locate)
AHEAD = np.array([0.0, 0.0, 0.3])
N = 3000


def unusable() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    box = rng.uniform(-0.06, 0.06, (N, 3)) + AHEAD
    return {
        "millimetres": box * 1e3,
        "nan": np.full((N, 3), np.nan),
        "empty": np.empty((0, 3)),
        "planar": box * [1.0, 1.0, 0.0] + AHEAD,
        "collinear": np.outer(rng.uniform(-0.06, 0.06, N), [1.0, 0.5, 0.2]) + AHEAD,
        "identical": np.tile(AHEAD, (N, 1)),
        "fewer-than-k": box[:30],
    }


@pytest.fixture(scope="module")
def prior(tmp_path_factory):
    path = tmp_path_factory.mktemp("prior") / "prior.json"
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = AHEAD
    path.write_text(json.dumps({"prior": pose.tolist()}))
    return path


@pytest.mark.parametrize("method", ["literal", "faithful", "robust"])
@pytest.mark.parametrize("name", list(unusable()))
def test_an_unusable_scan_is_refused_with_its_reason(method, name, prior, tmp_path):
    scan = tmp_path / f"{name}.npz"
    np.savez(scan, points=unusable()[name])
    arguments = [str(scan), "--model", "ccs2", "--prior", str(prior), "--method", method, "--json"]
    result = CliRunner().invoke(app, arguments)
    if isinstance(result.exception, InputError):  # the command line ends with two lines and exit code 2
        assert result.exception.cause
        assert result.exception.remedy
        assert result.output == ""
        return
    assert result.exit_code == 1, result.output
    answer = json.loads(result.output)
    assert not answer["ok"]
    assert answer["verdict"] == "no-port"
    assert all(answer["reasons"])


def test_the_published_method_takes_one_model(prior, tmp_path):
    scan = tmp_path / "scan.npz"
    np.savez(scan, points=np.random.default_rng(1).uniform(-0.06, 0.06, (N, 3)) + AHEAD)
    result = CliRunner().invoke(app, [str(scan), "--model", "ccs2,type2", "--method", "robust"])
    assert isinstance(result.exception, InputError)
