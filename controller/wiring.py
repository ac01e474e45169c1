"""The composition root: configuration -> devices. The only module that names concrete drivers and mocks."""

from __future__ import annotations

import json
import os
import selectors
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np

from controller.config import ConfigError, SiteConfig
from controller.planning import ReachCheck
from controller.port_files import load_port
from controller.safety import Limits
from controller.scanner_files import load_scanner
from controller.scenarios import Scenario
from drivers.arm.line_check import check_line
from drivers.arm.settings import UrSettings, Workspace
from drivers.arm.ur import UrArm
from drivers.base import Arm, ByteSink, Charger, Clock, LinkOpenError, MonotonicClock, Scanner
from drivers.charger.can_charger import CanCharger
from drivers.charger.contract import Contract
from drivers.charger.e2e import Scheme
from drivers.charger.settings import CanSettings
from drivers.charger.traffic import CanTraffic as CanTraffic
from drivers.charger.traffic import listen_to_bus, listen_to_file
from drivers.scanner.framed import FramedScanner, FramedTimeouts
from drivers.scanner.serial_link import SerialSettings
from mocks.world.blackboard import Blackboard
from mocks.world.spec import WorldSpec
from perception.geometry import Pose
from perception.port_shape import PortDescription

MOCK_START_S = 30.0
HOME_JOINTS = (2.8, -1.8, 1.8, -0.2, 1.5, 2.9)
"""Where the mock arm stands at first: beside the staging pose, rad."""


@dataclass(frozen=True, slots=True)
class Devices:
    """The three devices of a cell, not yet opened."""

    scanner: Scanner
    arm: Arm
    charger: Charger


def build_devices(config: SiteConfig, sink: ByteSink, clock: Clock) -> Devices:
    """Drivers for what the configuration names. Opens nothing; raises ConfigError and file errors."""
    scanner = load_scanner(config.scanner.format)
    serial = SerialSettings(config.scanner.device, config.scanner.baud_rate)
    return Devices(
        scanner=FramedScanner(
            serial, scanner.layout, sink, clock, FramedTimeouts(silence_s=config.scanner.silence_ms / 1000.0)
        ),
        arm=UrArm(_arm_settings(config), sink, clock),
        charger=CanCharger(_can_settings(config), clock, sink),
    )


def _arm_settings(config: SiteConfig) -> UrSettings:
    arm = config.arm
    return UrSettings(
        host=arm.host,
        model=arm.model,
        serial=arm.serial,
        T_flange_tcp=arm.T_flange_tcp.pose,
        payload_kg=arm.payload_kg,
        centre_of_gravity_m=_metres(arm.centre_of_gravity_mm),
        frequency_hz=float(arm.frequency_hz),
        watchdog_hz=arm.watchdog_hz,
        freshness_s=arm.freshness_ms / 1000.0,
        workspace=Workspace(np.array(_metres(arm.workspace_min_mm)), np.array(_metres(arm.workspace_max_mm))),
    )


def _can_settings(config: SiteConfig) -> CanSettings:
    charger = config.charger
    if charger.protection == "none" and not charger.accept_unprotected_can:
        raise ConfigError(
            "charger.protection is 'none': docking frames would be unprotected",
            remedy="Choose a protection, or set charger.accept_unprotected_can: true.",
        )
    return CanSettings(
        channel=charger.channel,
        interface=charger.interface,
        bitrate=charger.bitrate_bps,
        dbc=None if charger.dbc is None else Path(charger.dbc),
        protection=Scheme(charger.protection),
        degraded_s=charger.degraded_ms / 1000.0,
        lost_s=charger.lost_ms / 1000.0,
    )


def profile_latency_s(config: SiteConfig) -> float:
    """Least delay from a profile's time stamp (mid-exposure) to its last byte: exposure, line (8N1) and calibration."""
    scanner = load_scanner(config.scanner.format)
    line_s = scanner.layout.size * 10 / config.scanner.baud_rate
    return scanner.exposure_s / 2.0 + line_s + config.scanner.latency_ms / 1000.0


def limits_of(config: SiteConfig, port: PortDescription) -> Limits:
    """Every bound of the gate, from configuration and port."""
    motion, insertion = config.motion, config.insertion
    return Limits(
        workspace_min_m=_metres(config.arm.workspace_min_mm),
        workspace_max_m=_metres(config.arm.workspace_max_mm),
        joint_speed_rad_s=float(np.deg2rad(motion.joint_speed_deg_s)),
        linear_speed_m_s=motion.linear_speed_mm_s / 1000.0,
        insertion_speed_m_s=max(insertion.speed_limit_mm_s, insertion.contact_speed_mm_s) / 1000.0,
        withdraw_speed_m_s=insertion.withdraw_speed_mm_s / 1000.0,
        insertion_turn_rad_s=float(np.deg2rad(insertion.tilt_speed_limit_deg_s)),
        axial_force_n=insertion.max_axial_force_n,
        lateral_force_n=insertion.max_lateral_force_n,
        moment_nm=insertion.max_moment_nm,
        capture_radius_m=max(port.capture_radius_m, insertion.search_radius_mm / 1000.0),
    )


def reach_check(config: SiteConfig, arm: Arm) -> ReachCheck:
    """Whether the arm can follow straight lines through TCP poses from where it stands, by its nominal kinematics."""
    settings = _arm_settings(config)
    T_tcp_flange = settings.T_flange_tcp.inverse()

    def why_not(T_base_tcp: Sequence[Pose]) -> str | None:
        state = arm.state()
        joints, start = state.joints, state.T_base_flange
        for pose in T_base_tcp:
            end = pose @ T_tcp_flange
            line = check_line(settings.kinematics, start, end, joints, settings.joint_limits, settings.least_sigma)
            if not line.ok:
                return "; ".join(line.reasons)
            joints, start = line.joints[-1], end
        return None

    return why_not


