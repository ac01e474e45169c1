"""What the drift chart proposes: the calibration that would have foretold where docks end now. An operator accepts it.

Docks do not tell a scanner that was knocked from a plug that was bent: where all ports are off alike, or only one port
was docked at, there is more than one proposal, and one of them is to be accepted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from controller.calibrations.budget import TOOL_MM, TURN_DEG, assumed_hand_eye_covariance
from controller.calibrations.record import Calibration, DeviceNames, Kind, basis, checksum_of
from controller.config import SiteConfig
from controller.planning import FACING
from controller.port_files import load_port
from perception.calibration.correction import corrected_hand_eye, corrected_teaching, corrected_tool
from perception.calibration.drift import AXES, Drift
from perception.calibration.teaching import mean_pose
from perception.geometry import Array, Pose


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """A proposal."""

    old: Calibration
    """What it corrects."""
    stored: bool
    """``old`` is in force as a file; else it is what the site file or the port's description says."""
    new: Calibration

    @property
    def change(self) -> Array:
        """(6,) metres in the outer frame, radians in the inner one."""
        return self.old.pose.change_to(self.new.pose)


def corrections(
    site: SiteConfig,
    drifts: Sequence[Drift],
    in_force: Mapping[str, Calibration],
    devices: DeviceNames,
    now: datetime,
) -> Iterator[Correction]:
    """The proposals for what the chart warns of.

    :param site: with its calibrations
    :param in_force: those that are used, by slot
    """
    if not drifts:
        return
    if drifts[0].cause == "hand-eye or tool":
        for kind in ("hand-eye", "tool"):
            yield _common(kind, site, drifts, in_force, devices, now)
    if drifts[0].cause == "teaching of this port" or len(drifts) == 1:
        for drift in drifts:
            old = in_force.get(f"port-{drift.port}")
            before = old or replace(_unmeasured("port", _plug(site, drift.port, in_force), site, devices, now),
                                    port=drift.port, made_with=_basis(in_force))  # fmt: skip
            new = _corrected(before, corrected_teaching(before.pose, drift.shift), [drift])
            yield Correction(before, old is not None, replace(new, made_with=_basis(in_force)))


def _common(
    kind: Kind,
    site: SiteConfig,
    drifts: Sequence[Drift],
    in_force: Mapping[str, Calibration],
    devices: DeviceNames,
    now: datetime,
) -> Correction:
    """What all ports share, off by the mean of what the ports say."""
    scanner, tool = site.scanner.T_flange_scanner.pose, site.arm.T_flange_tcp.pose
    T_scanner_port = Pose(FACING, np.array([0.0, 0.0, site.scan.standoff_mm / 1e3])).inverse()
    plugs = [(_plug(site, drift.port, in_force), drift.shift) for drift in drifts]
    if kind == "hand-eye":
        pose = mean_pose([corrected_hand_eye(scanner, T_scanner_port, plug, shift) for plug, shift in plugs])
    else:
        pose = mean_pose([corrected_tool(tool, plug, shift) for plug, shift in plugs])
    old = in_force.get(kind)
    before = old or _unmeasured(kind, scanner if kind == "hand-eye" else tool, site, devices, now)
    if old is None and kind == "hand-eye":
        before = replace(before, latency_ms=site.scanner.latency_ms)
    return Correction(before, old is not None, _corrected(before, pose, drifts))


def _plug(site: SiteConfig, port: str, in_force: Mapping[str, Calibration]) -> Pose:
    """Where the plug was expected in a port."""
    taught = in_force.get(f"port-{port}")
    return load_port(port).T_port_tcp if taught is None else taught.pose


def _unmeasured(kind: Kind, pose: Pose, site: SiteConfig, devices: DeviceNames, now: datetime) -> Calibration:
    """What was used without having been calibrated, as a calibration that it can be gone back to."""
    if kind == "hand-eye":
        covariance = assumed_hand_eye_covariance(site.scan.standoff_mm)
    else:
        covariance = np.diag([TOOL_MM / 1e3 / np.sqrt(3.0)] * 3 + [np.deg2rad(TURN_DEG)] * 3) ** 2
    return Calibration(kind, pose, covariance, devices, now, (("never_measured", 1.0),),
                       corrects=("none",))  # fmt: skip


def _corrected(old: Calibration, pose: Pose, drifts: Sequence[Drift]) -> Calibration:
    """Age counts on from the day of the measurement: a correction is none."""
    sigma = np.max([drift.sigma for drift in drifts], axis=0)
    spread = np.diag([sigma[:3].max()] * 3 + [sigma[3:].max()] * 3) ** 2
    shift = np.mean([drift.shift for drift in drifts], axis=0)
    values = [*(1e3 * shift[:3]), *np.rad2deg(shift[3:])]
    names = [f"drift {axis} ({unit})" for axis, unit in zip(AXES, ["mm"] * 3 + ["deg"] * 3, strict=True)]
    residuals = tuple(one for one in old.residuals if not one[0].startswith("drift "))
    return replace(
        old,
        pose=pose,
        covariance=old.covariance + spread,
        residuals=(*residuals, *zip(names, map(float, values), strict=True)),
        corrects=(checksum_of(old), *old.corrects),
    )


def _basis(in_force: Mapping[str, Calibration]) -> str:
    return basis(in_force.get("hand-eye"), in_force.get("tool"))
