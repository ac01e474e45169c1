"""Hand-eye calibration on the live cell: find the target, sweep it from poses that say most, solve, check.

The gate, the tick and the charger's proximity guard every motion as in a mission (``scan_session``).
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field

import numpy as np

from controller.arm_config import ArmErrorsConfig
from controller.assembly import assemble
from controller.calibrations.port_sweeps import expected_skin, placed, solved
from controller.calibrations.pose_choice import Aim, PoseChoice
from controller.calibrations.thinker import Thinker
from controller.calibrations.timed_sweep import timed_sweep
from controller.calibrations.views import View
from controller.cell import Cell
from controller.config import SiteConfig
from controller.sweep import SweepError
from controller.sweeping import ProgressReport
from controller.unrecorded import Unrecorded
from controller.wiring import arm_error_jacobians
from perception.calibration.arm_fit import ArmFit, fit_arm
from perception.calibration.errors import CalibrationError
from perception.calibration.foresight import Expected, Foreseen, covariance_after, spread
from perception.calibration.from_sweeps import Solved, TargetKind, checked, sphere_place
from perception.calibration.hand_eye import Asked, HandEye
from perception.calibration.sightings import Mounting
from perception.calibration.targets import PortTarget
from perception.geometry import Array, Pose
from perception.scan import Scan

log = logging.getLogger(__name__)

MIN_SWEEPS = 8
SEARCH_ASIDE_MM = (0.0, 60.0, -60.0)
"""Where the first sweep looks for the target: a guess that is 10 deg off misses it by 50 mm."""
SPOILED = 3
STATUS_S = 5.0

Note = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a calibration is to reach, and with how many sweeps at most."""

    kind: TargetKind
    asked: Asked = field(default_factory=Asked)
    sigma_m: float = 0.0002
    sigma_rad: float = float(np.deg2rad(0.06))
    max_sweeps: int = 14
    ideal_arm: bool = False
    """Take the arm at its word: its own errors are not estimated."""

    @property
    def estimates_arm(self) -> bool:
        """Not from a port: what it is built otherwise than drawn would be taken for the arm's errors."""
        return not self.ideal_arm and self.kind.name != "port"


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A solved and checked calibration."""

    solved: Solved
    """With the arm taken at its word."""
    arm: ArmFit | None
    """The same and the arm's own errors, if these were asked for."""
    located_sigma_m: float | None
    """What that leaves uncertain of the place of a port that is seen square on where the target is."""
    left_out_m: Array
    """(S,) how far each sweep shows the target from where all others foretell it."""
    sweeps: int
    time_scale: float
    """Device seconds per second of the solution's time offset."""

    @property
    def hand_eye(self) -> HandEye:
        """The mounting that counts."""
        return self.solved.hand_eye if self.arm is None else self.arm.hand_eye


def calibrate_hand_eye(
    config: SiteConfig,
    wanted: Wanted,
    report: ProgressReport,
    note: Note,
    *,
    pace: float = 1.0,
    heartbeat_mode: int = 3,
) -> Calibrated:
    """Sweep, solve, check. Raises CalibrationError, MissionFault, SweepError, LinkOpenError; nothing is stored."""
    if wanted.estimates_arm:  # what is estimated is not corrected for
        config = config.model_copy(update={"arm": config.arm.model_copy(update={"errors": ArmErrorsConfig()})})
    with ExitStack() as closing:
        cell = assemble(config, Unrecorded(), closing, pace=pace, heartbeat_mode=heartbeat_mode).cell
        thinker = Thinker()
        closing.callback(thinker.close)
        return _Calibrating(cell, config, wanted, report, note, thinker).run()


@dataclass(frozen=True, slots=True)
class Planned:
    """A pose of a plan, and how certain the mounting is foretold to be after it."""

    view: View
    sigma_m: float
    sigma_rad: float


