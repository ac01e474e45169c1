"""An arm's two links as one thing: state link and control worker opened, checked, lost, restarted and closed together.

Also ends the controller's program over the dashboard, the third way to the robot, when a safety stop begins or the
worker is lost: a paused program could be resumed with its old motion, and a script without its client has no purpose.
From a safety stop on no command but a stop reaches the worker, until the links are restarted: ur_rtde looks at two of
the six kinds of stop only, and in the others waits seconds for a program that has ended.
"""

from __future__ import annotations

import logging
import threading

import numpy as np

from drivers.arm import messages as m
from drivers.arm.dashboard import Dashboard
from drivers.arm.errors import ControlLinkLostError, ReadBackError
from drivers.arm.opening import check_robot, start_error
from drivers.arm.outputs import OutputLink
from drivers.arm.settings import UrSettings
from drivers.arm.telemetry import Telemetry
from drivers.arm.worker_client import WorkerClient
from drivers.base import (
    ArmState,
    ByteSink,
    Clock,
    DriverError,
    LinkHealth,
    LinkLostError,
    LinkOpenError,
    ProtocolError,
    SafetyMode,
)
from perception.geometry import Pose

log = logging.getLogger(__name__)

SAFE = (SafetyMode.NORMAL, SafetyMode.REDUCED)
SAME_TCP_M, SAME_TCP_RAD = 1e-5, 1e-4
SAME_PAYLOAD_KG, SAME_COG_M = 0.01, 0.001
END_PROGRAM_S = 0.5
"""The dashboard answers a stop within milliseconds; the supervisor's tick may be waiting for it."""
PAYLOAD_SHOWN_S = 1.0
"""Within this the controller's state must show the payload that was set."""


