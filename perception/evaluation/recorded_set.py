"""The recordings that ship with portdock: one file a scene, and beside it what locating in it must give.

``NAME.npz`` is a recorded sweep (``recorded.py``), thinned; ``NAME.json`` says which model to locate with, the prior
(to be handed to ``portdock locate --prior``), whether the scan must be accepted, and how far off it may then be. The
sweeps are simulated: no recording of a real vehicle is among them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from perception.evaluation.recorded import read_sweep, write_sweep
from perception.evaluation.scene import Negative
from perception.evaluation.scenes import simulate_scan
from perception.evaluation.tiers import TierName
from perception.port_shape import PortShape

MAX_ERROR_MM, MAX_ERROR_DEG = 1.0, 0.5


@dataclass(frozen=True, slots=True)
class RecordedScene:
    """One shipped recording: what is in it, and what it is asked for."""

    name: str
    port: str
    """Of the vehicle."""
    model: str
    """To locate with."""
    accepted: bool
    tier: TierName = "nominal"
    negative: Negative | None = None
    integrity: float | None = 1.0
    """Share of the port's points that are left."""
    seed: int = 7
    every: int = 3
    """Each n-th point of a profile is kept."""


RECORDED_SCENES = (
    RecordedScene("ccs2-nominal", "ccs2", "ccs2", True),
    RecordedScene("type2-nominal", "type2", "type2", True, seed=11),
    RecordedScene("ccs2-hard", "ccs2", "ccs2", True, tier="hard", integrity=0.85, seed=3),
    RecordedScene("type2-hard", "type2", "type2", True, tier="hard", integrity=0.85, seed=4),
    RecordedScene("ccs2-occluded", "ccs2", "ccs2", True, integrity=0.6, seed=5),
    RecordedScene("ccs2-mostly-occluded", "ccs2", "ccs2", False, integrity=0.12, seed=6),
    RecordedScene("wrong-port", "gbt_ac", "type2", False, seed=8, every=4),
    RecordedScene("closed-cover", "ccs2", "ccs2", False, negative="closed-cover", integrity=None, seed=9, every=4),
    RecordedScene("no-port", "ccs2", "ccs2", False, negative="plain", integrity=None, seed=10, every=4),
)


def regenerate(folder: Path, shape_of: Callable[[str], PortShape], only: tuple[str, ...] = ()) -> None:
    """Write the shipped recordings anew, all or some; ``shape_of`` gives a port's shape by its name."""
    for scene in RECORDED_SCENES:
        if only and scene.name not in only:
            continue
        rng = np.random.default_rng(scene.seed)
        scan = simulate_scan(shape_of(scene.port), scene.tier, rng, negative=scene.negative, integrity=scene.integrity)
        write_sweep(folder / f"{scene.name}.npz", scan, every=scene.every)
        describe(folder, scene)


def describe(folder: Path, scene: RecordedScene) -> None:
    """Write what locating in the recording must give beside it."""
    sweep = read_sweep(folder / f"{scene.name}.npz")
    facts: dict[str, object] = {
        "port": scene.port if scene.negative is None else None,
        "model": scene.model,
        "accepted": scene.accepted,
        "prior": None if sweep.prior is None else sweep.prior.matrix.tolist(),
    }
    if scene.accepted and sweep.T_scanner_port is not None:
        facts |= {
            "T_scanner_port": sweep.T_scanner_port.matrix.tolist(),
            "max_error_mm": MAX_ERROR_MM,
            "max_error_deg": MAX_ERROR_DEG,
        }
    (folder / f"{scene.name}.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
