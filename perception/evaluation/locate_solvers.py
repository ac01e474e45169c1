"""All that is compared, by name: the locator as users call it, and the peers; each gets the same prior and CAD."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from perception.estimate import PortEstimate
from perception.evaluation.locate_ablation import VARIANTS
from perception.evaluation.locate_cases import CaseScan
from perception.evaluation.locate_peers import PEERS, peer_pose
from perception.geometry import Array, Pose
from perception.locate import LocateSettings, locate
from perception.port_model import PortModel

PORTDOCK = "portdock"
NO_PRIOR = "no-prior"
AUTO = "auto"
EXTRAS = (NO_PRIOR, AUTO, *VARIANTS)
"""Without a prior; with all models to choose from; with steps of the published method."""


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a solver says about a scan."""

    T_scanner_port: Pose
    accepted: bool
    verdict: str
    named: str
    reasons: tuple[str, ...] = ()
    covariance: Array | None = None


Models = Mapping[str, PortModel]
Solver = Callable[[CaseScan, str, Models], Answer]
"""From a scan, the name of the model asked for, and all models."""


def solver(name: str, threads: int) -> Solver:
    """The solver of this name. Raises KeyError for another, PeerMissingError for a peer that is not installed."""
    settings = LocateSettings(threads=threads)
    if name == PORTDOCK:
        return lambda scan, asked, models: _answer(locate(scan.cloud, models[asked], scan.prior, settings))
    if name == NO_PRIOR:
        return lambda scan, asked, models: _answer(locate(scan.cloud, models[asked], None, settings))
    if name == AUTO:
        return lambda scan, _, models: _answer(locate(scan.cloud, list(models.values()), scan.prior, settings))
    if name in VARIANTS:
        return lambda scan, asked, models: _answer(VARIANTS[name](scan, models[asked], settings))
    find = PEERS[name].load()

    def ask(scan: CaseScan, asked: str, models: Models) -> Answer:
        return Answer(peer_pose(find, scan, models[asked]), accepted=True, verdict="port", named=asked)

    return ask


def _answer(estimate: PortEstimate) -> Answer:
    return Answer(
        estimate.T_ref_port,
        estimate.accepted,
        estimate.verdict,
        estimate.port if estimate.verdict == "port" or estimate.accepted else estimate.verdict,
        estimate.reasons,
        estimate.covariance,
    )
