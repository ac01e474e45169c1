"""A whole daemon with stand-in devices in a process of its own: real socket, signals, lock, files; no wires, quick.

The import of all that portdock needs takes seconds, so one process imports it and forks a daemon whenever a test wants
one (``python -m tests.unit.daemon_rig``: a line of JSON for each). What the stand-ins are in (plug depth, lock, power)
is kept in ``FOLDER/world.json``, so that a daemon that was killed finds its world as it left it.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from controller.assembly import Assembly, Evidence
from controller.config import SiteConfig, load_config
from controller.daemon.client import DaemonClient
from controller.daemon.life import Setting, run_daemon
from controller.daemon.protocol import Request, ResultEvent, StateEvent
from controller.perception_worker import PreparedModel
from drivers.base import PlugLock
from perception.errors import PortdockError
from perception.geometry import Pose
from tests.unit.mission_rig import Rig, StandInLooking

LIMIT_S = 60.0


# --- the process under test -------------------------------------------------------------------------------------------


def site(folder: Path) -> SiteConfig:
    base = load_config()
    changes: dict[str, dict[str, Any]] = {
        "service": {"socket": str(folder / "s.sock"), "state_folder": str(folder / "state"), "http_port": 0},
        "recording": {"folder": str(folder / "runs")},
        "host": {"stall_ms": 2000.0},
    }
    return base.model_copy(update={k: getattr(base, k).model_copy(update=v) for k, v in changes.items()})


def main(folder: Path) -> None:
    import logging

    logging.basicConfig(level=logging.INFO, format="%(name)s %(message)s", stream=sys.stderr)
    config = site(folder)
    rig = Rig(folder, port=config.port.T_base_port.pose)
    _restore(rig, folder / "world.json")

    def assemble(c: SiteConfig, evidence: Evidence, closing: ExitStack, alive: Callable[[], None]) -> Assembly:
        rig.cell.records = evidence
        rig.supervisor._alive = lambda: (alive(), _exchange(rig, folder))[0]
        rig.supervisor.start()
        closing.callback(lambda: _keep(rig, folder / "world.json"))
        closing.callback(rig.supervisor.close)
        return Assembly(rig.cell, PreparedModel("none", np.zeros((1, 3))), rig.T_port_tcp)

    looking: Any = lambda live: StandInLooking(rig.cell, config, [True])  # noqa: E731
    run_daemon(Setting(config, "stand-in", None, looking, reports=False), assemble)


SILENT = "charger-silent"
"""While a file of this name is in the folder, the charger is not heard."""


def _exchange(rig: Rig, folder: Path) -> None:
    rig.charger.lost = (folder / SILENT).exists()
    _keep(rig, folder / "world.json")


def _keep(rig: Rig, path: Path) -> None:
    values = {
        "pose": rig.arm.pose.matrix.tolist(),
        "lock": int(rig.charger._lock),
        "power": rig.charger._power,
        "moves": rig.arm.moves,
    }
    path.with_suffix(".tmp").write_text(json.dumps(values))
    path.with_suffix(".tmp").replace(path)


def _restore(rig: Rig, path: Path) -> None:
    if path.exists():
        values = json.loads(path.read_text())
        rig.arm.pose = Pose.from_matrix(np.array(values["pose"]))
        rig.charger._lock, rig.charger._power = PlugLock(values["lock"]), values["power"]


# --- the tests' side --------------------------------------------------------------------------------------------------


class Nursery:
    """The process that has imported everything and forks daemons."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.unit.daemon_rig"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).parents[2],
        )

    def ask(self, **what: object) -> int:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(what) + "\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline())

    def close(self) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(LIMIT_S)
        self._process.stdout.close()


def serve_nursery() -> None:
    """Start a daemon, or tell how one has ended, for each line; no thread runs here, so that a fork is safe."""
    for line in sys.stdin:
        what = json.loads(line)
        if "wait" in what:
            answer = os.waitstatus_to_exitcode(os.waitpid(what["wait"], 0)[1])
        else:
            answer = os.fork() or _become_daemon(Path(what["folder"]), what["environment"])
        sys.stdout.write(f"{answer}\n")
        sys.stdout.flush()


def _become_daemon(folder: Path, environment: dict[str, str]) -> NoReturn:
    os.environ.update(environment)
    log = os.open(folder / "daemon.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for descriptor in (1, 2):
        os.dup2(log, descriptor)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    try:
        main(folder)
    except BaseException as error:
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
        os._exit(1)
    os._exit(0)


class Service:
    """A running daemon and what it said."""

    def __init__(self, nursery: Nursery, folder: Path, environment: dict[str, str] | None = None) -> None:
        self.folder, self._nursery = folder, nursery
        self.pid = nursery.ask(folder=str(folder), environment=environment or {})
        self._status: int | None = None

    @property
    def socket(self) -> Path:
        return self.folder / "s.sock"

    def client(self) -> DaemonClient:
        """A connection, as soon as the daemon takes jobs."""
        end_s = time.monotonic() + LIMIT_S
        while time.monotonic() < end_s:
            try:
                client = DaemonClient(self.socket)
                status = client.ask(Request.STATUS).status
                if status and status["state"] not in ("OFFLINE", "SELF_CHECK"):
                    return client
                client.__exit__(None, None, None)
            except PortdockError:
                assert Path(f"/proc/{self.pid}/cmdline").read_bytes(), self.text()
            time.sleep(0.05)
        raise AssertionError(self.text())

    def status(self) -> dict[str, Any]:
        with self.client() as client:
            return dict(client.ask(Request.STATUS).status or {})

    def job(self, request: Request) -> ResultEvent:
        """Ask for a job and wait for its result."""
        with self.client() as client:
            client.ask(Request.SUBSCRIBE)
            answer = client.ask(request)
            assert answer.answer == "accepted", answer
            for event in client.events(LIMIT_S):
                if isinstance(event, ResultEvent) and (answer.job is None or event.job == answer.job):
                    return event
        raise AssertionError("no result")

    def begin_until(self, request: Request, state: str) -> None:
        """Ask for a job and return when it has come to a state."""
        with self.client() as client:
            client.ask(Request.SUBSCRIBE)
            assert client.ask(request).answer == "accepted"
            for event in client.events(LIMIT_S):
                if isinstance(event, StateEvent) and event.state == state:
                    return

    def world(self) -> dict[str, Any]:
        values: dict[str, Any] = json.loads((self.folder / "world.json").read_text())
        return values

    def signal(self, number: int) -> None:
        os.kill(self.pid, number)

    def ended(self) -> int:
        """Its exit status, once it has one; negative for a signal."""
        if self._status is None:
            self._status = self._nursery.ask(wait=self.pid)
        return self._status

    def says(self, text: str) -> None:
        """Wait for a line of its log."""
        end_s = time.monotonic() + LIMIT_S
        while text not in self.text() and time.monotonic() < end_s:
            time.sleep(0.002)

    def text(self) -> str:
        return (self.folder / "daemon.log").read_text()

    def close(self) -> None:
        if self._status is None:
            self.signal(signal.SIGKILL)
            self.ended()


if __name__ == "__main__":
    serve_nursery()