def _metres(values_mm: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = values_mm
    return x / 1000.0, y / 1000.0, z / 1000.0


# --- the mock cell --------------------------------------------------------------------------------------------------


class MockCell:
    """Three mock devices, each a process at the far end of its wire. ``config`` names their addresses."""

    def __init__(self, folder: Path, config: SiteConfig, scenario: Scenario, seed: int, time_scale: float) -> None:
        self._folder = folder
        self._base = config
        self._scenario = scenario
        self._seed = seed
        self._time_scale = time_scale
        self._processes: list[subprocess.Popen[str]] = []
        self.config = config

    def __enter__(self) -> MockCell:
        """Start all three. Raises LinkOpenError when one does not come up."""
        self._folder.mkdir(parents=True, exist_ok=True)
        world, port = self._world(), load_port(self._base.port.model)
        world.save(self._folder)
        world.save_shape(self._folder, port.shape)
        Blackboard.create(self._folder, self._time_scale).close()
        host = free_loopback()
        folder = ["--world", str(self._folder)]
        scanner, can = str(self._folder / "scanner"), str(self._folder / "can")
        try:
            self._start("ur", [*folder, "--host", host, "--rate", str(self._base.arm.frequency_hz)])
            self._start("scanner", [*folder, "--link", scanner, "--source", "world", "--seed", str(self._seed)])
            self._start("charger", [*folder, "--link", can, "--lost-ms", f"{self._base.charger.lost_ms:g}"])
            for process in self._processes:
                _await_ready(process)
        except BaseException:
            self._stop()
            raise
        self.config = self._base.model_copy(
            update={
                "arm": self._base.arm.model_copy(update={"host": host}),
                "scanner": self._base.scanner.model_copy(update={"device": scanner}),
                "charger": self._base.charger.model_copy(update={"interface": "slcan", "channel": can}),
            }
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def _world(self) -> WorldSpec:
        config, port = self._base, load_port(self._base.port.model)
        return WorldSpec(
            seed=self._seed,
            port=port.name,
            T_base_port=_vector(self._scenario.T_base_port),
            T_flange_scanner=_vector(config.scanner.T_flange_scanner.pose),
            T_flange_tcp=_vector(config.arm.T_flange_tcp.pose),
            T_port_tcp=_vector(port.T_port_tcp),
            panel="plain" if self._scenario.plain_panel else "port",
            glare_until_sweep=self._scenario.glare_until_sweep,
            blocked_depth_m=self._scenario.blocked_depth_m,
            time_scale=self._time_scale,
            arm_model=config.arm.model,
            start_joints=HOME_JOINTS,
        )

    def _start(self, name: str, arguments: list[str]) -> None:
        log = (self._folder / f"mock-{name}.log").open("w", encoding="utf-8")
        with log:
            self._processes.append(
                subprocess.Popen(
                    [sys.executable, "-m", "mocks", name, *arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=log,
                    text=True,
                    cwd=self._folder,
                )
            )

    def _stop(self) -> None:
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            try:
                process.wait(timeout=5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()
        self._processes.clear()


def can_traffic(
    channel: str | None,
    file: Path | None,
    interface: str,
    bitrate: int,
    dbc: Path | None,
    protection: str,
    seconds: float | None,
) -> CanTraffic:
    """Something that listens to a charger's bus, or to a recording of one. Raises InputError and LinkOpenError."""
    if protection not in set(Scheme):
        raise ConfigError(f"no protection is called {protection}", remedy=f"Choose one of {', '.join(Scheme)}.")
    contract = Contract(dbc, Scheme(protection))
    if file is not None:
        return CanTraffic(contract, listen_to_file(file))
    settings = CanSettings(channel=channel or "", interface=interface, bitrate=bitrate)
    return CanTraffic(contract, listen_to_bus(settings, MonotonicClock(), seconds, contract.is_fd))


def mock_command(name: str, arguments: list[str]) -> list[str]:
    """The command line of one mock process: ``ur``, ``scanner`` or ``charger``."""
    return [sys.executable, "-m", f"mocks.{name}", *arguments]


def run_mock(name: str, arguments: list[str]) -> None:
    """Become a mock process in the foreground; does not return."""
    command = mock_command(name, arguments)
    os.execv(command[0], command)


def free_loopback(ports: tuple[int, ...] = (29999, 30001, 30003, 30004)) -> str:
    """A loopback address on which a mock controller's fixed ports are free. Raises LinkOpenError."""
    start = os.getpid() % 200
    for k in range(200):
        host = f"127.0.{1 + (start + k) // 200}.{2 + (start + k) % 200}"
        if all(_free(host, port) for port in ports):
            return host
    raise LinkOpenError("no loopback address has the robot's ports free", remedy="Stop other mock controllers.")


def _free(host: str, port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return False
        return True


def _await_ready(process: subprocess.Popen[str]) -> dict[str, object]:
    """The JSON line that a mock prints when it listens. Raises LinkOpenError."""
    assert process.stdout is not None
    end_s = time.monotonic() + MOCK_START_S
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while time.monotonic() < end_s:
            if selector.select(timeout=0.2):
                line = process.stdout.readline()
                if line:
                    values: dict[str, object] = json.loads(line)
                    return values
                break
            if process.poll() is not None:
                break
    name = process.args[3] if isinstance(process.args, list) else "a mock"
    raise LinkOpenError(f"the mock {name} did not start", remedy="See its log (mock-*.log) in the run's folder.")


def _vector(pose: Pose) -> tuple[float, float, float, float, float, float]:
    x, y, z, rx, ry, rz = (float(v) for v in pose.vector)
    return x, y, z, rx, ry, rz
