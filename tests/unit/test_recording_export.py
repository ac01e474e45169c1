"""Exports are read back by the tools they are for; the command line and the ring of recordings do what they say."""

import json
import os
import re
from pathlib import Path

import can
import numpy as np
import pytest
from typer.testing import CliRunner

from controller.cli.recording import app
from controller.recording.errors import RecordingFileError
from controller.recording.export import ExportFormat, arm_columns, export
from controller.recording.reader import Recording, read_recording
from controller.recording.ring import prune
from drivers.base import CanFrame
from perception.cloud_io import read_cloud
from tests.unit.recording_samples import estimate, new_recorder, record_mission, scan_cloud


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return read_recording(record_mission(tmp_path_factory.mktemp("m") / "mission.mcap"))


def run(*arguments: object) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_candump_log_has_candump_s_lines(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.can_frame(CanFrame(100.25, "rx", 0x18FF0110, b"\xde\xad"))
    recorder.can_frame(CanFrame(100.5, "tx", 0x123, b"", is_extended=False))
    recorder.close()
    (path,) = export(read_recording(tmp_path / "m.mcap"), ExportFormat.CANDUMP, tmp_path)
    first, second = path.read_text().splitlines()
    assert re.fullmatch(r"\(1760000000\.25\d*\) can0 18FF0110#DEAD( R)?", first)
    assert re.fullmatch(r"\(1760000000\.50*\) can0 123#( T)?", second)


@pytest.mark.parametrize("kind", [ExportFormat.CANDUMP, ExportFormat.BLF])
def test_can_logs_come_back_through_python_can(mission: Recording, tmp_path: Path, kind: ExportFormat) -> None:
    (path,) = export(mission, kind, tmp_path)
    with can.LogReader(path) as reader:
        back = [(m.arbitration_id, bytes(m.data), m.is_extended_id) for m in reader]
    assert back == [(f.arbitration_id, f.data, f.is_extended) for f in mission.can_frames()]


def test_a_scan_comes_back_through_the_reader_of_clouds(mission: Recording, tmp_path: Path) -> None:
    (path,) = export(mission, ExportFormat.PLY, tmp_path)
    assert np.array_equal(read_cloud(path).points, scan_cloud().points)


def test_arm_states_become_a_table_with_a_header(mission: Recording, tmp_path: Path) -> None:
    (path,) = export(mission, ExportFormat.CSV, tmp_path)
    table = np.genfromtxt(path, delimiter=",", names=True)
    states = mission.arm_states()
    assert len(table) == 600
    assert table["time_s"][30] == states[30].time_s
    assert table["base_tcp_translation_m_2"][30] == states[30].T_base_tcp.translation[2]
    assert table["wrench_0"][310] == states[310].wrench[0]


def test_nothing_to_export_is_said(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.estimate(estimate())
    recorder.close()
    recording = read_recording(tmp_path / "m.mcap")
    for kind in ExportFormat:
        with pytest.raises(RecordingFileError, match=f"nothing to export as {kind}"):
            export(recording, kind, tmp_path)


def test_an_export_that_cannot_be_written_leaves_nothing_behind(mission: Recording, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingFileError, match="cannot write"):
        export(mission, ExportFormat.PLY, tmp_path / "file")
    (tmp_path / "mission-arm.csv").mkdir()
    with pytest.raises(RecordingFileError, match="cannot write"):
        export(mission, ExportFormat.CSV, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "mission-arm.csv"]


def test_info_says_what_a_recording_holds(mission: Recording) -> None:
    facts = json.loads(run("info", mission.path, "--json"))
    assert facts["complete"] is True
    assert facts["outcome"] == "charged"
    assert facts["states"][-1] == "READY"
    assert facts["topics"]["/can/raw"] == 600
    assert facts["attachments"]["config.yaml"] == 41
    text = run("info", mission.path)
    assert re.search(r"outcome: +charged", text)
    assert re.search(r"/arm/state +600", text)


def test_recover_and_export_and_report_from_the_command_line(mission: Recording, tmp_path: Path) -> None:
    data = mission.path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) * 2 // 3])
    assert "breaks off" in run("info", cut)
    assert "messages and 2 attachments saved" in run("recover", cut)
    whole = tmp_path / "cut-recovered.mcap"
    assert "recovered" in run("info", whole)
    assert run("export", whole, "--format", "candump").strip() == str(tmp_path / "cut-recovered-can.log")
    assert run("report", whole, "--out", tmp_path / "r.html").strip() == str(tmp_path / "r.html")


def make_mission(folder: Path, name: str, age_s: float, size: int = 1000) -> Path:
    home = folder / name
    home.mkdir(parents=True)
    for file in ("mission.mcap", "report.html"):
        (home / file).write_bytes(bytes(size // 2))
        os.utime(home / file, (2e9 - age_s, 2e9 - age_s))
    return home


def test_the_oldest_missions_go_first_and_only_as_many_as_needed(tmp_path: Path) -> None:
    homes = [make_mission(tmp_path, f"run-{k}", age_s=100.0 * (5 - k)) for k in range(5)]
    deleted = prune(tmp_path, 2500)
    assert [home.exists() for home in homes] == [False, False, False, True, True]
    assert len(deleted) == 6
    assert prune(tmp_path, 2500) == []


def test_the_newest_recording_stays_however_big(tmp_path: Path) -> None:
    make_mission(tmp_path, "old", 50.0)
    newest = make_mission(tmp_path, "new", 1.0, size=100_000)
    prune(tmp_path, 10)
    assert [p.name for p in tmp_path.iterdir()] == ["new"]
    assert len(list(newest.iterdir())) == 2


def test_a_recording_in_progress_is_never_deleted(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "going" / "mission.mcap")
    recorder.note("info", "x")
    recorder.flush()
    os.utime(recorder.path, (1.0, 1.0))
    make_mission(tmp_path, "old", 50.0)
    make_mission(tmp_path, "new", 1.0)
    prune(tmp_path, 0)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["going", "new"]
    recorder.close()
    os.utime(recorder.path, (1.0, 1.0))
    prune(tmp_path, 0)
    assert [p.name for p in tmp_path.iterdir()] == ["new"]


def test_nothing_but_recordings_and_their_reports_is_ever_deleted(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    precious = make_mission(outside, "precious", 1000.0)
    ring = tmp_path / "ring"
    old = make_mission(ring, "old", 500.0)
    make_mission(ring, "new", 1.0)
    (old / "notes.txt").write_text("mine")
    (ring / "link").symlink_to(precious)
    (ring / "link.mcap").symlink_to(precious / "mission.mcap")
    (ring / "site.yaml").write_text("mine")
    deleted = prune(ring, 0)
    assert sorted(p.name for p in deleted) == ["mission.mcap", "report.html"]
    assert [p.name for p in old.iterdir()] == ["notes.txt"]
    assert len(list(precious.iterdir())) == 2
    assert (ring / "site.yaml").exists()


def test_pruning_a_folder_that_is_not_there_is_no_error(tmp_path: Path) -> None:
    assert prune(tmp_path / "none", 0) == []


def test_the_mission_that_just_ended_stays_though_the_clock_stands_in_the_past(tmp_path: Path) -> None:
    for k in range(3):
        make_mission(tmp_path, f"old-{k}", age_s=100.0 * k)
    just_ended = make_mission(tmp_path, "now", age_s=1.9e9)
    prune(tmp_path, 0, keep=just_ended / "mission.mcap")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["now", "old-0"]


def test_what_portdock_wrote_beside_a_recording_goes_with_it(tmp_path: Path) -> None:
    lossy = make_mission(tmp_path, "lossy", 500.0)
    (lossy / "charger-loss.log").write_text("(0.0) can0 123#00\n")
    make_mission(tmp_path, "new", 1.0)
    prune(tmp_path, 0)
    assert not lossy.exists()


def test_an_older_recording_whose_arm_samples_lack_outputs_exports_what_it_has() -> None:
    older = read_recording(Path(__file__).parents[1] / "replay" / "nominal-dry-run.mcap")
    header, table = arm_columns(older)
    names = header.split(",")
    assert names[0] == "time_s" and names[-1] == "speed_scaling"
    assert table.shape == (len(older.arm_table()), len(names))
