"""The session of ``portdock calibrate tcp``: docks and looks in the right frames, in the right order."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from controller.calibrations import tcp_session
from controller.calibrations.tcp_session import calibrate_tcp
from controller.calibrations.teach_session import Mated
from controller.config import load_config
from controller.planning import DockPlan
from perception.calibration.mated_tool import Known
from perception.geometry import Pose, exp

CONFIG = load_config()
BELIEVED = CONFIG.arm.T_flange_tcp.pose
TRUE = BELIEVED @ exp([0.0006, -0.0004, 0.0, 0.004, 0.002, -0.003])
T_BASE_PORT = CONFIG.port.T_base_port.pose @ exp([0.01, -0.008, 0.005, 0.03, -0.02, 0.01])
T_PORT_TCP = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -0.049]))
KNOWN = Known(
    T_PORT_TCP, CONFIG.scanner.T_flange_scanner.pose, np.eye(6) * 1e-8, BELIEVED, 2e-4, play_m=2e-4, play_rad=5e-3
)


def test_each_dock_is_looked_at_from_every_viewpoint_and_gives_the_true_tool(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    done: list[str] = []

    def mate(*_: object) -> Mated:
        done.append("dock")
        told = T_BASE_PORT @ T_PORT_TCP @ TRUE.inverse() @ BELIEVED  # the arm reports the TCP that it was given
        return Mated(told, DockPlan(T_BASE_PORT, T_PORT_TCP, told, told, told))

    def located(cell: object, config: object, number: int, report: object) -> Pose:
        done.append(f"look {number}")
        return T_BASE_PORT

    monkeypatch.setattr(tcp_session, "assemble", lambda *_, **__: SimpleNamespace(cell=None))
    monkeypatch.setattr(tcp_session, "mate", mate)
    monkeypatch.setattr(tcp_session, "located", located)
    found = calibrate_tcp(CONFIG, KNOWN, 2, tmp_path, lambda *_: None)
    assert done == ["dock", "look 0", "look 1", "look 2"] * 2
    off = (TRUE.inverse() @ found.T_flange_tcp).vector
    assert np.abs(off[:2]).max() < 1e-9
    assert np.abs(off[3:]).max() < 1e-9
    assert found.T_flange_tcp.distance_to(BELIEVED) == pytest.approx(np.hypot(0.0006, 0.0004), abs=2e-5)
