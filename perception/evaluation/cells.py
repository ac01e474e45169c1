"""The results by condition and method: the cells that figures and tables show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from perception.evaluation import statistics
from perception.evaluation.metrics import recognised
from perception.evaluation.records import Record, RoundRecord, TrialRecord
from perception.evaluation.statistics import Estimate


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """All trials of one method under one condition."""

    condition: str
    method: str
    trials: tuple[TrialRecord, ...]

    def loss_median(self, after: int | None = None) -> Estimate:
        """Median common loss, mm^2, after so many registrations (None: the method's answer)."""
        return statistics.median([r.loss_mm2 for r in self._rounds(after)])

    def loss_mean(self, after: int | None = None) -> Estimate:
        """Mean common loss, mm^2."""
        return statistics.mean([r.loss_mm2 for r in self._rounds(after)])

    def success(self, after: int | None = None, within: float = 2.0) -> Estimate:
        """Share of trials within 2 deg and 2 mm (or another number of both)."""
        return statistics.mean([float(recognised(r.angle_deg, r.centre_mm, within)) for r in self._rounds(after)])

    def iou_raw(self, after: int | None = None) -> Estimate:
        """Median IOU of the whole scan."""
        return statistics.median([r.iou_raw for r in self._rounds(after)])

    def iou_clean(self, after: int | None = None) -> Estimate:
        """Median IOU of the cleaned scan."""
        return statistics.median([r.iou_clean for r in self._rounds(after)])

    def of_trials(self, quantity: Callable[[TrialRecord], float]) -> Estimate:
        """Median of any quantity of a trial."""
        return statistics.median([quantity(trial) for trial in self.trials])

    @property
    def ms_per_round(self) -> Estimate:
        """Median processor time of one registration."""
        return statistics.median([trial.total_ms / len(trial.rounds) for trial in self.trials])

    def entries(self) -> tuple[Estimate, ...]:
        """MSE, RMSE and MAE (19) to (21) of the rotation entries, then of the translation entries in mm."""
        return tuple(
            part
            for errors in (
                [trial.rotation_error for trial in self.trials],
                [trial.translation_error_mm for trial in self.trials],
            )
            for part in statistics.entry_errors(np.array(errors))
        )

    def _rounds(self, after: int | None) -> list[RoundRecord]:
        return [trial.last if after is None else trial.after(after) for trial in self.trials]


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """All cells of a run."""

    cells: tuple[Cell, ...]

    @staticmethod
    def of(records: Sequence[Record]) -> Cells:
        """Grouped by condition and method."""
        groups: dict[tuple[str, str], list[TrialRecord]] = {}
        for record in records:
            if isinstance(record, TrialRecord):
                groups.setdefault((record.condition, record.method), []).append(record)
        return Cells(tuple(Cell(c, m, tuple(trials)) for (c, m), trials in sorted(groups.items())))

    def get(self, condition: str, method: str) -> Cell | None:
        """One cell, None if it was not run."""
        return next((c for c in self.cells if c.condition == condition and c.method == method), None)

    def need(self, condition: str, method: str) -> Cell:
        """One cell. Raises KeyError if it was not run."""
        found = self.get(condition, method)
        if found is None:
            raise KeyError(f"{method} was not run under {condition}")
        return found
