"""What the locator is evaluated on: positive scans, and scans of which none may be accepted. Made from a seed, or read.

A case is a line in a plan; ``make_scan`` turns it into a scan with its truth. Everything follows from the plan's seed
and the case's number, so a case can be made again by itself. Seeds that were used to choose constants are kept apart
from those that judge the result: see ``seed_set``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from perception.estimate import Prior
from perception.evaluation.built import TYPICAL, BuiltTolerance
from perception.evaluation.scene import is_mirror_symmetric
from perception.evaluation.scenes import SimulatedScan, TierName, cramer_rao, simulate_scan
from perception.evaluation.vehicle import Rng
from perception.geometry import Pose
from perception.port_shape import PortShape
from perception.scan import Cloud

FIRST_ACCEPTANCE_SEED = 1000

NegativeKind = Literal[
    "plain",
    "empty-pocket",
    "other-recess",
    "closed-cover",
    "dust-cap",
    "plug-inserted",
    "other-type",
    "mirrored",
    "no-contacts",
    "rolled",
    "hardly-visible",
]
PositiveKind = Literal["port", "loose-part"]
Kind = PositiveKind | NegativeKind
NEGATIVE_KINDS: tuple[NegativeKind, ...] = get_args(NegativeKind)
POSE_DECIDES: tuple[Kind, ...] = ("port", "loose-part", "hardly-visible")
"""Kinds that show the port asked for where it may be: accepting its true pose is no false accept."""
MATING: tuple[tuple[str, str], ...] = (("type2", "ccs2"), ("j1772", "ccs1"))
"""(asked for, there): the plug mates, so the scan is no negative."""

LOOSE_PART = replace(TYPICAL, shrink=0.001, pin_lateral_m=0.00015, pin_axial_m=0.0004)
"""A part that is not quite its CAD."""
_TIERS: tuple[TierName, ...] = ("easy", "nominal", "hard", "extreme")
_QUARTER_TURNS = (90.0, 180.0, -90.0)


@dataclass(frozen=True, slots=True)
class Case:
    """One scan to be made and what is asked of it."""

    kind: Kind
    number: int
    tier: TierName
    port: str
    """What is scanned (or would be, where the kind shows none)."""
    asked: str
    """Name of the model that is searched for."""

    @property
    def name(self) -> str:
        """Unique within a plan."""
        return f"{self.kind}-{self.tier}-{self.port}-{self.number:05d}"

    @property
    def positive(self) -> bool:
        """Whether the port asked for is there to be found."""
        return self.kind in ("port", "loose-part")


@dataclass(frozen=True, slots=True, eq=False)
class CaseScan:
    """A scan and what is true of it."""

    cloud: Cloud
    prior: Prior
    T_scanner_port: Pose | None
    """None where the port asked for is not there."""
    bound_m: float
    """Cramer-Rao bound (1 sigma, root sum of squares of the axes); NaN where unknown."""
    bound_rad: float
    integrity: float


def seed_set(seed: int) -> Literal["tuning", "acceptance"]:
    """Which set a seed belongs to. No constant of the locator may be chosen on an acceptance seed."""
    return "acceptance" if seed >= FIRST_ACCEPTANCE_SEED else "tuning"


def positive_cases(count: int, ports: Sequence[str], tiers: Sequence[TierName] = _TIERS) -> list[Case]:
    """Ports and tiers in turn; a start of the list has about as many of each."""
    return [_positive("port", n, ports, tiers) for n in range(count)]


def loose_cases(count: int, ports: Sequence[str]) -> list[Case]:
    """Nominal scans of parts that differ from their CAD by more than parts usually do."""
    return [_positive("loose-part", n, ports, ("nominal",)) for n in range(count)]


def _positive(kind: PositiveKind, n: int, ports: Sequence[str], tiers: Sequence[TierName]) -> Case:
    port = ports[n // len(tiers) % len(ports)]
    return Case(kind, n, tiers[n % len(tiers)], port, port)


def negative_cases(count: int, shapes: Mapping[str, PortShape], tiers: Sequence[TierName] = _TIERS) -> list[Case]:
    """Every kind with every port and tier in turn."""
    return [_negative(n, shapes, tiers) for n in range(count)]


def _negative(n: int, shapes: Mapping[str, PortShape], tiers: Sequence[TierName]) -> Case:
    ports = list(shapes)
    kind = NEGATIVE_KINDS[n % len(NEGATIVE_KINDS)]
    port, tier = ports[n % len(ports)], tiers[n // len(ports) % len(tiers)]
    if kind == "mirrored" and is_mirror_symmetric(shapes[port]):
        kind = "other-type"
    if kind != "other-type":
        return Case(kind, n, tier, port, port)
    others = [one for one in ports if one != port and (one, port) not in MATING]
    if not others:
        return Case("no-contacts", n, tier, port, port)
    return Case(kind, n, tier, port, others[n // len(NEGATIVE_KINDS) % len(others)])


def make_scan(case: Case, seed: int, shapes: Mapping[str, PortShape]) -> CaseScan:
    """The scan of a case; the same for the same seed."""
    rng = np.random.default_rng([seed, int(case.positive), case.number, case.kind == "loose-part"])
    scan = _simulated(case, shapes[case.port], rng)
    there = case.positive or case.kind in ("hardly-visible", "rolled")
    bound = cramer_rao(scan) if case.positive else None
    return CaseScan(
        Cloud(scan.cloud.points, scan.cloud.frame, scan.cloud.origins),
        scan.prior,
        scan.T_scanner_port if there else None,
        bound.translation_m if bound else float("nan"),
        bound.rotation_rad if bound else float("nan"),
        scan.integrity,
    )


def _simulated(case: Case, shape: PortShape, rng: Rng) -> SimulatedScan:
    match case.kind:
        case "port" | "other-type":
            return simulate_scan(shape, case.tier, rng)
        case "loose-part":
            return simulate_scan(shape, case.tier, rng, tolerance=LOOSE_PART)
        case "hardly-visible":
            return simulate_scan(shape, case.tier, rng, integrity=float(rng.uniform(0.05, 0.28)))
        case "rolled":
            return simulate_scan(shape, case.tier, rng, extra_roll_rad=_roll_beyond(rng))
        case negative:
            return simulate_scan(shape, case.tier, rng, negative=negative)


def _roll_beyond(rng: Rng) -> float:
    """More than any prior allows: half of them by quarter turns, which round ports nearly bear."""
    if rng.random() < 0.5:
        return float(np.deg2rad(rng.choice(_QUARTER_TURNS)))
    return float(np.deg2rad(rng.uniform(36.0, 180.0) * rng.choice([-1.0, 1.0])))


def each_tier(tiers: Sequence[str]) -> Iterator[TierName]:
    """Names of tiers, checked. Raises ValueError for another."""
    for name in tiers:
        if name not in _TIERS:
            raise ValueError(f"no tier is called {name!r}; there are {', '.join(_TIERS)}")
        yield name


__all__ = ["BuiltTolerance", "Case", "CaseScan", "Kind", "make_scan", "negative_cases", "positive_cases", "seed_set"]
