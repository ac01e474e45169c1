"""What a daemon's recording begins with: what the bus said last, and the axis that is stored."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from controller.daemon.records import HEARD_FRAMES, Recordings
from controller.durable import INSERTION_NAME, remember_insertion
from controller.perception_worker import PreparedModel
from controller.planning import plan_on_axis
from controller.recording.reader import Recording, read_recording
from controller.states import Event, State
from controller.task import Goal
from drivers.base import CanFrame
from tests.unit.daemon_rig import site
from tests.unit.mission_rig import Rig


def frame(time_s: float, identifier: int, direction: str = "rx", *, error: bool = False) -> CanFrame:
    return CanFrame(time_s, direction, identifier, b"\x01", is_error=error)  # type: ignore[arg-type]


def begun(folder: Path) -> tuple[Recordings, Rig]:
    config = site(folder)
    rig = Rig(folder, port=config.port.T_base_port.pose)
    records = Recordings(config, lambda event: None, lambda *_: None, reports=False)
    records.attach(rig.cell, PreparedModel("none", np.zeros((1, 3))), folder)
    return records, rig


def recorded(folder: Path) -> Recording:
    (path,) = (folder / "runs").glob("*/mission.mcap")
    return read_recording(path)


def test_a_recording_begins_with_what_each_identifier_said_last(tmp_path: Path) -> None:
    records, _ = begun(tmp_path)
    for k in range(6):
        records.can_frame(frame(1.0 + k, 0x10))
        records.can_frame(frame(1.5 + k, 0x20))
        records.can_frame(frame(1.7 + k, 0x30, "tx"))
        records.can_frame(frame(1.8 + k, 0x40, error=True))
    records.began(Goal.DOCK)
    records.can_frame(frame(9.0, 0x10))
    records.close()
    frames = recorded(tmp_path).can_frames()
    assert [(f.arbitration_id, f.time_s) for f in frames] == [
        *(
            (identifier, first + k)
            for k in range(6 - HEARD_FRAMES, 6)
            for identifier, first in ((0x10, 1.0), (0x20, 1.5))
        ),
        (0x10, 9.0),
    ]


def test_a_recording_holds_the_stored_axis_and_how_fast_the_cell_runs(tmp_path: Path) -> None:
    records, rig = begun(tmp_path)
    plan = plan_on_axis(rig.config.port.T_base_port.pose, rig.T_port_tcp, rig.config.motion)
    remember_insertion(tmp_path, plan)
    before_s = rig.cell.wall.now_s()
    records.began(Goal.UNDOCK)
    records.close()
    found = recorded(tmp_path)
    assert found.attachments[INSERTION_NAME].data == (tmp_path / INSERTION_NAME).read_bytes()
    assert found.metadata["mission"]["pace"] == f"{rig.cell.time_scale:g}"
    assert rig.cell.recorded_since_s >= before_s, "a sweep uses no sample that its recording lacks"


def test_an_axis_that_cannot_be_read_costs_no_job_its_recording(tmp_path: Path) -> None:
    records, _ = begun(tmp_path)
    (tmp_path / INSERTION_NAME).mkdir()
    records.began(Goal.UNDOCK)
    records.close()
    assert INSERTION_NAME not in recorded(tmp_path).attachments


def test_a_replay_of_a_charge_that_ended_begins_with_its_end(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.supervisor.start()
    try:
        rig.mission.run(Goal.DOCK)
        asked = len(rig.charger.requests)
        outcome = rig.mission.go_on(State.CHARGING, Goal.UNDOCK, Event.CHARGE_COMPLETE)
    finally:
        rig.supervisor.close()
    assert outcome.kind == "undocked"
    assert "ENABLE_POWER" not in [request.name for request in rig.charger.requests[asked:]]
