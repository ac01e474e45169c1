"""The mock cell: three mock devices, each a process at the far end of its wire. Composition root of the dry run."""

from __future__ import annotations

import json
import os
import selectors
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType

from controller.coarse_config import CoarseConfig
from controller.config import SiteConfig
from controller.config_section import ConfigError
from controller.mock_calibrations import as_calibrated, has_hidden_latency
from controller.port_files import load_port
from controller.scenarios import Scenario
from drivers.base import LinkOpenError
from mocks.world.blackboard import Blackboard
from mocks.world.spec import WorldSpec
from perception.geometry import Pose

MOCK_START_S = 60.0
PROFILE_RATE = ("--rate-hz", "50")
"""Of the mock scanner: what a ray-caster on a small machine keeps up with at four times the pace."""
HOME_JOINTS = (2.8, -1.8, 1.8, -0.2, 1.5, 2.9)
"""Where the mock arm stands at first: beside the staging pose, rad."""


class MockCell:
    """Three mock devices, each a process at the far end of its wire.

    ``config``: the site with their addresses, and with the calibrations that are kept of such a cell.
    """

    def __init__(
        self,
        folder: Path,
        config: SiteConfig,
        scenario: Scenario,
        seed: int,
        time_scale: float,
        can: tuple[str, str] | None = None,
        scanner_options: tuple[str, ...] = (),
    ) -> None:
        """``can``: python-can interface and channel of the charger's bus; None is an slcan adapter of its own.

        ``scanner_options``: further options of the mock scanner.
        """
        self._folder = folder
        self._base = config
        self._scenario = scenario
        self._seed = seed
        self._time_scale = time_scale
        self._can = can or ("slcan", str(folder / "can"))
        self._more_scanner_options = scanner_options
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
        scanner, coarse = str(self._folder / "scanner"), str(self._folder / "coarse")
        try:
            self._start("ur", [*folder, "--host", host, "--rate", str(self._base.arm.frequency_hz)])
            self._start(
                "scanner",
                [*folder, "--link", scanner, "--source", "world", "--seed", str(self._seed), *self._scanner_options()],
            )
            if self._base.coarse is not None:
                self._start("scanner", [*folder, "--link", coarse, *self._coarse_options()], log="mock-coarse.log")
            self._start("charger", [*folder, *self._charger_options()])
            for process in self._processes:
                _await_ready(process, MOCK_START_S * max(1.0, self._base.host.stall_ms / 2000.0))
        except BaseException:
            self._stop()
            raise
        site = as_calibrated(self._base) if self._scenario.calibrated else self._base
        self.config = site.model_copy(
            update={
                "arm": site.arm.model_copy(update={"host": host}),
                "scanner": site.scanner.model_copy(update={"device": scanner}),
                "coarse": self._coarse_at(coarse),
                "charger": self._base.charger.model_copy(update={"interface": self._can[0], "channel": self._can[1]}),
            }
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def freeze(self, name: str) -> None:
        """Stop a mock's process as it is: its wire stays open and silent. ``ur``, ``scanner`` or ``charger``."""
        self._process(name).send_signal(signal.SIGSTOP)

    def park(self, T_base_port: Pose) -> None:
        """Another car parks instead, its port at ``T_base_port``; the arm must be out of the way."""
        board = Blackboard.attach(self._folder)
        board.put_car(_vector(T_base_port))
        board.close()

    def press_estop(self, pressed: bool) -> None:
        """The cell's emergency stop circuit."""
        board = Blackboard.attach(self._folder)
        board.put_estop(pressed)
        board.close()

    def repair(self) -> None:
        """Every process goes on, the emergency stop is released."""
        for process in self._processes:
            process.send_signal(signal.SIGCONT)
        self.press_estop(False)

    def _process(self, name: str) -> subprocess.Popen[str]:
        return next(process for process in self._processes if name in process.args)  # type: ignore[operator]

    def _scanner_options(self) -> list[str]:
        scanner = self._base.scanner
        late_s = self._scenario.miscalibration.latency_s if has_hidden_latency(scanner) else 0.0
        clock = [late_s, 0.0] if scanner.sync == "shared_clock" else [100.0, late_s]
        options = [*PROFILE_RATE, "--clock-offset-s", f"{clock[0]:g}", "--latency-s", f"{clock[1]:g}"]
        options += ["--protocol", scanner.protocol]
        if scanner.sync == "trigger":
            options += ["--trigger-output", str(scanner.trigger_output)]
        if scanner.protocol == "profiler2":
            options += ["--reference-m", f"{scanner.profiler2.reference_mm / 1000.0:g}"]
            options += ["--address-in-words"] if scanner.profiler2.address_in_words else []
        return [*options, *self._more_scanner_options]

    def _coarse_options(self) -> list[str]:
        """A second scanner; mocks have a range finder for it, which speaks SCIP."""
        scanner = None if self._base.coarse is None else self._base.coarse.scanner
        if scanner is None or scanner.protocol != "scip":
            raise ConfigError("mocks have a coarse scanner for SCIP only", remedy="Set coarse.scanner.protocol: scip.")
        precision = ["--noise-m", f"{scanner.scip.range_noise_um * 1e-6:g}"]
        precision += ["--systematic-m", f"{scanner.scip.systematic_um * 1e-6:g}"]
        offset = ["--clock-offset-s", "0" if scanner.sync == "shared_clock" else "50"]
        place = ["--source", "world", "--coarse", "--seed", str(self._seed)]
        return ["--protocol", "scip", *place, *precision, *offset]

    def _coarse_at(self, device: str) -> CoarseConfig | None:
        """The coarse stage with its mock's device."""
        coarse = self._base.coarse
        if coarse is None:
            return None
        return coarse.model_copy(update={"scanner": coarse.scanner.model_copy(update={"device": device})})

    def _charger_options(self) -> list[str]:
        """Where the mock charger is reached, and the contract as the site has it."""
        site, (interface, channel) = self._base.charger, self._can
        where = ["--link", channel] if interface == "slcan" else ["--interface", interface, "--channel", channel]
        contract = ["--protection", site.protection, "--bitrate", str(site.bitrate_bps)]
        for name, address in (("robot", site.robot_address), ("charger", site.charger_address)):
            contract += [] if address is None else [f"--{name}-address", str(address)]
        contract += [] if site.dbc is None else ["--dbc", str(Path(site.dbc).resolve())]
        return [*where, *contract, "--lost-ms", f"{site.lost_ms:g}"]

    def _world(self) -> WorldSpec:
        config, port = self._base, load_port(self._base.port.model)
        unknown = self._scenario.miscalibration
        return WorldSpec(
            seed=self._seed,
            port=port.name,
            T_base_port=_vector(self._scenario.T_base_port),
            T_flange_scanner=_vector(config.scanner.T_flange_scanner.pose @ unknown.scanner),
            T_flange_coarse=None if config.coarse is None else _vector(config.coarse.scanner.T_flange_scanner.pose),
            T_flange_tcp=_vector(config.arm.T_flange_tcp.pose @ unknown.tool),
            joint_offsets=unknown.joints,
            link_errors_m=unknown.links_m,
            joint_compliance_rad_per_nm=unknown.compliance_rad_per_nm,
            T_port_tcp=_vector(port.T_port_tcp),
            panel=self._scenario.target or ("plain" if self._scenario.plain_panel else "port"),
            sphere_radius_m=self._scenario.sphere_radius_m,
            glare_until_sweep=self._scenario.glare_until_sweep,
            blocked_depth_m=self._scenario.blocked_depth_m,
            time_scale=self._time_scale,
            arm_model=config.arm.model,
            start_joints=HOME_JOINTS,
        )

    def _start(self, name: str, arguments: list[str], log: str | None = None) -> None:
        with (self._folder / (log or f"mock-{name}.log")).open("w", encoding="utf-8") as errors:
            self._processes.append(
                subprocess.Popen(
                    [sys.executable, "-m", "mocks", name, *arguments],
                    stdin=subprocess.DEVNULL,
                    process_group=0,  # a Ctrl-C at the terminal is the controller's to handle
                    stdout=subprocess.PIPE,
                    stderr=errors,
                    text=True,
                    cwd=self._folder,
                )
            )

    def _stop(self) -> None:
        for process in self._processes:
            process.terminate()
            process.send_signal(signal.SIGCONT)  # a frozen one ends too
        for process in self._processes:
            try:
                process.wait(timeout=5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()
        self._processes.clear()


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


def _await_ready(process: subprocess.Popen[str], longest_s: float) -> dict[str, object]:
    """The JSON line that a mock prints when it listens. Raises LinkOpenError."""
    assert process.stdout is not None
    end_s = time.monotonic() + longest_s
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
    raise LinkOpenError(
        f"the mock {name} did not start", remedy="Run `portdock mock scanner`, `arm` or `charger` by hand to see why."
    )


def _vector(pose: Pose) -> tuple[float, float, float, float, float, float]:
    x, y, z, rx, ry, rz = (float(v) for v in pose.vector)
    return x, y, z, rx, ry, rz