def plan_hand_eye(config: SiteConfig, wanted: Wanted, *, pace: float = 1.0, heartbeat_mode: int = 3) -> list[Planned]:
    """The poses that a calibration would sweep from, were target and guess where they are expected. Nothing moves.

    :raises CalibrationError: too few poses can be reached; and as ``calibrate_hand_eye``
    """
    with ExitStack() as closing:
        cell = assemble(config, Unrecorded(), closing, pace=pace, heartbeat_mode=heartbeat_mode).cell
        thinker = Thinker()
        closing.callback(thinker.close)
        cell.supervisor.wait(lambda: cell.arm_state() is not None, STATUS_S)
        return _Calibrating(cell, config, wanted, lambda *_: None, lambda _: None, thinker).plan()


class _Calibrating:
    """One calibration under way."""

    def __init__(
        self, cell: Cell, config: SiteConfig, wanted: Wanted, report: ProgressReport, note: Note, thinker: Thinker
    ) -> None:
        self._cell, self._config, self._wanted, self._thinker = cell, config, wanted, thinker
        self._report, self._note = report, note
        self._mounting = Mounting(config.scanner.T_flange_scanner.pose)
        self._T_base_target = config.port.T_base_port.pose
        self._scans: list[Scan] = []
        self._by_arm: list[Array] = []
        """For each sweep (2, 6, 19): how errors of the arm move its ends."""
        self._choice = PoseChoice(config, wanted.asked, cell.reach)
        self._solved: Solved | None = None
        self._aim = self._aimed()

    def run(self) -> Calibrated:
        self._find_target()
        while not self._enough():
            self._sweep(self._choice.take(self._aim, self._made))
            self._solve()
        found = self._solved
        assert found is not None, "it is enough only with a solution"
        left_out_m = self._thinker.ask(self._cell, checked, found, self._wanted.asked)
        shared = self._config.scanner.sync in ("shared_clock", "trigger")
        arm, located_m = self._arm(found) if self._wanted.estimates_arm else (None, None)
        scale = 1.0 if shared else self._cell.time_scale
        return Calibrated(found, arm, located_m, left_out_m, len(self._scans), scale)

    def _arm(self, found: Solved) -> tuple[ArmFit, float]:
        """The arm's own errors, and what the first sweep's pose would leave uncertain of a port."""
        fit = self._thinker.ask(self._cell, fit_arm, found.seen, found.hand_eye, self._by_arm, self._wanted.asked)
        T_base_flange = self._scans[0].T_base_flange[len(self._scans[0].T_base_flange) // 2]
        place = T_base_flange.inverse().apply(self._T_base_target.translation[None])[0]
        return fit, fit.located_sigma_m(self._by_arm[0].mean(axis=0), place)

    def plan(self) -> list[Planned]:
        """Poses one by one until the prediction is good enough, or no more may be added."""
        made, planned = [self._choice.foreseen(View(), self._aim)], [Planned(View(), np.inf, np.inf)]
        while len(planned) < self._wanted.max_sweeps:
            view = self._choice.take(self._aim, made)
            made.append(self._choice.foreseen(view, self._aim))
            sigma_m, sigma_rad = spread(covariance_after(made, Expected()))
            planned.append(Planned(view, sigma_m, sigma_rad))
            if len(planned) >= MIN_SWEEPS and sigma_m < self._wanted.sigma_m and sigma_rad < self._wanted.sigma_rad:
                break
        return planned

    # --- sweeps

    def _find_target(self) -> None:
        """A first sweep, square on; of a sphere or a port it tells where to look from then on."""
        if self._wanted.kind.name == "planes":
            self._sweep(View())
            return
        problem: CalibrationError | None = None
        for aside_mm in SEARCH_ASIDE_MM:
            self._sweep(View(aside_mm=aside_mm))
            try:
                self._look_at(self._place())
            except CalibrationError as error:
                self._scans.pop()
                self._by_arm.pop()
                problem = problem or error
                continue
            return
        assert problem is not None
        raise problem

    def _place(self) -> Array:
        """(3,) where the last sweep shows the target whole. Raises CalibrationError."""
        kind, scan = self._wanted.kind, self._scans[-1]
        if kind.name == "port":
            expected = self._T_base_target
            return self._thinker.ask(self._cell, placed, scan, kind.port, expected, self._mounting).translation
        return self._thinker.ask(self._cell, sphere_place, scan, kind.radius_m, self._mounting)

    def _sweep(self, view: View) -> None:
        for _ in range(SPOILED):
            try:
                viewpoint = self._choice.viewpoint(view, self._aim)
                scan = timed_sweep(self._cell, self._config, viewpoint, self._report)
                break
            except SweepError as error:
                log.warning("this sweep cannot be used, it is made again: %s", error.cause)
        else:
            raise SweepError(f"{SPOILED} sweeps from one pose could not be used")
        self._scans.append(scan)
        ends = scan.T_base_flange[0], scan.T_base_flange[-1]
        self._by_arm.append(arm_error_jacobians(self._config, ends, self._cell.arm.state().joints))
        self._note(
            f"sweep {len(self._scans)}: pitch {view.pitch_deg:+.0f} yaw {view.yaw_deg:+.0f} roll {view.roll_deg:+.0f}"
            f" deg, {self._config.scan.standoff_mm - view.nearer_mm:.0f} mm off"
        )

    def _look_at(self, place: Array) -> None:
        self._T_base_target = Pose(self._T_base_target.rotation, place)
        self._aim = self._aimed()

    def _aimed(self) -> Aim:
        found = None if self._solved is None else self._solved.hand_eye.target
        skin = self._thinker.ask(self._cell, expected_skin, self._wanted.kind, self._port, found)
        return Aim(self._mounting, self._T_base_target, skin)

    @property
    def _made(self) -> list[Foreseen]:
        """What the sweeps so far say; a sweep that missed the target says nothing."""
        told = [self._choice.told(scan, self._aim) for scan in self._scans]
        return [one for one in told if one.points] or told

    # --- solution

    def _solve(self) -> None:
        """What the sweeps say so far; few sweeps may not say it yet."""
        if len(self._scans) < 4:
            return
        w = self._wanted
        try:
            at = self._port
            found = self._thinker.ask(self._cell, solved, self._scans, w.kind, at, self._mounting, w.asked)
        except CalibrationError as error:
            if len(self._scans) >= w.max_sweeps:
                raise
            log.info("not yet: %s", error.cause)
            return
        self._solved, self._mounting = found, found.hand_eye.mounting
        self._look_at(self._T_base_target.translation if found.place is None else found.place)
        sigma_m, sigma_rad = spread(found.hand_eye.covariance[:6, :6])
        foretold_m, foretold_rad = spread(covariance_after(self._made, Expected()))
        self._note(
            f"  1 sigma {1e3 * sigma_m:.3f} mm, {np.rad2deg(sigma_rad):.4f} deg;"
            f" predicted {1e3 * foretold_m:.3f} mm, {np.rad2deg(foretold_rad):.4f} deg"
        )

    @property
    def _port(self) -> Pose:
        """Where a port is expected: by the last solution; before one, where the target is, turned as the site says."""
        target = None if self._solved is None else self._solved.hand_eye.target
        return target.T_base_port if isinstance(target, PortTarget) else self._T_base_target

    def _enough(self) -> bool:
        """Enough sweeps, and certain enough; or all that were allowed."""
        count, w = len(self._scans), self._wanted
        if count >= w.max_sweeps and self._solved is not None:
            return True
        if count < MIN_SWEEPS or self._solved is None:
            return False
        found = [self._solved.hand_eye.covariance[:6, :6]]
        if w.kind.name != "port":  # errors of the arm may happen to agree in few sweeps; a built port's never do
            found.append(covariance_after(self._made, Expected()))
        return all(sigma_m < w.sigma_m and sigma_rad < w.sigma_rad for sigma_m, sigma_rad in map(spread, found))
