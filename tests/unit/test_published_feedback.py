"""The feedback, equation (18), as printed and as read."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from perception.published.feedback import (
    FeedbackCollapsedError,
    FeedbackSettings,
    literal_kappa,
    next_kappa,
    normalised_loss,
    step_factor,
    stop_reason,
)

POSITIVE = st.floats(1e-6, 1e6)


@given(POSITIVE, POSITIVE)
def test_the_normalised_loss_is_a_share_and_the_factor_is_bounded(loss, scale):
    eps_n = normalised_loss(loss, scale)
    assert 0.0 <= eps_n <= 1.0
    assert 0.85 <= step_factor(eps_n, 0.85) <= 1.0


@given(POSITIVE, st.floats(1.5, 10.0))
def test_kappa_only_falls_and_never_below_its_minimum(loss, kappa):
    settings = FeedbackSettings()
    assert settings.kappa_min <= next_kappa(kappa, loss, 5.0, settings) <= kappa


def test_the_normalised_loss_does_not_depend_on_the_unit():
    assert normalised_loss(25.0, 6.0) == pytest.approx(normalised_loss(25.0e-6, 6.0e-3))


def test_equation_18_as_printed_collapses_in_millimetres_and_stands_still_in_metres():
    with pytest.raises(FeedbackCollapsedError, match="-72"):
        literal_kappa(3.0, 25.0, "mm")
    assert literal_kappa(3.0, 25.0, "m") == pytest.approx(3.0, abs=1e-4)
    assert literal_kappa(3.0, 0.5, "mm") == pytest.approx(1.5)


def test_without_feedback_kappa_stays():
    for rule in ("fixed", "jitter"):
        assert next_kappa(2.2, 99.0, 5.0, FeedbackSettings(rule=rule)) == 2.2


@pytest.mark.parametrize(
    ("kappa", "kept", "eps_n", "scores", "reason"),
    [
        (3.0, 0.49, 0.5, [9.0], "49 %"),
        (3.0, 0.9, 0.009, [9.0], "small"),
        (1.5, 0.9, 0.5, [9.0], "minimum"),
        (3.0, 0.9, 0.5, [9.0, 8.99, 8.98], "no gain"),
        (3.0, 0.9, 0.5, [9.0] * 10, "all rounds"),
        (3.0, 0.9, 0.5, [9.0, 8.0, 7.0], None),
    ],
)
def test_the_loop_says_why_it_stops(kappa, kept, eps_n, scores, reason):
    found = stop_reason(kappa, kept, eps_n, scores, FeedbackSettings())
    assert (found is None) if reason is None else (found is not None and reason in found)


def test_curves_over_rounds_do_not_stop_early():
    settings = FeedbackSettings(stop_early=False)
    assert stop_reason(1.5, 0.9, 0.0, [1.0, 1.0, 1.0], settings) is None
