import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.clock_fit import MAX_DRIFT, fit_clock


def delivered(
    rng: np.random.Generator, offset_s: float, drift: float, jitter_s: float, n: int = 400, rate: float = 1.0
):  # type: ignore[no-untyped-def]
    """Device times of a sweep of 6 s, and when they arrive: never early, mostly late."""
    device = 1000.0 + np.linspace(0.0, 6.0, n)
    return device, offset_s + rate * (1 + drift) * device + rng.uniform(0.0, jitter_s, n)


@settings(max_examples=100, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(-1e4, 1e4),
    st.floats(-150e-6, 150e-6),
    st.floats(0.0, 0.1),
    st.sampled_from([1.0, 0.2]),
)
def test_offset_and_drift_are_found_under_delivery_jitter(
    seed: int, offset_s: float, drift: float, jitter_s: float, rate: float
) -> None:
    device, host = delivered(np.random.default_rng(seed), offset_s, drift, jitter_s, rate=rate)
    fit = fit_clock(device, host, rate=rate)
    error = fit.host_s(device) - (offset_s + rate * (1 + drift) * device)
    assert abs(error).max() < 1e-6 + 0.05 * jitter_s
    assert abs(fit.spread_s - 0.95 * jitter_s) < 0.1 * jitter_s + 1e-6


def test_jitter_of_5_ms_leaves_less_than_a_tenth_of_a_millisecond() -> None:
    errors = []
    for seed in range(50):
        device, host = delivered(np.random.default_rng(seed), 12.0, 50e-6, 0.005)
        fit = fit_clock(device, host)
        errors.append(np.abs(fit.host_s(device) - 12.0 - (1 + 50e-6) * device).max())
    assert np.median(errors) < 1e-4


def test_no_sample_lies_below_the_fitted_line() -> None:
    rng = np.random.default_rng(0)
    device, host = delivered(rng, 0.0, 0.0, 0.1)
    assert (host - fit_clock(device, host).host_s(device)).min() > -1e-9


def test_some_very_late_samples_do_not_move_the_line() -> None:
    device, host = delivered(np.random.default_rng(1), 5.0, 0.0, 0.001)
    late = host.copy()
    late[::3] += 0.5
    before, after = fit_clock(device, host), fit_clock(device, late)
    np.testing.assert_allclose(after.host_s(device), before.host_s(device), atol=1e-4)


def test_delay_that_grows_over_the_sweep_does_not_pass_for_drift() -> None:
    device, host = delivered(np.random.default_rng(2), 5.0, 0.0, 0.001)
    fit = fit_clock(device, host + 0.2 * np.linspace(0, 1, len(host)))
    assert abs(fit.drift) <= MAX_DRIFT
    assert abs(fit.host_s(device) - 5.0 - device).max() < 0.003


def test_one_sample_gives_an_offset() -> None:
    fit = fit_clock(np.array([3.0]), np.array([10.0]))
    assert fit.host_s(np.array([3.0])).tolist() == [10.0]
    assert fit.drift == pytest.approx(0.0, abs=MAX_DRIFT)


@pytest.mark.parametrize(
    ("device", "host"), [([], []), ([1.0], [1.0, 2.0]), ([float("nan")], [1.0]), ([1.0], [float("inf")])]
)
def test_samples_that_cannot_be_fitted_are_refused(device: list[float], host: list[float]) -> None:
    with pytest.raises(ValueError, match="clock"):
        fit_clock(np.array(device), np.array(host))
