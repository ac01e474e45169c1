"""The feedback from registration to denoising, equation (18), and when its rounds stop.

As printed, kappa <- (1 - eps) kappa takes a loss in square length as a pure number: in metres kappa never moves, in
millimetres it turns negative after one round and (8) keeps nothing. The reading used: a normalised eps_n in [0, 1) and
a bounded step. Even so kappa can only fall, and the loss of two scans' keypoints has a floor that no kappa removes, so
a smallest kappa, an early stop and the choice of the best iterate (in ``pipeline``) are part of the loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from perception.errors import PortdockError

FeedbackRule = Literal["normalised", "literal_mm", "literal_m", "fixed", "jitter"]
"""(18) as read, (18) as printed in either unit, no feedback, and the control that drops random points instead."""


class FeedbackCollapsedError(PortdockError):
    """Equation (18) as printed has driven kappa to zero or below: (8) would keep no point."""

    code: ClassVar[str] = "feedback-collapsed"
    default_remedy: ClassVar[str] = "Use the profile faithful or robust: there (18) is normalised and bounded."


@dataclass(frozen=True, slots=True)
class FeedbackSettings:
    """The loop's law and its bounds."""

    rule: FeedbackRule = "normalised"
    kappa_0: float = 3.0
    kappa_min: float = 1.5
    min_factor: float = 0.85
    """kappa falls by at most this factor in one round."""
    max_rounds: int = 10
    min_kept: float = 0.5
    """Stop when fewer of the cloud's points than this share are kept."""
    min_eps: float = 0.01
    """Stop when the normalised loss is below."""
    min_gain: float = 0.01
    """Stop when the best score improved by less than this share, two rounds running."""
    stop_early: bool = True
    """False runs all rounds, for curves over rounds."""
    jitter_fraction: float = 0.03
    """Share of kept points that the rule ``jitter`` drops at random."""


def normalised_loss(loss_mm2: float, scale_mm: float) -> float:
    """eps_n = eps / (eps + c^2), in [0, 1): pure number; c is twice the target keypoints' median spacing."""
    return loss_mm2 / (loss_mm2 + scale_mm**2)


def step_factor(eps_n: float, min_factor: float) -> float:
    """The bounded factor of (18), in [min_factor, 1]."""
    return max(1.0 - eps_n, min_factor)


def literal_kappa(kappa: float, loss_mm2: float, unit: Literal["mm", "m"]) -> float:
    """Equation (18) as printed, with the loss in the square of ``unit``.

    :raises FeedbackCollapsedError: the result is not positive.
    """
    loss = loss_mm2 if unit == "mm" else loss_mm2 * 1e-6
    updated = (1.0 - loss) * kappa
    if updated <= 0:
        raise FeedbackCollapsedError(
            f"equation (18) as printed gives kappa = {updated:.3g} after a loss of {loss:.3g} {unit}^2: nothing is kept"
        )
    return updated


def next_kappa(kappa: float, loss_mm2: float, scale_mm: float, settings: FeedbackSettings) -> float:
    """kappa for the next round.

    :raises FeedbackCollapsedError: a literal rule has left the range in which (8) means anything.
    """
    if settings.rule == "literal_mm":
        return literal_kappa(kappa, loss_mm2, "mm")
    if settings.rule == "literal_m":
        return literal_kappa(kappa, loss_mm2, "m")
    if settings.rule == "normalised":
        eps_n = normalised_loss(loss_mm2, scale_mm)
        return max(settings.kappa_min, step_factor(eps_n, settings.min_factor) * kappa)
    return kappa


def stop_reason(
    kappa: float, kept: float, eps_n: float, best_scores: Sequence[float], settings: FeedbackSettings
) -> str | None:
    """Why the loop ends after this round, or None. ``best_scores`` holds the best score so far after each round."""
    if kept < settings.min_kept:
        return f"only {100 * kept:.0f} % of the points kept"
    if len(best_scores) >= settings.max_rounds:
        return "all rounds done"
    if not settings.stop_early:
        return None
    if eps_n < settings.min_eps:
        return "the loss is small"
    if settings.rule == "normalised" and kappa <= settings.kappa_min:
        return "kappa is at its minimum"
    if len(best_scores) >= 3 and best_scores[-3] - best_scores[-1] < settings.min_gain * best_scores[-3]:
        return "no gain in two rounds"
    return None
