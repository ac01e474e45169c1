"""Results on disk: one JSON line for each trial and method, so that a run can be stopped and taken up again."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from perception.errors import InputError


@dataclass(frozen=True, slots=True)
class RoundRecord:
    """One registration of one method on one scan."""

    loss_mm2: float
    """Common loss."""
    angle_deg: float
    centre_mm: float
    iou_raw: float
    """Occupancy IOU of the whole scan at 3 spacings: the pose alone."""
    iou_clean: float
    """The same of the cleaned scan: pose and denoising."""
    ms: float


@dataclass(frozen=True, slots=True)
class TrialRecord:
    """All registrations of one method on one scan."""

    condition: str
    trial: int
    method: str
    rounds: tuple[RoundRecord, ...]
    rotation_error: tuple[float, ...]
    """Nine entries of R - R_true after the last round."""
    translation_error_mm: tuple[float, ...]
    """Three entries of t - t_true."""
    ceiling_raw: float
    """IOU that the scan would have at the true pose."""
    ceiling_clean: float
    iou_fine: float
    """Raw IOU after the last round at 2 spacings, and its ceiling."""
    ceiling_fine: float
    iou_coarse: float
    """The same at 5 spacings."""
    ceiling_coarse: float

    @property
    def last(self) -> RoundRecord:
        """The method's answer."""
        return self.rounds[-1]

    def after(self, k: int) -> RoundRecord:
        """What it would answer after k registrations; a method that took fewer keeps its answer."""
        return self.rounds[min(k, len(self.rounds)) - 1]

    @property
    def total_ms(self) -> float:
        """Time of all its registrations."""
        return sum(r.ms for r in self.rounds)


@dataclass(frozen=True, slots=True)
class SplitRecord:
    """What a split rule of the tree changed on one scan."""

    trial: int
    rule: str
    depth: int
    nodes_visited: float
    """For each point, of a radius query."""
    same_neighbours: bool
    """Neighbour counts equal those of the rule std, point by point."""
    same_masks: bool
    """Kept points equal at kappa 3, 2, 1.5 and 1."""
    build_ms: float
    statistics_ms: float


@dataclass(frozen=True, slots=True)
class MergeRecord:
    """How well one view was merged with the others without a model."""

    trial: int
    view: int
    step: str
    """``sequential`` or ``joint``."""
    angle_deg: float
    centre_mm: float


Record = TrialRecord | SplitRecord | MergeRecord
_KINDS: tuple[type[Record], ...] = (TrialRecord, SplitRecord, MergeRecord)


def append(path: Path, records: Iterable[Record]) -> None:
    """Adds lines in one write, so that an interrupted run leaves at most its last line cut off."""
    text = "".join(json.dumps({"kind": type(record).__name__, **asdict(record)}) + "\n" for record in records)
    with path.open("a", encoding="utf-8") as file:
        file.write(text)


def read(path: Path) -> list[Record]:
    """All whole lines. Raises InputError for a file that is not of this kind."""
    if not path.exists():
        return []
    return list(_parsed(path))


def _parsed(path: Path) -> Iterator[Record]:
    kinds = {kind.__name__: kind for kind in _KINDS}
    for line in path.read_text("utf-8").splitlines():
        try:
            node = json.loads(line)
        except json.JSONDecodeError:
            continue  # the line that an interruption cut off: its trial runs again
        kind = kinds.get(node.pop("kind", ""))
        if kind is None:
            raise InputError(f"{path} does not hold results of the evaluation", remedy="Give another --out folder.")
        if kind is TrialRecord:
            node["rounds"] = tuple(RoundRecord(**entry) for entry in node["rounds"])
            node["rotation_error"] = tuple(node["rotation_error"])
            node["translation_error_mm"] = tuple(node["translation_error_mm"])
        yield kind(**node)
