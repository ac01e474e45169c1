"""Whole missions over real wires: the real client libraries, three mock processes, the daemon's controller."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from controller.recording.reader import read_recording
from controller.replay.replay import replay

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]

CYCLE = [
    "SELF_CHECK", "READY", "STAGING", "SCANNING", "LOCATING", "APPROACHING", "INSERTING", "VERIFYING", "CHARGING",
    "RELEASING", "RETREATING", "READY",
]  # fmt: skip


@dataclass(frozen=True)
class Run:
    code: int
    result: dict  # type: ignore[type-arg]
    folder: Path
    stderr: str

    @property
    def states(self) -> list[str]:
        return [name for name, _ in self.result["states"]]


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "controller.cli.main", "dry-run", *arguments]


def dry_run(folder: Path, scenario: str, seed: int = 0, *options: str) -> Run:
    out = folder / "out"
    done = subprocess.run(
        command("--fast", "--json", "--scenario", scenario, "--seed", str(seed), "--out", str(out), *options),
        capture_output=True,
        check=False,
        text=True,
        timeout=380,
        cwd=folder,
    )
    assert done.stdout, done.stderr
    return Run(done.returncode, json.loads(done.stdout), out, done.stderr)


def assert_replays(run: Run) -> None:
    """The same controller, locator included, does the same again from what was recorded."""
    result = replay(read_recording(run.folder / "mission.mcap"))
    assert result.difference is None, f"{result.difference} {result.ended}"
    assert list(result.states) == run.states


def test_a_range_finder_looks_first_and_the_profiler_docks(tmp_path: Path) -> None:
    """The car stands centimetres off: the coarse sweep finds it, from there on everything is as usual."""
    run = dry_run(tmp_path, "nominal", 1, "--scanner", "scip_profiler")
    assert (run.code, run.result["outcome"]) == (0, "charged"), run.stderr
    assert run.states[: run.states.index("APPROACHING")].count("SCANNING") >= 2
    assert run.result["locate"]["error_mm"] < 1.0
    recording = read_recording(run.folder / "mission.mcap")
    assert len(recording.topics["/coarse/rx"]) > 50
    assert any(report.link == "coarse" for report in recording.links())
    assert_replays(run)


@pytest.mark.long
def test_where_the_range_finder_sees_no_port_the_mission_is_refused_before_the_profiler_looks(tmp_path: Path) -> None:
    run = dry_run(tmp_path, "no-port", 0, "--scanner", "scip_profiler")
    assert (run.code, run.result["outcome"], run.result["fault"]) == (1, "refused", "port-not-found"), run.stderr
    assert run.result["locate"] is None, "the profiler has not looked"
    assert "APPROACHING" not in run.states


def test_a_nominal_cycle_charges_and_leaves_its_evidence(tmp_path: Path) -> None:
    run = dry_run(tmp_path, "nominal", seed=4)
    assert (run.code, run.result["outcome"], run.result["fault"]) == (0, "charged", None), run.stderr
    assert run.states == CYCLE and run.result["attempts"] == 1
    assert run.result["locate"]["accepted"] and run.result["locate"]["error_mm"] < 1.0
    assert run.result["locate"]["error_deg"] < 0.5
    assert 0.0 < run.result["contact"]["peak_force_n"] < 88.0
    recording = read_recording(Path(run.result["recording"]))
    assert recording.complete
    assert [t.to_state for t in recording.transitions()] == CYCLE
    assert recording.scanner_chunks() and recording.can_frames() and recording.arm_states()
    assert all(d.allowed for d in recording.decisions())
    assert Path(run.result["report"]).stat().st_size > 10_000
    assert_replays(run)


def test_without_a_port_the_mission_is_refused_and_the_arm_stays_at_staging(tmp_path: Path) -> None:
    run = dry_run(tmp_path, "no-port")
    assert (run.code, run.result["outcome"], run.result["fault"]) == (1, "refused", "port-not-found"), run.stderr
    assert "APPROACHING" not in run.states
    assert run.result["locate"] is None or not run.result["locate"]["accepted"]
    assert_replays(run)


def test_a_poor_first_scan_is_refused_and_the_second_viewpoint_succeeds(tmp_path: Path) -> None:
    run = dry_run(tmp_path, "first-scan-poor", seed=1)
    assert (run.code, run.result["outcome"]) == (0, "charged"), run.stderr
    assert run.states.count("SCANNING") == 2
    assert run.states[2:9] == ["STAGING", "SCANNING", "LOCATING", "STAGING", "SCANNING", "LOCATING", "APPROACHING"]
    assert_replays(run)


def test_a_blocked_port_is_left_along_the_inserted_axis_and_a_person_is_asked_for(tmp_path: Path) -> None:
    run = dry_run(tmp_path, "blocked", seed=2)
    assert (run.code, run.result["outcome"], run.result["fault"]) == (1, "intervention-needed", "insertion-blocked")
    assert run.result["attempts"] == 3 and run.states.count("INSERTING") == 3
    for state, following in zip(run.states, run.states[1:], strict=False):
        assert state != "INSERTING" or following == "RETREATING"
    assert run.result["contact"]["along_mm"] > 30.0
    assert run.result["contact"]["peak_force_n"] < 88.0
    assert len(read_recording(Path(run.result["recording"])).contacts()) == 3
    assert_replays(run)


def test_a_dry_run_that_is_killed_leaves_no_mock_behind_and_a_recording_that_can_be_read(tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = subprocess.Popen(
        command("--fast", "--out", str(out)), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=tmp_path
    )
    assert process.stdout is not None
    for line in process.stdout:
        if "LOCATING" in line:
            break
    children = mocks_of(process.pid)
    assert len(children) >= 3
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    deadline = time.monotonic() + 20.0
    while any(alive(pid) for pid in children) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [pid for pid in children if alive(pid)]
    recording = read_recording(out / "mission.mcap")
    assert not recording.complete
    assert "SCANNING" in [t.to_state for t in recording.transitions()]


def mocks_of(parent: int) -> list[int]:
    """Process numbers of the mocks that a dry run has started."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                status = (entry / "stat").read_text().rsplit(")", 1)[1].split()
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except (OSError, IndexError):
                continue
            if int(status[1]) == parent and b"mocks" in words:
                found.append(int(entry.name))
    return found


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False
