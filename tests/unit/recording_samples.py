"""A synthetic mission for the tests of recorder, reader, report and export: small, seeded, every topic used."""

from __future__ import annotations

import io
import itertools
import json
from pathlib import Path

import numpy as np

from controller.recording.recorder import Recorder
from controller.summary import ContactSummary, LocateSummary, MissionSummary
from drivers.base import ArmCommandRecord, ArmState, CanFrame, LinkHealth, RobotMode, SafetyMode
from perception.estimate import PortEstimate
from perception.geometry import Array, Pose
from perception.scan import Cloud

WALL_START_NS = 1_760_000_000_000_000_000
T_BASE_PORT = Pose.from_vector([0.8, 0.1, 0.5, 0.1, -1.45, 0.05])
STATES = (
    *("OFFLINE", "SELF_CHECK", "READY", "STAGING", "SCANNING", "LOCATING", "APPROACHING", "INSERTING", "VERIFYING"),
    *("CHARGING", "RELEASING", "RETREATING", "READY"),
)


class ManualClock:
    """A clock that the test moves."""

    def __init__(self, now_s: float = 100.0) -> None:
        self.time_s = now_s

    def now_s(self) -> float:
        return self.time_s

    def sleep(self, seconds: float) -> None:
        self.time_s += seconds


def new_recorder(path: Path, clock: ManualClock | None = None, **options: int) -> Recorder:
    return Recorder(path, clock or ManualClock(), wall_time_ns=lambda: WALL_START_NS, **options)


def arm_state(time_s: float, T_base_tcp: Pose = T_BASE_PORT, force_n: float = 0.0) -> ArmState:
    wrench = np.concatenate([T_base_tcp.rotation[:, 2] * force_n, np.zeros(3)])
    return ArmState(
        time_s=time_s,
        device_time_s=time_s - 40.0,
        T_base_tcp=T_base_tcp,
        T_flange_tcp=Pose.from_vector([0.0, 0.01, 0.2, 0.0, 0.0, 0.3]),
        joints=np.array([0.1, -1.5, 1.6, -1.4, -1.5, 0.2]),
        tcp_speed=np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.001]),
        wrench=wrench,
        mode=RobotMode.RUNNING,
        safety=SafetyMode.NORMAL,
        moving=True,
        program_running=False,
        speed_scaling=0.5,
    )


def estimate(accepted: bool = True, reasons: tuple[str, ...] = ("all checks passed",)) -> PortEstimate:
    return PortEstimate(
        port="ccs2",
        T_ref_port=T_BASE_PORT,
        ref="base",
        covariance=np.diag([1e-8, 1e-8, 4e-9, 1e-6, 1e-6, 2e-6]),
        rms_residual_m=0.00021,
        inlier_ratio=0.93,
        runner_up_margin=0.4,
        accepted=accepted,
        reasons=reasons,
        timings_s=(("crop", 0.01), ("refine", 0.2), ("total", 0.31)),
    )


def model_points() -> Array:
    """A rim, a pocket and two holes: (N, 3) in the port frame."""
    rng = np.random.default_rng(3)
    angle = rng.uniform(0, 2 * np.pi, 1500)
    wall = np.stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), rng.uniform(-0.02, 0.0, 1500)], axis=1)
    flat = rng.uniform(-0.05, 0.05, (2500, 3)) * [1, 1, 0]
    flat = flat[np.hypot(flat[:, 0], flat[:, 1]) > 0.03]
    radius = 0.03 * np.sqrt(rng.uniform(0, 1, 1200))
    turn = rng.uniform(0, 2 * np.pi, 1200)
    floor = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(1200, -0.02)], axis=1)
    return np.concatenate([wall, flat, floor])


def scan_cloud(noise_m: float = 0.0002) -> Cloud:
    points = model_points()
    noisy = points + np.random.default_rng(4).normal(0.0, noise_m, points.shape)
    return Cloud(T_BASE_PORT.apply(noisy), "base")


def model_points_npz() -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, points=model_points())
    return buffer.getvalue()


def summary(outcome: str = "charged", fault: str | None = None, remedy: str = "") -> MissionSummary:
    return MissionSummary(
        outcome=outcome,  # type: ignore[arg-type]
        fault=fault,
        remedy=remedy,
        states=tuple((name, 1.0) for name in STATES[:-1]),
        attempts=1,
        locate=LocateSummary(True, 0.25, 0.12, 0.31, ("all checks passed",)),
        contact=ContactSummary(0.21, 0.34, 0.05, 0.11, 61.5),
    )


def record_mission(path: Path, result: MissionSummary | None = None) -> Path:
    """A whole mission of 12 s, one state a second."""
    clock = ManualClock()
    recorder = new_recorder(path, clock)
    recorder.metadata("versions", {"portdock": "0.1.0", "python": "3.11"})
    recorder.attach("config.yaml", b"arm:\n  host: 127.0.0.2\n  max_force_n: 80\n", "application/yaml")
    recorder.attach("model_points.npz", model_points_npz(), "application/x-npz")
    for number, (before, after) in enumerate(itertools.pairwise(STATES)):
        recorder.transition(before, f"{before.lower()}_done", after, clock.now_s())
        _record_state(recorder, clock, after, number)
        clock.sleep(1.0)
    recorder.link("scanner", LinkHealth(True, clock.now_s(), (("bytes", 4096), ("bad_checksum", 2)), "mock"))
    recorder.link("arm", LinkHealth(True, clock.now_s()))
    recorder.contact(1, summary().contact or ContactSummary(0, 0, 0, 0, 0))
    recorder.close(result or summary())
    return path


def _record_state(recorder: Recorder, clock: ManualClock, state: str, number: int) -> None:
    start_s = clock.now_s()
    for k in range(50):
        time_s = start_s + 0.02 * k
        depth_m = -0.03 + 0.05 * k / 50 if state == "INSERTING" else -0.03
        force_n = max(0.0, 3000.0 * depth_m) if state == "INSERTING" else 0.0
        recorder.arm_state(arm_state(time_s, T_BASE_PORT.moved((0.0002, 0.0003, -depth_m)), force_n))
        recorder.can_frame(CanFrame(time_s, "tx" if k % 2 else "rx", 0x18FF0100 + k % 2, bytes([k, number])))
    recorder.command(f"Move{state.title()}", json.dumps({"k": number}), allowed=True)
    if state == "STAGING":
        recorder.arm_command(
            ArmCommandRecord(start_s, "moveJ", (0.1, -1.5, 1.6, -1.4, -1.5, 0.2, 0.5, 0.8), "accepted")
        )
    if state == "SCANNING":
        for k in range(40):
            recorder.scanner_bytes("rx", bytes([k]) * (k + 1), round((start_s + 0.02 * k) * 1e9))
        recorder.scanner_bytes("tx", b"\x02\x03\x00", round(start_s * 1e9))
    if state == "LOCATING":
        recorder.scan(scan_cloud())
        recorder.estimate(estimate())
        recorder.waited(101.5)
        recorder.swept(250, 100.5, 101.5)
        recorder.note("info", "located the port")
