"""Which pose a calibration's next sweep is made from: of those the arm can reach, the one that promises most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from controller.calibrations.views import View, candidates, reachable, sweep_of
from controller.config import SiteConfig
from controller.planning import ReachCheck, Viewpoint
from perception.calibration.errors import CalibrationError
from perception.calibration.foresight import Expected, Foreseen, Sweep, best_next, foreseen
from perception.calibration.hand_eye import Asked
from perception.calibration.sightings import Mounting
from perception.calibration.skins import Skin
from perception.geometry import Pose
from perception.scan import Scan

CANDIDATES = 36
MIN_POINTS_FORESEEN = 200


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """What is known of scanner and target when a pose is chosen."""

    mounting: Mounting
    T_base_target: Pose
    skin: Skin


class PoseChoice:
    """The candidates that are left."""

    def __init__(self, config: SiteConfig, asked: Asked, reach: ReachCheck) -> None:
        self._config, self._asked, self._reach = config, asked, reach
        self._left = list(candidates(CANDIDATES))

    def take(self, aim: Aim, made: Sequence[Foreseen]) -> View:
        """The candidate after which the mounting is least uncertain. Raises CalibrationError if none can be reached.

        :param made: what the sweeps so far say
        """
        possible = [v for v in self._left if reachable(self.viewpoint(v, aim), aim.T_base_target, self._reach) is None]
        if not possible:
            raise CalibrationError(
                f"after {len(made)} sweeps no further pose about the target can be reached",
                remedy="Place the target nearer to the middle of the arm's reach, or free the space around it.",
            )
        told = [self.foreseen(view, aim) for view in possible]
        seeing = [k for k, one in enumerate(told) if one.points > MIN_POINTS_FORESEEN] or list(range(len(told)))
        lever_m = self._config.scan.standoff_mm / 1000.0
        view = possible[seeing[best_next(made, [told[k] for k in seeing], Expected(), lever_m)]]
        self._left.remove(view)
        return view

    def viewpoint(self, view: View, aim: Aim) -> Viewpoint:
        """The sweep of a view, with the mounting that is assumed."""
        T_scanner_tcp = aim.mounting.T_flange_scanner.inverse() @ self._config.arm.T_flange_tcp.pose
        return sweep_of(view, aim.T_base_target, self._config.scan, T_scanner_tcp)

    def foreseen(self, view: View, aim: Aim) -> Foreseen:
        """What a sweep from a view would say."""
        planned, scan = self.viewpoint(view, aim), self._config.scan
        T_tcp_flange = self._config.arm.T_flange_tcp.pose.inverse()
        ends = planned.T_base_tcp_start @ T_tcp_flange, planned.T_base_tcp_end @ T_tcp_flange
        return foreseen(Sweep(*ends, scan.length_mm / scan.speed_mm_s), aim.skin, aim.mounting, self._asked)

    def told(self, scan: Scan, aim: Aim) -> Foreseen:
        """What a sweep that was made says, by its two ends."""
        duration_s = scan.profiles[-1].time_s - scan.profiles[0].time_s
        sweep = Sweep(scan.T_base_flange[0], scan.T_base_flange[-1], duration_s)
        return foreseen(sweep, aim.skin, aim.mounting, self._asked)
