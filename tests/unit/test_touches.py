"""``portdock calibrate tcp --touches``: poses written down from the pendant become a tool, or are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from controller.calibrations.store import CalibrationStore
from controller.calibrations.touches import read_touches
from controller.cli.main import app
from perception.errors import InputError

TIP_M = np.array([0.6, 0.1, 0.3])
TOOL_M = np.array([0.0007, -0.0004, 0.2012])
FOLDER = Path("portdock-calibrations")


def rows(count: int, turn: float = 0.7) -> list[list[float]]:
    """As the pendant shows them: millimetres and radians, rounded to its digits."""
    rng = np.random.default_rng(3)
    found = []
    for rotvec in rng.uniform(-turn, turn, (count, 3)):
        place = 1e3 * (TIP_M - Rotation.from_rotvec(rotvec).as_matrix() @ TOOL_M)
        found.append([*place.round(2).tolist(), *rotvec.round(4).tolist()])
    return found


def calibrate(values: object, *more: str) -> tuple[int, str]:
    Path("touches.yaml").write_text(yaml.safe_dump(values))
    result = CliRunner().invoke(app, ["calibrate", "tcp", "--touches", "touches.yaml", *more])
    return result.exit_code, f"{result.output} {result.exception}"


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_touches_put_a_tool_in_force_that_show_and_budget_know() -> None:
    code, told = calibrate({"flange_mm_rad": rows(8)})
    assert code == 0, told
    tool = CalibrationStore(FOLDER).in_force("tool")
    assert np.abs(tool.pose.translation - TOOL_M).max() < 2e-4
    assert tool.made_with is None
    assert 0.0 < tool.sigma_mm < 0.2
    assert "T_flange_tcp: 0." in CliRunner().invoke(app, ["calibrate", "show"]).output
    (row,) = [line for line in CliRunner().invoke(app, ["calibrate", "budget"]).output.splitlines() if "tool" in line]
    assert row.endswith("its covariance |")


def test_a_point_beside_the_tcp_is_counted_back_to_it() -> None:
    code, told = calibrate({"flange_mm_rad": rows(8), "point_mm": [0.0, 0.0, 1.2]})
    assert code == 0, told
    assert CalibrationStore(FOLDER).in_force("tool").pose.translation[2] == pytest.approx(0.2, abs=2e-4)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        (rows(3), "3 touches are too few"),
        (rows(8, turn=0.01), "too much alike"),
        ([*rows(7), [a + b for a, b in zip(rows(8)[7], [0, 6, 0, 0, 0, 0], strict=True)]], "touch 8 is"),
    ],
)
def test_poor_touches_are_refused_and_the_old_tool_stays_in_force(values: list[list[float]], why: str) -> None:
    calibrate({"flange_mm_rad": rows(8)})
    before = CalibrationStore(FOLDER).path_in_force("tool")
    code, told = calibrate({"flange_mm_rad": values})
    assert code != 0
    assert why in told
    assert CalibrationStore(FOLDER).path_in_force("tool") == before


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "no key 'flange_mm_rad'"),
        ("[1]", "no key 'flange_mm_rad'"),
        ("flange_mm: [[1, 2, 3, 0, 0, 0]]", "no key 'flange_mm_rad'"),
        ("{flange_mm_rad: [[900, 0, 0, 0, 0, 0]], point: [0, 0, 0]}", "'point' is not known"),
        ("flange_mm_rad: 5", "six finite numbers"),
        ("flange_mm_rad: [[1, 2, 3]]", "six finite numbers"),
        ("flange_mm_rad: [[.nan, 0, 0, 0, 0, 0]]", "six finite numbers"),
        ("flange_mm_rad: [[0.9, 0.1, 0.4, 0, 0, 0]]", "no arm reaches like that"),
        ("{", "is no YAML file"),
    ],
)
def test_a_file_without_touches_is_refused_with_the_reason(text: str, why: str) -> None:
    Path("touches.yaml").write_text(text)
    with pytest.raises(InputError, match=why):
        read_touches(Path("touches.yaml"))
