"""What one solver answered on one scan, as a line of a JSON file, so that a run can be stopped and taken up again."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from perception.errors import InputError
from perception.evaluation.locate_cases import MATING, POSE_DECIDES, Kind
from perception.evaluation.tiers import TierName
from perception.geometry import Array, Pose

SUCCESS_M, SUCCESS_RAD = 0.001, float(np.deg2rad(0.5))
FALSE_M, FALSE_RAD = 0.002, float(np.deg2rad(1.0))
"""An accepted pose that is farther off is a confident wrong answer."""


@dataclass(frozen=True, slots=True)
class CaseRecord:
    """One answer."""

    case: str
    kind: Kind
    tier: TierName
    port: str
    asked: str
    solver: str
    points: int
    integrity: float
    accepted: bool
    verdict: str
    named: str
    """The port that the answer names."""
    reasons: tuple[str, ...]
    error: tuple[float, ...]
    """Translation (m) then rotation vector (rad) from the estimate to the truth, port frame; empty without truth."""
    covariance: tuple[float, ...]
    """36 entries, row by row; empty where the solver predicts none."""
    bound_m: float
    bound_rad: float
    wall_s: float
    cpu_s: float
    unit_wall_s: float
    """Crop, voxel grid, outlier removal and normals of the same scan in Open3D, in the same process."""
    unit_cpu_s: float

    @property
    def shift_m(self) -> float:
        """Translation error; infinite without an answer to compare."""
        return float(np.linalg.norm(self.error[:3])) if self.error else float("inf")

    @property
    def turn_rad(self) -> float:
        """Rotation error."""
        return float(np.linalg.norm(self.error[3:])) if self.error else float("inf")

    @property
    def success(self) -> bool:
        """Whether the pose is right, accepted or not."""
        return self.shift_m <= SUCCESS_M and self.turn_rad <= SUCCESS_RAD

    @property
    def positive(self) -> bool:
        """Whether the port asked for was there to be found."""
        return self.kind in ("port", "loose-part")

    @property
    def false_accept(self) -> bool:
        """Accepted, and not where the port asked for is."""
        if not self.accepted or (self.asked, self.port) in MATING:
            return False
        if self.kind in POSE_DECIDES:
            return not (self.shift_m <= FALSE_M and self.turn_rad <= FALSE_RAD)
        return True

    @property
    def false_refusal(self) -> bool:
        """A right pose that was refused."""
        return self.positive and self.success and not self.accepted

    @property
    def right_name(self) -> bool:
        """Whether the answer names the port that is there, or one whose plug mates with it."""
        return self.named == self.port or (self.named, self.port) in MATING

    @property
    def covariance_matrix(self) -> Array | None:
        """(6, 6), or None."""
        matrix = np.asarray(self.covariance, dtype=np.float64)
        return matrix.reshape(6, 6) if len(matrix) == 36 and np.isfinite(matrix).all() else None


def read(path: Path) -> list[CaseRecord]:
    """All records of a file; a last line that was not finished is left out. Raises InputError for another file."""
    if not path.exists():
        return []
    found = []
    lines = path.read_text("utf-8").splitlines()
    for number, line in enumerate(lines):
        try:
            found.append(_record(json.loads(line)))
        except (ValueError, TypeError, KeyError) as error:
            if number < len(lines) - 1:
                raise InputError(f"{path} is no file of results: line {number + 1}: {error}") from error
    return found


def _record(values: dict[str, object]) -> CaseRecord:
    listed = {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
    return CaseRecord(**listed)  # type: ignore[arg-type]


def append(path: Path, records: Iterable[CaseRecord]) -> None:
    """Adds records in one write; an unfinished last line of an interrupted run is ended first."""
    text = "".join(json.dumps(asdict(record)) + "\n" for record in records)
    unfinished = path.exists() and not path.read_bytes().endswith(b"\n") and path.stat().st_size > 0
    if unfinished:
        kept = path.read_bytes()
        path.write_bytes(kept[: kept.rfind(b"\n") + 1])
    with path.open("a", encoding="utf-8") as file:
        file.write(text)


def error_of(estimated: Pose, true: Pose) -> tuple[float, ...]:
    """(6,) translation (m) and rotation vector (rad) from the estimate to the truth, in the estimate's frame."""
    return tuple(float(v) for v in (estimated.inverse() @ true).vector)
