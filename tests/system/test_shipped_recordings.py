"""The recordings that ship with portdock, through ``portdock locate``: accepted or refused as written beside them."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from controller.cli.main import app
from perception.evaluation.recorded_set import RECORDED_SCENES, RecordedScene
from perception.geometry import Pose

FOLDER = Path(str(resources.files("mocks.recordings")))


@pytest.mark.parametrize("scene", RECORDED_SCENES, ids=lambda scene: scene.name)
def test_locating_in_a_shipped_recording_gives_what_is_written_beside_it(scene: RecordedScene) -> None:
    wanted = json.loads((FOLDER / f"{scene.name}.json").read_text("utf-8"))
    assert (wanted["model"], wanted["accepted"]) == (scene.model, scene.accepted)
    prior = ["--prior", str(FOLDER / f"{scene.name}.json")]
    ran = CliRunner().invoke(
        app, ["locate", str(FOLDER / f"{scene.name}.npz"), "--model", wanted["model"], *prior, "--json"]
    )
    assert ran.exit_code == (0 if wanted["accepted"] else 1), ran.output
    found = json.loads(ran.stdout)
    assert found["ok"] is wanted["accepted"], found["reasons"]
    assert found["reasons"]
    if wanted["accepted"]:
        truth, pose = Pose.from_matrix(wanted["T_scanner_port"]), Pose.from_matrix(found["T"])
        assert pose.distance_to(truth) * 1e3 < wanted["max_error_mm"]
        assert np.rad2deg(pose.angle_to(truth)) < wanted["max_error_deg"]


def test_the_recordings_are_a_few_megabytes_at_most() -> None:
    assert sum(file.stat().st_size for file in FOLDER.iterdir()) < 4_000_000
