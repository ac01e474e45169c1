"""Hundreds of missions of one daemon's controller, recorder and supervisor on stand-ins: nothing may grow.

What this leaves out (drivers, client libraries, perception) is `portdock soak`'s, on mocks over wires.
"""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller.daemon.records import Recordings
from controller.faults import FaultCode, Outcome
from controller.perception_worker import PreparedModel
from controller.soak.desk import SoakDesk
from controller.soak.figures import Footprint, growth
from tests.unit.daemon_rig import site
from tests.unit.mission_rig import Rig

MISSIONS = int(os.environ.get("PORTDOCK_SOAK_MISSIONS", "300"))

pytestmark = [pytest.mark.long, pytest.mark.timeout(3600)]


def test_hundreds_of_missions_leave_memory_files_and_threads_as_they_were(tmp_path: Path) -> None:
    config = site(tmp_path)
    small = config.recording.model_copy(update={"keep_mb": 20.0})
    config = config.model_copy(update={"recording": small})
    rig, rng = Rig(tmp_path, port=config.port.T_base_port.pose), np.random.default_rng(5)
    records = Recordings(config, lambda event: None, lambda *_: None, reports=False)
    records.attach(rig.cell, PreparedModel("none", np.zeros((1, 3))), tmp_path)
    rig.cell.records = records
    mission: Any = rig.mission
    mission.task.watcher = records
    feeding = threading.Event()
    footprints: list[Footprint] = []
    wanted: list[tuple[str, FaultCode | None]] = [("charged", None)]
    unexplained: list[str] = []

    def ended(outcome: Outcome) -> None:
        kind, fault = wanted[0]
        code = None if outcome.fault is None else outcome.fault.code
        if (code != fault) or (fault is None and outcome.kind not in (kind, "charged")):
            unexplained.append(f"{wanted[0]}: {outcome}")
        footprints.append(Footprint.now())
        wanted[0] = [("charged", None), ("stopped", None), ("fault", FaultCode.ABORTED)][
            int(rng.choice(3, p=[0.6, 0.2, 0.2]))
        ]

    def interrupt(source: str, event: str, target: str) -> None:
        if target == "INSERTING" and wanted[0][0] == "stopped":
            rig.supervisor.request_stop()
        if target == "INSERTING" and wanted[0][0] == "fault":
            rig.supervisor.request_abort()

    def feed() -> None:
        """The links' traffic."""
        while not feeding.is_set():
            records.arm_state(rig.arm.state())
            records.scanner_bytes("rx", b"x" * 2000, time.monotonic_ns())
            time.sleep(0.002)

    records.on_transition = interrupt
    feeder = threading.Thread(target=feed)
    feeder.start()
    rig.supervisor.start()
    try:
        mission.serve(SoakDesk(MISSIONS, ended, lambda: None, lambda: False))
    finally:
        feeding.set()
        feeder.join()
        rig.supervisor.close()
        records.close()
    assert len(footprints) == MISSIONS and not unexplained
    grown = growth(footprints)
    assert grown is not None
    assert grown.rss_mb < 10.0 and grown.descriptors <= 0 and grown.threads <= 0, grown
    (tmp_path / "soak.txt").write_text(f"{grown}\n{footprints[0]}\n{footprints[-1]}\n")
