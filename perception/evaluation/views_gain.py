"""What a second viewpoint gains: pairs of sweeps with parts of the port hidden, located alone and put together.

The same pairs are located in each sweep alone, in both laid together where the arm says that they were taken, and in
both registered to each other and to the model, with the arm's poses and without.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass

import numpy as np

from perception.estimate import PortEstimate
from perception.evaluation.locate_statistics import quantile, share
from perception.evaluation.locate_views import CALIBRATED, UNCALIBRATED, TwoViews, two_views
from perception.evaluation.processes import workers
from perception.locate import locate
from perception.port_model import PortModel
from perception.port_shape import PortShape
from perception.port_solid import build_mesh
from perception.scan import merge
from perception.views_locate import locate_views

INTEGRITIES = (0.65, 0.50)
ARMS = {"calibrated": CALIBRATED, "uncalibrated": UNCALIBRATED}
WAYS = ("first alone", "second alone", "laid together by the arm", "registration", "with the arm's poses")
_SUCCESS_M, _SUCCESS_RAD = 0.001, float(np.deg2rad(0.5))


@dataclass(frozen=True, slots=True)
class ViewsTrial:
    """One pair of sweeps, located in one way."""

    arm: str
    integrity: float
    port: str
    way: str
    error_m: float
    error_rad: float
    accepted: bool

    @property
    def success(self) -> bool:
        """Within 1 mm and 0.5 deg, accepted or not."""
        return self.error_m < _SUCCESS_M and self.error_rad < _SUCCESS_RAD


@dataclass(frozen=True, slots=True)
class _Task:
    arm: str
    integrity: float
    number: int
    seed: int
    port: str
    shape: PortShape


def run_pairs(
    pairs: int, seed: int, shapes: dict[str, PortShape], jobs: int, report: Callable[[int, int], None]
) -> list[ViewsTrial]:
    """``pairs`` pairs for each arm and integrity, the ports in turn; the same scenes for every arm."""
    names = list(shapes)
    tasks = [
        _Task(arm, integrity, n, seed, names[n % len(names)], shapes[names[n % len(names)]])
        for arm in ARMS
        for integrity in INTEGRITIES
        for n in range(pairs)
    ]
    with workers(jobs) as pool:
        futures = [pool.submit(_trials, task) for task in tasks]
        for done, _ in enumerate(as_completed(futures), 1):
            report(done, len(futures))
    return [trial for future in futures for trial in future.result()]


_models: dict[str, PortModel] = {}


def _trials(task: _Task) -> list[ViewsTrial]:
    if task.port not in _models:
        _models[task.port] = PortModel.from_mesh(task.port, *build_mesh(task.shape))
    rng = np.random.default_rng([task.seed, task.number, round(100 * task.integrity)])
    views = two_views(task.shape, task.integrity, rng, ARMS[task.arm])
    found = _each_way(views, _models[task.port])
    truth = {way: views.T_view_port[int(way == "second alone")] for way in WAYS}
    return [
        ViewsTrial(
            task.arm,
            task.integrity,
            task.port,
            way,
            one.T_ref_port.distance_to(truth[way]),
            one.T_ref_port.angle_to(truth[way]),
            one.accepted,
        )
        for way, one in found.items()
    ]


def _each_way(views: TwoViews, model: PortModel) -> dict[str, PortEstimate]:
    with_arm = locate_views(views.clouds, model, views.prior, views.T_first_view)
    first, second = views.clouds
    laid = merge([first, second.transformed(views.T_first_view[1], first.frame)])
    return {
        "first alone": with_arm.alone[0],
        "second alone": with_arm.alone[1],
        "laid together by the arm": locate(laid, model, views.prior),
        "registration": locate_views(views.clouds, model, views.prior).estimate,
        "with the arm's poses": with_arm.estimate,
    }


def table(trials: Sequence[ViewsTrial]) -> str:
    """Markdown: for each arm and integrity, what each way came to."""
    heads = ("arm", "integrity", "way", "success", "accepted", "median mm", "p90 mm", "median deg", "p90 deg")
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for arm in ARMS:
        for integrity in INTEGRITIES:
            for way in WAYS:
                some = [t for t in trials if (t.arm, t.integrity, t.way) == (arm, integrity, way)]
                errors_mm, errors_deg = [1e3 * t.error_m for t in some], [float(np.rad2deg(t.error_rad)) for t in some]
                figures = [f"{quantile(values, q):.3f}" for values in (errors_mm, errors_deg) for q in (0.5, 0.9)]
                success, accepted = share(sum(t.success for t in some), len(some)), sum(t.accepted for t in some)
                lines.append(f"| {arm} | {integrity:.0%} | {way} | {success} | {accepted} | {' | '.join(figures)} |")
    return "\n".join(lines) + "\n"
