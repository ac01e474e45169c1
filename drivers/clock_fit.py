"""A device's clock on the host's: offset and drift from samples that were delivered late, never early.

Each sample carries the device's time stamp and the host's time of reception. Delivery adds a delay that is never below
some least value, so the truth is the line under all points (device, host): of all lines below them, the highest one at
their mean, which is the line that a linear programme minimising the sum of delays finds (Moon, Skelly, Towsley,
"Estimation and removal of clock skew from network delay measurements", INFOCOM 1999). The least delay itself is not
observable: it is known from exposure and wire time, and subtracted by the caller.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.geometry import Array

MAX_DRIFT = 200e-6
"""Two crystals rarely differ by more: 100 ppm each. The bound keeps delays that grow over a sweep out of the slope."""


@dataclass(frozen=True, slots=True)
class ClockFit:
    """``host = offset_s + rate * (1 + drift) * device``, up to the least delay."""

    offset_s: float
    drift: float
    spread_s: float
    """95 % of the samples were delivered at most this much later than the least delay allows."""
    early_s: float = 0.0
    """5 % of the samples were delivered at most this much later. Where even these are spread out, it is doubtful that
    any sample was prompt, and with that the offset."""
    rate: float = 1.0
    """Host seconds per device second apart from drift; not 1 only where a mock's time runs faster."""

    def host_s(self, device_s: Array) -> Array:
        """Host's monotonic times (N,) of device times (N,), the least delay included."""
        return np.asarray(self.offset_s + self.rate * (1.0 + self.drift) * np.asarray(device_s, np.float64))


def fit_clock(device_s: Array, host_s: Array, *, rate: float = 1.0, max_drift: float = MAX_DRIFT) -> ClockFit:
    """Fit unwrapped device times (N,) to host times (N,), in seconds. Raises ValueError for no or NaN samples."""
    device, host = np.asarray(device_s, np.float64), np.asarray(host_s, np.float64)
    if device.shape != host.shape or device.ndim != 1 or not len(device):
        raise ValueError("a clock is fitted to as many device times as host times, at least one")
    if not (np.isfinite(device).all() and np.isfinite(host).all()):
        raise ValueError("clock samples are finite")
    middle = float(device.mean())
    from_middle = device - middle
    delay = host - rate * device
    slope = _highest_line_below(from_middle, delay, abs(rate) * max_drift)
    above = delay - slope * from_middle
    height = float(above.min())
    drift = slope / rate
    early_s, spread_s = np.quantile(above - height, [0.05, 0.95])
    return ClockFit(height - slope * middle, drift, float(spread_s), float(early_s), rate)


def _highest_line_below(x: Array, y: Array, limit: float) -> float:
    """Slope in [-limit, limit] of the line below all (x, y) that is highest at x = 0.

    Its height ``min(y - slope * x)`` is concave in the slope; bisection follows the sign of its derivative, -x of the
    point that the line touches.
    """
    low, high = -limit, limit
    for _ in range(60):
        slope = 0.5 * (low + high)
        touched = int(np.argmin(y - slope * x))
        if x[touched] == 0.0:
            return slope
        if x[touched] < 0.0:
            low = slope
        else:
            high = slope
    return 0.5 * (low + high)
