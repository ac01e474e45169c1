"""Sweep and locate: from a viewpoint to a port estimate, over the scans of one mission."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from controller.cell import Cell
from controller.commands import Laser, MoveLinear
from controller.config import SiteConfig
from controller.faults import FaultCode, MissionFault
from controller.planning import Viewpoint, plan_viewpoint
from controller.sweep import SweepError, join
from drivers.base import ArmState
from perception.errors import InputError, PortdockError
from perception.estimate import PortEstimate, Prior
from perception.geometry import Pose
from perception.scan import Cloud, Profile, merge

log = logging.getLogger(__name__)

FIRST_PROFILE_S = 5.0
"""The laser is on, so a profile comes within this time; else the scanner is as good as lost."""

TRAILING_S = 30.0
"""How long profiles measured before the end of the motion may be on their way (a slow line, a busy host)."""

CLOCK_HISTORY_S = 60.0
"""Arm samples from before the sweep help to fit the arm's clock: the more, the more prompt ones are among them."""
MOST_SPOILED = 3
"""So many sweeps that cannot be used (profiles lost, times uncertain) are repeated from the same viewpoint."""

ProgressReport = Callable[[str, float, str], None]


class Looking:
    """The scans of one mission and what perception makes of them."""

    def __init__(self, cell: Cell, config: SiteConfig) -> None:
        self._cell = cell
        self._config = config
        self._clouds: list[Cloud] = []
        self._spoiled = 0
        self.scans_made = 0
        self.problem = ""
        """Why the last scan could not be used; empty if it could."""

    @property
    def cloud(self) -> Cloud | None:
        """The newest scan in the base frame."""
        return self._clouds[-1] if self._clouds else None

    def may_look_again(self, attempt: int) -> bool:
        """Whether another scan is due before giving up: one a viewpoint, and one more for each further attempt."""
        return self.scans_made < len(self._config.scan.viewpoints) + attempt - 1

    def forget_scans(self) -> None:
        """The last rung of the ladder trusts nothing that was seen before."""
        self._clouds.clear()

    def viewpoint(self) -> Viewpoint:
        """Where the next sweep looks from: each scan from another viewpoint."""
        views = self._config.scan.viewpoints
        return plan_viewpoint(
            self._config.port.T_base_port.pose,
            views[self.scans_made % len(views)],
            self._config.scan,
            self._config.scanner.T_flange_scanner.pose,
            self._config.arm.T_flange_tcp.pose,
        )

    def sweep(self, report: ProgressReport) -> None:
        """Laser on, one straight sweep at constant speed, laser off whatever happens; then join by time."""
        cell, scan = self._cell, self._config.scan
        view = self.viewpoint()
        profiles: list[Profile] = []
        began_s = cell.wall.now_s()

        def collect() -> bool:
            profiles.extend(cell.scanner.take())
            if (state := cell.arm_state()) is not None:
                report("sweep", _fraction(state.T_base_tcp, view), f"{len(profiles)} profiles")
            return bool(profiles)

        try:
            cell.do(Laser(on=True))
            if not cell.supervisor.wait(collect, FIRST_PROFILE_S):
                raise MissionFault(FaultCode.SCAN_FAILED, "the laser is on but no profile comes")
            cell.do(MoveLinear(view.T_base_tcp_end, scan.speed_mm_s / 1000.0, scan.acceleration_mm_s2 / 1000.0))
            cell.supervisor.wait(lambda: collect() and not cell.arm.motion().running)
            seen_s = _device_time_at(cell.wall.now_s(), profiles, cell.time_scale)
            cell.supervisor.wait(lambda: collect() and _newest_s(profiles) >= seen_s, TRAILING_S)
        finally:
            cell.do(Laser(on=False))
        if cell.arm.motion().failed:
            raise cell.explained(FaultCode.MOTION_FAILED, cell.arm.motion().detail)
        self._keep(profiles, cell.arm.history(began_s - CLOCK_HISTORY_S))
        if self.problem and self._spoiled < MOST_SPOILED:
            self._spoiled += 1  # the viewpoint is not to blame: the same one again
        else:
            self.scans_made += 1

    def _keep(self, profiles: list[Profile], states: list[ArmState]) -> None:
        scanner = self._config.scanner
        try:
            scan = join(
                profiles,
                states,
                scanner.T_flange_scanner.pose,
                latency_s=self._cell.profile_latency_s,
                time_scale=self._cell.time_scale,
                max_lost_share=scanner.max_lost_profiles_percent / 100.0,
                shared_clock=scanner.sync == "shared_clock",
            )
            self._clouds.append(scan.to_cloud())
            self.problem = ""
        except (SweepError, InputError) as error:
            self.problem = error.cause
            log.warning("this scan cannot be used: %s", error)

    def locate(self) -> PortEstimate | None:
        """All scans merged; if that is refused, the newest alone. None when the last scan could not be used."""
        if self.problem or not self._clouds:
            return None
        estimate = self._ask(merge(self._clouds))
        if not estimate.accepted and len(self._clouds) > 1:
            alone = self._ask(self._clouds[-1])
            return alone if alone.accepted else estimate
        return estimate

    def _ask(self, cloud: Cloud) -> PortEstimate:
        """Perception works in its own process; the tick goes on meanwhile."""
        future = self._cell.locator.submit(cloud, self._prior())
        self._cell.supervisor.wait(future.done)
        try:
            return future.result()
        except InputError as error:
            return _refused(self._config.port.model, self._prior(), error)
        except PortdockError as error:
            raise MissionFault(FaultCode.PERCEPTION_FAILED, error.cause) from error
        except Exception as error:
            raise MissionFault(FaultCode.PERCEPTION_FAILED, f"{type(error).__name__}: {error}") from error

    def _prior(self) -> Prior:
        port = self._config.port
        tilt, roll = np.deg2rad([port.tilt_deg, port.roll_deg])
        return Prior(port.T_base_port.pose, port.lateral_mm / 1000.0, port.along_mm / 1000.0, float(tilt), float(roll))


def _refused(model: str, prior: Prior, error: InputError) -> PortEstimate:
    """What cannot be located at all is a refusal with the reason, not a fault."""
    return PortEstimate(
        port=model,
        T_ref_port=prior.T_ref_port,
        ref="base",
        covariance=np.full((6, 6), np.inf),
        rms_residual_m=float("inf"),
        inlier_ratio=0.0,
        runner_up_margin=0.0,
        accepted=False,
        reasons=(error.cause,),
        timings_s=(("total", 0.0),),
        verdict="no-port",
    )


def _newest_s(profiles: list[Profile]) -> float:
    """Device time of the newest profile; profiles without one count as immediate."""
    newest = profiles[-1].device_time_s
    return float("inf") if newest is None else newest


def _device_time_at(host_s: float, profiles: list[Profile], time_scale: float) -> float:
    """What the scanner's clock showed at a host time, counted from the first profile: good to its delay on the line."""
    first = profiles[0]
    return -float("inf") if first.device_time_s is None else first.device_time_s + (host_s - first.time_s) * time_scale


def _fraction(T_base_tcp: Pose, view: Viewpoint) -> float:
    """How much of the sweep is done, 0 to 1."""
    along = view.T_base_tcp_end.translation - view.T_base_tcp_start.translation
    done = (T_base_tcp.translation - view.T_base_tcp_start.translation) @ along / (along @ along)
    return float(np.clip(done, 0.0, 1.0))
