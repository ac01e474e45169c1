"""The open cover beside the port: the arm is told before it approaches, and plans around it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from controller.faults import FaultCode
from controller.surroundings import boxes_around
from perception.estimate import PortEstimate
from perception.geometry import Pose
from perception.scan import Cloud
from tests.unit.cover_scene import vehicle
from tests.unit.mission_rig import Rig, StandInLooking

OPEN = vehicle(120.0)
NO_COVER = OPEN[OPEN[:, 2] < 0.0225]


def estimate(pose: Pose) -> PortEstimate:
    return PortEstimate("ccs2", pose, "base", np.eye(6) * 1e-8, 1e-4, 0.9, 0.5, True, (), ())


def test_an_open_cover_is_a_box_in_the_base_frame_that_holds_it() -> None:
    T_base_port = Pose.from_rotvec([2.0, 1.0, 0.5], [0.3, -0.2, 0.7])
    (box,) = boxes_around(Cloud(T_base_port.apply(OPEN)), estimate(T_base_port))
    flap = T_base_port.apply(OPEN[OPEN[:, 2] > 0.03])
    inside = np.abs(box.T_base_box.inverse().apply(flap)) < np.asarray(box.half_size)
    assert inside.all(axis=1).mean() > 0.98
    assert "cover" in box.name and not box.tool_may_touch


def test_without_a_cover_or_a_scan_nothing_is_in_the_way() -> None:
    assert boxes_around(Cloud(NO_COVER), estimate(Pose.identity())) == ()
    assert boxes_around(None, estimate(Pose.identity())) == ()


class Sights(StandInLooking):
    """Each sweep shows the next of these vehicles, (N, 3) points in the port's frame."""

    def __init__(self, rig: Rig, vehicles: Sequence[np.ndarray], accepted: list[bool]) -> None:
        super().__init__(rig.cell, rig.config, accepted)
        self._clouds = [Cloud(rig.config.port.T_base_port.pose.apply(points)) for points in vehicles]

    def sweep(self, report: object) -> None:
        super().sweep(report)  # type: ignore[arg-type]
        self.cloud = self._clouds[min(self.scans_made, len(self._clouds)) - 1]


def test_the_reach_check_of_the_approach_knows_the_cover_and_the_next_staging_forgets_it(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.arm.stop_depth_m = 0.008  # blocked: further scans follow
    rig.looking = lambda: Sights(rig, [OPEN, NO_COVER], [True])
    known: list[tuple[str, int]] = []
    rig.watch.on_state = lambda state: known.append((state, len(rig.arm.obstacles)))
    planned: list[int] = []

    def reach(poses: Sequence[Pose]) -> str | None:
        planned.append(len(rig.arm.obstacles))
        return None

    rig.cell.reach = reach
    rig.run()
    assert planned[:2] == [1, 0]
    assert [count for state, count in known if state == "INSERTING"][:2] == [1, 0]
    assert [count for state, count in known if state == "SCANNING"][:2] == [0, 0]


def test_a_cover_in_the_way_of_the_approach_refuses_the_plan_and_is_named(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.looking = lambda: Sights(rig, [OPEN], [True])
    rig.cell.reach = lambda poses: f"{rig.arm.obstacles[0].name} would come within 3 mm" if rig.arm.obstacles else None
    outcome = rig.run()
    assert outcome.fault is not None and outcome.fault.code is FaultCode.PLAN_REFUSED
    assert "open cover" in outcome.fault.detail
    assert "move_linear" not in rig.arm.moves
