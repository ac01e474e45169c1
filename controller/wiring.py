"""The composition root: configuration -> devices. The only module that names concrete drivers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from controller.arm_config import BoxConfig
from controller.charger_config import check_can_protection
from controller.config import SiteConfig
from controller.config_section import ConfigError
from controller.planning import ReachCheck
from controller.recording.reader import Recording
from controller.scanner_config import ScannerConfig
from controller.scanner_files import load_scanner
from controller.situation import Limits
from drivers.arm.approach import why_not
from drivers.arm.kinematics import JointLimits
from drivers.arm.played_links import PlayedLinks, Window
from drivers.arm.settings import UrSettings, Workspace
from drivers.arm.true_pose import error_jacobians
from drivers.arm.ur import UrArm
from drivers.base import Arm, Box, ByteSink, Car, Charger, Clock, Direction, MonotonicClock, NullSink, Scanner
from drivers.charger.can_charger import CanCharger
from drivers.charger.car_listener import CarListener, CarSettings
from drivers.charger.contract import Contract
from drivers.charger.e2e import Scheme
from drivers.charger.played_bus import PlayedBus
from drivers.charger.settings import CanSettings
from drivers.charger.traffic import CanTraffic as CanTraffic
from drivers.charger.traffic import listen_to_bus, listen_to_file
from drivers.playback import Playback
from drivers.scanner.framed import FramedScanner, FramedTimeouts
from drivers.scanner.played_line import Dialogue, PlayedLine
from drivers.scanner.played_scanners import PlayedProfiler2, PlayedScanner, PlayedScip
from drivers.scanner.profiler2 import Profiler2, Profiler2Settings
from drivers.scanner.scip import ScipScanner, ScipSettings
from drivers.scanner.serial_link import SerialSettings
from perception.geometry import Array, Pose
from perception.port_shape import PortDescription


@dataclass(frozen=True, slots=True)
class Devices:
    """The three devices of a cell, not yet opened."""

    scanner: Scanner
    arm: Arm
    charger: Charger
    coarse: Scanner | None = None
    """The scanner of the coarse stage, where the site has one."""
    car: Car | None = None
    """What listens to the vehicle's own protocol, where the site has it."""


class CoarseSink(NullSink):
    """Where the coarse scanner's bytes go: beside the precise one's, never among them."""

    def __init__(self, sink: ByteSink) -> None:
        self._sink = sink

    def scanner_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None:
        """One chunk of its line."""
        self._sink.coarse_bytes(direction, data, host_time_ns)


def build_devices(config: SiteConfig, sink: ByteSink, clock: Clock) -> Devices:
    """Drivers for what the configuration names. Opens nothing; raises ConfigError and file errors."""
    return Devices(
        scanner=build_scanner(config.scanner, sink, clock),
        arm=UrArm(_arm_settings(config), sink, clock),
        charger=CanCharger(_can_settings(config), clock, sink),
        coarse=None if config.coarse is None else build_scanner(config.coarse.scanner, CoarseSink(sink), clock),
        car=_car_listener(config, clock),
    )


def build_played_devices(
    config: SiteConfig, recording: Recording, sink: ByteSink, playback: Playback, heard_s: float
) -> Devices:
    """The same drivers, over stand-ins that play a recording's bytes, frames, states and results.

    ``heard_s``: bus traffic up to here was heard before the mission began. Raises ConfigError and file errors.
    """
    bus = partial(PlayedBus, playback=playback, frames=recording.can_frames(), early_s=heard_s)
    windows = [Window(sweep.arm_first_s, sweep.arm_last_s) for sweep in recording.sweeps()]
    settings = _arm_settings(config)
    links = PlayedLinks(settings, playback, recording.arm_states(), recording.arm_commands(), windows)
    coarse = None if config.coarse is None else _played_scanner(config.coarse.scanner, recording, playback, coarse=True)
    return Devices(
        scanner=_played_scanner(config.scanner, recording, playback, coarse=False),
        arm=UrArm(settings, sink, playback, links),
        charger=CanCharger(_can_settings(config), playback, sink, bus),
        coarse=coarse,
    )


def _played_scanner(config: ScannerConfig, recording: Recording, playback: Playback, *, coarse: bool) -> Scanner:
    sides: tuple[Direction, Direction] = ("rx", "tx")
    rx, tx = ([(c.host_time_ns, c.data) for c in recording.scanner_chunks(side, coarse=coarse)] for side in sides)
    dialogue = Dialogue("coarse tx" if coarse else "scanner tx", rx, tx)
    taken = [(sweep.time_s, sweep.profiles) for sweep in recording.sweeps()]
    serial = SerialSettings(config.device, config.baud_rate)
    driver: Scanner
    match config.protocol:
        case "profiler2":
            driver = PlayedProfiler2(serial, _profiler2_settings(config), playback, dialogue, taken)
        case "scip":
            driver = PlayedScip(serial, _scip_settings(config), NullSink(), playback, dialogue)
        case _:
            line = partial(PlayedLine, playback=playback, dialogue=dialogue)
            layout, timeouts = load_scanner(config.format).layout, _framed_timeouts(config)
            driver = FramedScanner(serial, layout, NullSink(), playback, timeouts, connect=line)
    return PlayedScanner(driver, playback, taken)


