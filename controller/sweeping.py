"""Ways to sweep: how the arm moves while the laser looks, and how each profile finds the pose it was taken from.

``timestamp`` and ``shared_clock``: the arm moves on, poses are interpolated at the profiles' times.
``trigger``: the same, with an edge of the arm's digital output for each profile (``controller.triggered``).
``stop_and_go``: the arm rests for each profile, so that times decide nothing.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from controller.cell import Cell
from controller.commands import Laser, MoveLinear, SetOutput
from controller.config import SiteConfig
from controller.faults import FaultCode, MissionFault
from controller.planning import Viewpoint
from controller.scanner_facts import scanner_facts
from controller.sweep import MIN_PROFILES, SweepError, Timed, Timing, scan_of, timed
from controller.triggered import timed_by_trigger, unevenness
from drivers.base import ArmState
from perception.errors import PortdockError
from perception.geometry import Pose
from perception.scan import Profile, Scan

log = logging.getLogger(__name__)

FIRST_PROFILE_S = 5.0
"""The laser is on, so a profile comes within this time; else the scanner is as good as lost."""
SILENT_LINK_S = 3.0
"""Of wall time: a lost link is told by then, and is the cause where the scanner waits for what is lost."""
TRAILING_S = 30.0
"""How long profiles measured before the end of the motion may be on their way (a slow line, a busy host)."""
HISTORY_S = {"timestamp": 60.0, "shared_clock": 1.0, "trigger": 0.02}
"""Arm samples from before the sweep: they help to fit the arm's clock, the more, the more prompt ones are among them.
With one clock for both what surely lies before the first profile is enough. Edges of the sweep before are no edges of
this one."""
REST_S = 0.02
"""After it stands by its own word the arm still swings a little: no profile from within this time counts."""
STILL_M_S = 0.0005

ProgressReport = Callable[[str, float, str], None]


class Collector:
    """Takes the scanner's profiles while it is waited for something, and tells how far the sweep is."""

    def __init__(
        self,
        cell: Cell,
        passes: Sequence[Viewpoint],
        report: ProgressReport,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        self._meanwhile = meanwhile
        self._cell = cell
        self._passes = passes
        self._report = report
        self.current = 0
        """Number of the pass under way."""
        self.profiles: list[Profile] = []

    def collect(self) -> bool:
        """Take what has come; whether anything has come yet."""
        self._meanwhile()
        self.profiles.extend(self._cell.scanner.take())
        if (state := self._cell.arm_state()) is not None:
            done = self.current + _fraction(state.T_base_tcp, self._passes[self.current])
            self._report("sweep", done / len(self._passes), f"{len(self.profiles)} profiles")
        return bool(self.profiles)

    def travel(self, target: Pose, config: SiteConfig) -> None:
        """Straight to ``target`` at the sweep's speed, collecting. Raises MissionFault."""
        cell, scan = self._cell, config.scan
        cell.do(MoveLinear(target, scan.speed_mm_s / 1000.0, scan.acceleration_mm_s2 / 1000.0))
        cell.supervisor.wait(lambda: self.collect() and not cell.arm.motion().running)
        if cell.arm.motion().failed:
            raise cell.explained(FaultCode.MOTION_FAILED, cell.arm.motion().detail)


class Pulser:
    """Edges for a scanner in trigger mode, at uneven intervals so that no edge can be taken for its neighbour."""

    def __init__(self, cell: Cell, output: int, rate_hz: float) -> None:
        self._cell = cell
        self._output = output
        self._half_s = 0.5 / rate_hz / cell.time_scale
        self._number = 0
        self._level = False
        self._next_s = cell.wall.now_s()

    def advance(self) -> None:
        """Switch the output if that is due."""
        now_s = self._cell.wall.now_s()
        if now_s < self._next_s:
            return
        self._level = not self._level
        self._cell.do(SetOutput(self._output, self._level))
        self._number += self._level
        longer = 1.0 if self._level else 1.0 + 2.0 * unevenness(self._number)
        self._next_s = now_s + self._half_s * longer


def run_sweep(cell: Cell, config: SiteConfig, passes: Sequence[Viewpoint], report: ProgressReport) -> Scan:
    """Laser on, all passes, laser off whatever happens; the profiles with their poses.

    :raises MissionFault: no profile comes, or the arm fails
    :raises SweepError: the sweep cannot be used
    """
    if config.scanner.sync == "stop_and_go":
        return _stop_and_go(cell, config, passes, report)
    sweep = taken_moving(cell, config, passes, report)
    return scan_of(sweep, config.scanner.T_flange_scanner.pose)


def taken_moving(cell: Cell, config: SiteConfig, passes: Sequence[Viewpoint], report: ProgressReport) -> Timed:
    """Each pass at constant speed; profiles and the flange's track in one time. Raises MissionFault, SweepError."""
    scanner, timing = config.scanner, timing_of(cell, config)
    if scanner.sync != "trigger":
        return timed(*_take_moving(cell, config, passes, report), timing)
    pulser = Pulser(cell, scanner.trigger_output, scanner.trigger_hz)
    try:
        profiles, states = _take_moving(cell, config, passes, report, pulser.advance)
    finally:
        cell.do(SetOutput(scanner.trigger_output, False))
    return timed_by_trigger(profiles, states, scanner.trigger_output, timing)


def timing_of(cell: Cell, config: SiteConfig) -> Timing:
    """How profiles and arm samples of this cell come to one time."""
    scanner, facts = config.scanner, scanner_facts(config.scanner)
    return Timing(
        latency_s=cell.profile_latency_s,
        calibrated_s=scanner.latency_ms / 1000.0,
        time_scale=cell.time_scale,
        max_lost_share=scanner.max_lost_profiles_percent / 100.0,
        shared_clock=scanner.sync == "shared_clock",
        enough_s=facts.systematic_m / (config.scan.speed_mm_s / 1000.0) / cell.time_scale,
        clock_period_s=facts.clock_period_s,
    )


@contextmanager
def _laser(cell: Cell, collector: Collector) -> Iterator[None]:
    """On until the first profile comes and while the body runs, then off whatever happened."""
    try:
        cell.do(Laser(on=True))
        if not cell.supervisor.wait(collector.collect, max(FIRST_PROFILE_S, SILENT_LINK_S * cell.time_scale)):
            raise MissionFault(FaultCode.SCAN_FAILED, "the laser is on but no profile comes")
        yield
    except BaseException:
        try:
            cell.do(Laser(on=False))
        except PortdockError as error:
            log.error("%s", error)  # what ended the sweep is the cause
        raise
    cell.do(Laser(on=False))


def _take_moving(
    cell: Cell,
    config: SiteConfig,
    passes: Sequence[Viewpoint],
    report: ProgressReport,
    meanwhile: Callable[[], None] = lambda: None,
) -> tuple[list[Profile], list[ArmState]]:
    """The profiles and the arm's samples around them; ``meanwhile`` is called at every look. Raises MissionFault."""
    collector, began_s = Collector(cell, passes, report, meanwhile), cell.wall.now_s()
    since_s = max(began_s - HISTORY_S[config.scanner.sync], cell.recorded_since_s)
    states: list[ArmState] = cell.arm.history(since_s)

    def remember() -> None:
        states.extend(cell.arm.history(states[-1].time_s if states else began_s))

    with _laser(cell, collector):
        for number, view in enumerate(passes):
            collector.current = number
            if number:
                collector.travel(view.T_base_tcp_start, config)
            collector.travel(view.T_base_tcp_end, config)
            remember()
        profiles = collector.profiles
        seen_s = _device_time_at(cell.wall.now_s(), profiles, cell.time_scale)
        cell.supervisor.wait(lambda: collector.collect() and _newest_s(profiles) >= seen_s, TRAILING_S)
    remember()
    if states:
        cell.on_sweep(len(profiles), states[0].time_s, states[-1].time_s)
    return profiles, states


def _stop_and_go(cell: Cell, config: SiteConfig, passes: Sequence[Viewpoint], report: ProgressReport) -> Scan:
    """One profile from each stop: the first that was surely taken at rest."""
    collector = Collector(cell, passes, report)
    taken: list[tuple[Profile, Pose]] = []
    missed = 0
    with _laser(cell, collector):
        for number, view in enumerate(passes):
            collector.current = number
            for target in _stops(view, config.scan.step_mm / 1000.0):
                collector.travel(target, config)
                cell.settle(STILL_M_S, TRAILING_S)
                profile, state = _at_rest(cell, collector), cell.arm_state()
                if profile is None or state is None:
                    missed += 1
                else:
                    taken.append((profile, state.T_base_flange))
                collector.profiles.clear()
    return _of_stops(taken, missed, config)


def _at_rest(cell: Cell, collector: Collector) -> Profile | None:
    """The first profile measured after now, None if none comes."""
    resting_s = cell.wall.now_s() + REST_S / cell.time_scale
    found: list[Profile] = []

    def came() -> bool:
        collector.collect()
        delay_s = _least_delay_s(collector.profiles, cell.time_scale)
        latency_s = cell.profile_latency_s / cell.time_scale
        found[:] = [
            profile
            for profile in collector.profiles
            if _measured_s(profile, delay_s, cell.time_scale) - latency_s >= resting_s
        ]
        return bool(found)

    cell.supervisor.wait(came, FIRST_PROFILE_S)
    return found[0] if found else None


def _of_stops(taken: Sequence[tuple[Profile, Pose]], missed: int, config: SiteConfig) -> Scan:
    lost = missed / max(1, missed + len(taken))
    allowed = config.scanner.max_lost_profiles_percent / 100.0
    if len(taken) < MIN_PROFILES or lost > allowed:
        raise SweepError(f"{missed} of {missed + len(taken)} stops gave no profile (at most {allowed:.0%} allowed)")
    profiles, poses = zip(*taken, strict=True)
    return Scan(tuple(profiles), tuple(poses), config.scanner.T_flange_scanner.pose)


def _stops(view: Viewpoint, step_m: float) -> list[Pose]:
    """Poses from one end of a pass to the other, ``step_m`` apart or a little less."""
    start, end = view.T_base_tcp_start, view.T_base_tcp_end
    count = max(1, int(np.ceil(np.linalg.norm(end.translation - start.translation) / step_m)))
    return [
        Pose(start.rotation, start.translation + k / count * (end.translation - start.translation))
        for k in range(count + 1)
    ]


def _least_delay_s(profiles: Sequence[Profile], time_scale: float) -> float:
    """Host's time less the device's, of the promptest profile."""
    differences = [p.time_s - p.device_time_s / time_scale for p in profiles if p.device_time_s is not None]
    return min(differences, default=0.0)


def _measured_s(profile: Profile, delay_s: float, time_scale: float) -> float:
    """Host's time by which the profile was measured; its arrival where the device sends no time."""
    return profile.time_s if profile.device_time_s is None else profile.device_time_s / time_scale + delay_s


def _newest_s(profiles: Sequence[Profile]) -> float:
    """Device time of the newest profile; profiles without one count as immediate."""
    newest = profiles[-1].device_time_s
    return float("inf") if newest is None else newest


def _device_time_at(host_s: float, profiles: Sequence[Profile], time_scale: float) -> float:
    """What the scanner's clock showed at a host time, counted from the first profile: good to its delay on the line."""
    first = profiles[0]
    return -float("inf") if first.device_time_s is None else first.device_time_s + (host_s - first.time_s) * time_scale


def _fraction(T_base_tcp: Pose, view: Viewpoint) -> float:
    """How much of a pass is done, 0 to 1."""
    along = view.T_base_tcp_end.translation - view.T_base_tcp_start.translation
    done = (T_base_tcp.translation - view.T_base_tcp_start.translation) @ along / (along @ along)
    return float(np.clip(done, 0.0, 1.0))