class Links:
    """Both links of one arm."""

    def __init__(self, settings: UrSettings, sink: ByteSink, clock: Clock) -> None:
        self._settings = settings
        self._sink = sink
        self._clock = clock
        self._telemetry: Telemetry | None = None
        self._worker: WorkerClient | None = None
        self._outputs = OutputLink(settings.host)
        self._ender: threading.Thread | None = None
        self._restarting = False
        self._safe = True
        self._ended_by: SafetyMode | None = None
        """The safety stop that ended the program; stays until the links are restarted, also when it is released."""

    # --- life --------------------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Check the robot, start both links, set TCP and payload and read them back. Raises LinkOpenError."""
        check_robot(self._settings, self._clock)
        self._ended_by = None
        try:
            if not self.fresh:
                self._close_telemetry()
                self._open_telemetry()
            self._open_worker()
            self._check_payload()
        except BaseException:
            self._close_worker()
            raise

    def restart(self) -> None:
        """A new worker and script; the state link stays if it is sound, and also if this fails."""
        self._restarting = True
        try:
            self._close_worker()
            if self._ender is not None:
                self._ender.join()
            self._end_program_quietly()
            self._outputs.close()  # a controller that was switched off has forgotten it
            self.open()
        finally:
            self._restarting = False

    def close(self) -> None:
        """End the script and all links. Idempotent."""
        self._close_worker()
        self._close_telemetry()
        self._outputs.close()

    def set_output(self, number: int, level: bool) -> None:
        """Switch a standard digital output, 0 to 7, over a link of its own. Raises LinkLostError, ProtocolError."""
        self._outputs.set(number, level)

    def _open_telemetry(self) -> None:
        s = self._settings
        self._safe = True
        try:
            self._telemetry = Telemetry(
                s.host, s.frequency_hz, s.connect_timeout_s, s.T_flange_tcp, self._sink, self._clock, self._on_state
            )
        except (LinkLostError, ProtocolError, OSError) as error:
            raise LinkOpenError(f"the arm's state link cannot be opened: {error}") from error

    def _close_telemetry(self) -> None:
        telemetry, self._telemetry = self._telemetry, None
        if telemetry is not None:
            telemetry.close()

    def _open_worker(self) -> None:
        s = self._settings
        self._close_worker()
        self._worker = WorkerClient(lambda reason: self._begin_to_end_program(), self._settings.patience)
        tcp = tuple(s.T_flange_tcp.vector.tolist())
        start = m.Start(
            s.host, s.frequency_hz, s.upper_registers, s.watchdog_hz, tcp, s.payload_kg, s.centre_of_gravity_m
        )
        answer = self._worker.start(start, s.start_timeout_s * s.patience)
        if isinstance(answer, m.StartFailed):
            raise start_error(answer.reason)
        shown = Pose.from_vector(answer.tcp)
        if shown.distance_to(s.T_flange_tcp) > SAME_TCP_M or shown.angle_to(s.T_flange_tcp) > SAME_TCP_RAD:
            raise ReadBackError("the controller reports another TCP than the one that was set")

    def _close_worker(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.quit()

    def _check_payload(self) -> None:
        s = self._settings
        deadline = self._clock.now_s() + PAYLOAD_SHOWN_S * s.patience
        while True:
            mass, cog = self.telemetry.payload()
            if abs(mass - s.payload_kg) <= SAME_PAYLOAD_KG and np.allclose(cog, s.centre_of_gravity_m, atol=SAME_COG_M):
                return
            if self._clock.now_s() > deadline:
                raise ReadBackError(
                    f"the controller reckons with {mass:.2f} kg at {np.round(cog, 3).tolist()} m, "
                    f"not {s.payload_kg:.2f} kg at {list(s.centre_of_gravity_m)} m"
                )
            self._clock.sleep(0.01)

    # --- the two links -----------------------------------------------------------------------------------------------

    @property
    def telemetry(self) -> Telemetry:
        """The state link. Raises LinkLostError if it is not open."""
        if self._telemetry is None:
            raise LinkLostError("the arm's link is not open")
        return self._telemetry

    @property
    def worker(self) -> WorkerClient:
        """The control worker. Raises ControlLinkLostError if there is none."""
        if self._worker is None:
            raise ControlLinkLostError("the arm's control link is not open")
        return self._worker

    @property
    def fresh(self) -> bool:
        """Whether state is coming in."""
        return self._telemetry is not None and self._telemetry.is_fresh(self._settings.freshness_s)

    @property
    def newest(self) -> ArmState | None:
        """The newest sample, however old."""
        return None if self._telemetry is None else self._telemetry.newest()

    def ask(self, command: m.Command, timeout_s: float) -> m.Reply:
        """The control worker's answer; that a safety stop has ended the program, at once. Raises ControlLinkLostError.

        A worker that is lost in its wait for such a program is that, too, and no lost link.
        """
        may_pass = isinstance(command, m.Stop)
        if self.ended is None or may_pass:
            try:
                return self.worker.ask(command, timeout_s)
            except ControlLinkLostError:
                if self.ended is None or may_pass:
                    raise
        return m.Reply(0, "program-stopped", self.ended)

    def kick(self) -> None:
        """Pass a kick on; none is owed while the worker is replaced. Raises ControlLinkLostError."""
        if not self._restarting:
            self.worker.kick()

    @property
    def ended(self) -> str | None:
        """Which safety stop has ended the program since the links were opened, or None."""
        return None if self._ended_by is None else f"the program ended in safety mode {self._ended_by.name}"

    @property
    def lost(self) -> str | None:
        """Why the arm cannot be driven, or None."""
        worker = self._worker  # once: another thread may close it
        if worker is None:
            return "the control link is not open"
        if worker.lost is not None:
            return f"control link: {worker.lost}"
        return None if self.fresh else "state link: no fresh state"

    def health(self) -> LinkHealth:
        """Of both links: up only if state is fresh and the control link lives."""
        telemetry = self._telemetry  # once: another thread may close it
        if telemetry is None:
            return LinkHealth(False, None, detail="not open")
        seen = telemetry.health(self._settings.freshness_s)
        return LinkHealth(self.lost is None, seen.last_rx_s, seen.counters, self.lost or "")

    # --- ending the program ------------------------------------------------------------------------------------------

    def end_program(self) -> None:
        """Stop the program, and with it the arm, over the dashboard. Raises ControlLinkLostError if it is not there."""
        try:
            with Dashboard(self._settings.host, END_PROGRAM_S) as dashboard:
                dashboard.stop()
        except ProtocolError as error:  # such as no program to stop
            log.warning("%s", error)
        except LinkLostError as error:
            raise ControlLinkLostError(f"the arm cannot be stopped over the network: {error}") from error

    def _end_program_quietly(self) -> None:
        try:
            self.end_program()
        except DriverError as error:
            log.error("%s", error)

    def _begin_to_end_program(self) -> None:
        """From threads that must not wait for the dashboard."""
        self._ender = threading.Thread(target=self._end_program_quietly, name="arm-end-program", daemon=True)
        self._ender.start()

    def _on_state(self, state: ArmState) -> None:
        """Reader thread: when a safety stop begins, end the program, so that no release lets the old motion go on."""
        safe = state.safety in SAFE
        if self._safe and not safe:
            log.warning("safety mode %s: the program is ended", state.safety.name)
            self._ended_by = state.safety
            self._begin_to_end_program()
        self._safe = safe
