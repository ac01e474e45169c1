"""A daemon's life: lock, socket, links, jobs, and an end in the right order whatever ends it.

SIGTERM and SIGINT finish safely: a mission on its way is stopped as `portdock stop` stops it; docked, the power goes
off, the plug stays locked and nothing moves. A second signal freezes motion and ends. SIGHUP changes nothing: it says
what a restart would change. kill -9 needs no help: the arm's watchdog stops the arm, the charger's supervision ends
the charge, the kernel gives up the lock, and the next start looks for a plug before anything else.
"""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from controller.assembly import Assembly, Evidence
from controller.config import SiteConfig
from controller.daemon.aftermath import recover_recordings
from controller.daemon.changes import describe_changes
from controller.daemon.desk import JobDesk
from controller.daemon.lock import ProcessLock
from controller.daemon.notify import Notifier
from controller.daemon.places import socket_of_daemon, state_folder
from controller.daemon.protocol import Answer, NoteEvent, Request
from controller.daemon.records import Recordings
from controller.daemon.server import CommandServer
from controller.faults import Outcome
from controller.looking import Looking
from controller.mission import Mission
from controller.states import RESTING, State
from controller.status.board import StatusBoard
from controller.status.web import StatusWeb
from controller.summary import MissionSummary
from controller.task import Progress
from drivers.base import MonotonicClock

log = logging.getLogger(__name__)

ENDING = (signal.SIGTERM, signal.SIGINT)

Assemble = Callable[[SiteConfig, Evidence, ExitStack, Callable[[], None]], Assembly]
"""Opens the devices: (config, where their traffic goes, what to close, what each tick calls) -> a live cell."""


@dataclass(frozen=True, slots=True)
class Setting:
    """What a daemon is started with."""

    config: SiteConfig
    robot: str
    """Name of the lock and of the memory: one daemon a robot."""
    config_path: Path | None = None
    looking: Callable[[Assembly], Looking] | None = None
    """How a job looks for the port, where not as configured."""
    reports: bool = True


class Daemon:
    """From ``run`` to its return."""

    def __init__(self, setting: Setting, assemble: Assemble) -> None:
        self._setting, self._assemble = setting, assemble
        self._clock = MonotonicClock()
        self._notifier = Notifier(self._clock)
        self._board = StatusBoard(self._clock)
        self._memory = state_folder(setting.config.service, setting.robot)
        self._server = CommandServer(socket_of_daemon(setting.config.service), self._answer, self._signalled)
        self._desk = JobDesk(self._server.publish)
        self._ready = False

    def run(self) -> None:
        """Serve until told to end. Raises what the opening of a device raises; nothing later on."""
        config = self._setting.config
        with ExitStack() as closing:
            closing.callback(self._notifier.close)
            closing.callback(self._server.close)
            closing.enter_context(_signals_into(self._server.wake_write))
            self._server.start()
            closing.callback(StatusWeb(config.service.http_port, self._board.status).close)
            self._notifier.status("opening the devices")
            recover_recordings(Path(config.recording.folder))
            records = Recordings(config, self._server.publish, self._concluded, self._setting.reports)
            live = self._assemble(config, records, closing, self._notifier.alive)
            closing.callback(records.close)
            records.attach(live.cell, live.model, self._memory)
            self._board.attach(live.cell)
            mission = self._mission(live, records)
            records.on_transition = lambda source, event, target: self._entered(mission)
            self._desk.open(live.cell.supervisor, lambda: mission.state)
            mission.serve(self._desk)
            log.info("end: %s", self._memory)

    def _mission(self, live: Assembly, records: Recordings) -> Mission:
        look = self._setting.looking
        return Mission(
            live.cell,
            self._setting.config,
            live.T_port_tcp_mated,
            records,
            self._memory,
            lambda: Looking(live.cell, self._setting.config, live.coarse) if look is None else look(live),
        )

    # --- told by the mission ------------------------------------------------------------------------------------------

    def _entered(self, mission: Mission) -> None:
        state, job = mission.state, mission.now
        self._board.entered(state)
        if state is State.OFFLINE:
            return
        if job.under_way and job.outcome is None and job.goal is not None and state not in RESTING:
            self._board.began(job.goal.value)
        at_rest = state in RESTING or state is State.CHARGING
        if at_rest and not self._ready:
            self._ready = True
            self._notifier.ready(state.name)
        else:
            self._notifier.status(state.name)

    def _concluded(self, outcome: Outcome, job: Progress, summary: MissionSummary | None) -> None:
        self._board.ended(outcome, job.attempt)
        if outcome.fault is not None:
            self._notifier.status(f"{outcome.kind}: {outcome.fault}. {outcome.fault.remedy}")
        self._desk.summary = {} if summary is None else summary.to_json()

    # --- told by clients and signals, in the socket's thread ----------------------------------------------------------

    def _answer(self, request: Request) -> Answer:
        if request is Request.STATUS:
            return Answer("status", status=self._board.status().to_json())
        return self._desk.submit(request)

    def _signalled(self, number: int) -> None:
        if number == signal.SIGHUP:
            self._tell_changes()
        elif number in ENDING and not self._desk.leaving:
            log.warning("signal %s: finishing safely, then the end; a second signal ends at once", number)
            self._notifier.stopping("finishing safely")
            self._desk.leave()
        elif number in ENDING:
            log.warning("signal %s again: motion is frozen", number)
            self._desk.leave_now()

    def _tell_changes(self) -> None:
        for line in describe_changes(self._setting.config, self._setting.config_path):
            log.warning("%s", line)
            self._server.publish(NoteEvent(line))


def run_daemon(setting: Setting, assemble: Assemble) -> None:
    """One daemon for one robot. Raises RobotTakenError, SocketError, LinkOpenError."""
    service = setting.config.service
    socket = socket_of_daemon(service)
    robot = ProcessLock(state_folder(service, setting.robot) / "lock", f"the robot {setting.robot}")
    with robot, ProcessLock(socket.with_name(socket.name + ".lock"), f"the socket {socket}"):
        Daemon(setting, assemble).run()


@contextmanager
def _signals_into(descriptor: int) -> Iterator[None]:
    """While inside, signals are bytes in a pipe: a handler might interrupt whoever holds a lock that it needs."""
    numbers = (*ENDING, signal.SIGHUP)
    before = {number: signal.signal(number, lambda *_: None) for number in numbers}
    old = signal.set_wakeup_fd(descriptor, warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(old)
        for number, handler in before.items():
            signal.signal(number, handler)