def build_scanner(scanner: ScannerConfig, sink: ByteSink, clock: Clock) -> Scanner:
    """The driver of the configured protocol. Opens nothing; raises ScannerFileError."""
    serial = SerialSettings(scanner.device, scanner.baud_rate)
    match scanner.protocol:
        case "profiler2":
            return Profiler2(serial, _profiler2_settings(scanner), sink, clock)
        case "scip":
            return ScipScanner(serial, _scip_settings(scanner), sink, clock)
        case _:
            layout = load_scanner(scanner.format).layout
            return FramedScanner(serial, layout, sink, clock, _framed_timeouts(scanner))


def _profiler2_settings(scanner: ScannerConfig) -> Profiler2Settings:
    own, silence_s = scanner.profiler2, scanner.silence_ms / 1000.0
    return Profiler2Settings(
        own.reference_mm / 1000.0, own.y_away, own.thinning, own.address_in_words, own.tolerant, silence_s=silence_s
    )


def _scip_settings(scanner: ScannerConfig) -> ScipSettings:
    own, silence_s = scanner.scip, scanner.silence_ms / 1000.0
    steps = own.first_step, own.last_step, own.cluster, own.skip
    return ScipSettings(*steps, own.intensity, own.two_characters, silence_s=silence_s)


def _framed_timeouts(scanner: ScannerConfig) -> FramedTimeouts:
    return FramedTimeouts(silence_s=scanner.silence_ms / 1000.0)


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
        patience=max(1.0, config.host.stall_ms / 500.0),
        upper_registers=arm.upper_registers,
        stop_running_program=arm.stop_running_program,
        workspace=Workspace(np.array(_metres(arm.workspace_min_mm)), np.array(_metres(arm.workspace_max_mm))),
        joint_limits=JointLimits(np.deg2rad(arm.joint_min_deg), np.deg2rad(arm.joint_max_deg)),
        least_sigma=arm.least_singular_value,
        boxes=tuple(_box(box) for box in arm.boxes),
        tool_radius_m=arm.tool_radius_mm / 1000.0,
        plug_radius_m=arm.plug_radius_mm / 1000.0,
        plug_length_m=arm.plug_length_mm / 1000.0,
        least_clearance_m=arm.least_clearance_mm / 1000.0,
        errors=arm.errors.errors,
    )


def _box(box: BoxConfig) -> Box:
    x, y, z = _metres(box.size_mm)
    return Box(box.name, box.T_base_box.pose, (x / 2.0, y / 2.0, z / 2.0), box.tool_may_touch)


def _can_settings(config: SiteConfig) -> CanSettings:
    charger = config.charger
    check_can_protection(charger)
    return CanSettings(
        channel=charger.channel,
        interface=charger.interface,
        bitrate=charger.bitrate_bps,
        fd_data_bitrate=charger.fd_data_bitrate_bps,
        tty_baudrate=charger.tty_baud_rate,
        robot_address=charger.robot_address,
        charger_address=charger.charger_address,
        ack_timeout_s=charger.ack_timeout_ms / 1000.0,
        dbc=None if charger.dbc is None else Path(charger.dbc),
        protection=Scheme(charger.protection),
        degraded_s=charger.degraded_ms / 1000.0,
        lost_s=charger.lost_ms / 1000.0,
    )


def check_charger(config: SiteConfig) -> None:
    """Raises ConfigError and InputError for what would keep the charger's link from being opened: DBC, protection."""
    settings = _can_settings(config)
    Contract(settings.dbc, settings.protection, settings.robot_address, settings.charger_address)


def _car_listener(config: SiteConfig, clock: Clock) -> CarListener | None:
    car = config.charger.car
    if car.protocol == "none":
        return None
    return CarListener(CarSettings(car.protocol, car.channel, car.interface, car.accept_virtual), clock)


def limits_of(config: SiteConfig, port: PortDescription) -> Limits:
    """Every bound of the gate, from configuration and port."""
    motion, insertion = config.motion, config.insertion_here
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
        touch_force_n=insertion.contact_force_n,
        capture_radius_m=max(port.capture_radius_m, insertion.search_radius_mm / 1000.0),
    )


def reach_check(config: SiteConfig, arm: Arm) -> ReachCheck:
    """Whether the arm can follow straight lines through TCP poses from where it stands, by its nominal kinematics.

    Looks at reach, joint limits, singularities and clearance: from itself, from the configured boxes and from those
    that the arm was told of last (``set_obstacles``).
    """
    settings = _arm_settings(config)
    return lambda T_base_tcp: why_not(T_base_tcp, arm.state(), settings, arm.obstacles)


def arm_error_jacobians(config: SiteConfig, T_base_flange: tuple[Pose, ...], near: Array) -> Array:
    """(K, 6, 19) how errors of the arm would move its flange at K poses, near joints (6,). Raises UnreachableError."""
    return error_jacobians(_arm_settings(config), T_base_flange, near)


def _metres(values_mm: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = values_mm
    return x / 1000.0, y / 1000.0, z / 1000.0


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
    clock = MonotonicClock()
    return CanTraffic(contract, listen_to_bus(settings, clock, seconds, contract.is_fd), clock.now_s)
