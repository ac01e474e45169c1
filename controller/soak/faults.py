"""What a soak does to its missions, and which outcomes that explains: written down before anything runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from controller.faults import FaultCode, Outcome
from controller.mock_cell import MockCell
from controller.supervisor import Supervisor

_F = FaultCode
BEFORE_CONTACT = ("STAGING", "SCANNING", "LOCATING", "APPROACHING")
CONTACT = ("INSERTING", "VERIFYING", "CHARGING", "RELEASING", "RETREATING")
ANY = BEFORE_CONTACT + CONTACT


@dataclass(frozen=True, slots=True)
class Trouble:
    """One kind of trouble."""

    name: str
    states: tuple[str, ...]
    """It is made on entry to one of these."""
    codes: frozenset[FaultCode]
    """The faults that it explains."""
    kinds: frozenset[str]
    """The outcomes without a fault that it explains: it may come too late to matter."""
    make: Callable[[MockCell, Supervisor], None]

    def explains(self, outcome: Outcome) -> bool:
        """Whether a mission may end so."""
        if outcome.fault is None:
            return outcome.kind in self.kinds
        return outcome.fault.code in self.codes


def _frozen(name: str) -> Callable[[MockCell, Supervisor], None]:
    return lambda cell, supervisor: cell.freeze(name)


NOTHING = Trouble("none", ANY, frozenset(), frozenset({"charged"}), lambda cell, supervisor: None)

TROUBLES: tuple[Trouble, ...] = (
    Trouble(
        "stop", ANY, frozenset(), frozenset({"stopped", "charged"}), lambda cell, supervisor: supervisor.request_stop()
    ),
    Trouble("abort", ANY, frozenset({_F.ABORTED}), frozenset(), lambda cell, supervisor: supervisor.request_abort()),
    Trouble(
        "emergency stop",
        ANY,
        frozenset({_F.EMERGENCY_STOP}),
        frozenset(),
        lambda cell, supervisor: cell.press_estop(True),
    ),
    Trouble("arm frozen", ANY, frozenset({_F.ARM_LINK_LOST}), frozenset({"charged"}), _frozen("ur")),
    Trouble("charger frozen", ANY, frozenset({_F.CHARGER_LINK_LOST}), frozenset({"charged"}), _frozen("charger")),
    Trouble(
        "scanner frozen",
        ("STAGING", "SCANNING"),
        frozenset({_F.SCANNER_LINK_LOST, _F.SCAN_FAILED}),
        frozenset(),
        _frozen("scanner"),
    ),
)


def draw(rng: np.random.Generator, share: float) -> tuple[Trouble, str]:
    """A trouble and the state on whose entry it is made; nothing in all but ``share`` of the missions."""
    if rng.random() >= share:
        return NOTHING, ""
    trouble = TROUBLES[int(rng.integers(len(TROUBLES)))]
    return trouble, trouble.states[int(rng.integers(len(trouble.states)))]
