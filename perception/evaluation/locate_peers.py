"""The tools that users know, through their own libraries: global registration to samples of the CAD, then fine ICP.

All get the scan as prepared in ``locate_unit`` (cropped by the prior, thinned, cleaned, normals to the sensor) and the
same samples of the CAD that the sensor can see. Those that may answer with any pose are asked up to three times, and
the best of what the prior allows is taken: that helps every one of them.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from perception.errors import InputError
from perception.evaluation.locate_cases import CaseScan
from perception.evaluation.locate_unit import prepared
from perception.geometry import Pose
from perception.port_model import PortModel

Finder = Callable[[Any, PortModel, CaseScan], Pose]
"""From the prepared scan (prior frame), the model and the case to T_prior_port."""


class PeerMissingError(InputError):
    """The library of a peer is not installed."""

    code: ClassVar[str] = "peer-missing"
    default_remedy: ClassVar[str] = "Install the optional extra: pip install 'portdock[peers]'."


@dataclass(frozen=True, slots=True)
class Peer:
    """A tool to compare with."""

    name: str
    title: str
    library: str
    """Module that must be importable."""
    build: Callable[[], Finder]

    @property
    def present(self) -> bool:
        """Whether its library is installed."""
        return importlib.util.find_spec(self.library) is not None

    def load(self) -> Finder:
        """The tool, ready. Raises PeerMissingError."""
        if not self.present:
            raise PeerMissingError(f"peer {self.name} needs the library {self.library}, which is not installed")
        return self.build()


def peer_pose(find: Finder, scan: CaseScan, model: PortModel) -> Pose:
    """T_scanner_port as a peer finds it."""
    return scan.prior.T_ref_port @ find(prepared(scan, model), model, scan)


PEERS: dict[str, Peer] = {}
