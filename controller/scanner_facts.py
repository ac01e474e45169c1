"""What the controller must know of a configured scanner, whatever its protocol: optics, precision, delays."""

from __future__ import annotations

from dataclasses import dataclass

from controller.scanner_config import ScannerConfig
from controller.scanner_files import load_scanner

_PROFILER2_TURN_S = 0.0015
"""The device takes 1 to 2 ms to begin an answer."""
_PROFILER2_WIRE_BYTES = 10 + 12 + 14
"""Address answer, header question, header answer: what lies between the measurement and its time stamp's arrival."""
_PROFILER2_CLOCK_PERIOD_S = 6.5536
_SCIP_CLOCK_PERIOD_S = (1 << 24) * 1e-3
_SCIP_STEPS = 682
"""Of a URG-04LX; a device with more is later by its constant, which calibration or ``scip.last_step`` tells."""


@dataclass(frozen=True, slots=True)
class ScannerFacts:
    """Optics, precision and delays of one scanner."""

    title: str
    window_m: float
    """Width of the laser line at the stand-off."""
    noise_m: float
    """1 sigma of one range, independent from point to point."""
    systematic_m: float
    """1 sigma of the error that neighbouring points share."""
    latency_s: float
    """Least delay from a profile's time stamp to the arrival that ``Profile.time_s`` tells, calibration included."""
    calibrated_s: float
    """The part of it that calibration found."""
    clock_period_s: float | None
    """After so long the device's time stamp starts again; None for a device that sends none."""


def scanner_facts(scanner: ScannerConfig) -> ScannerFacts:
    """What the configuration says of the scanner. Raises ScannerFileError."""
    byte_s, calibrated_s = 10.0 / scanner.baud_rate, scanner.latency_ms / 1000.0
    if scanner.protocol == "profiler2":
        own = scanner.profiler2
        delay_s = 2 * _PROFILER2_TURN_S + _PROFILER2_WIRE_BYTES * byte_s
        optics = own.window_mm * 1e-3, own.range_noise_um * 1e-6, own.systematic_um * 1e-6
        return ScannerFacts("Profiler 2", *optics, delay_s + calibrated_s, calibrated_s, _PROFILER2_CLOCK_PERIOD_S)
    if scanner.protocol == "scip":
        range_finder = scanner.scip
        characters = 2 if range_finder.two_characters else 3
        first, last = range_finder.first_step, range_finder.last_step
        steps = _SCIP_STEPS if first is None or last is None else last - first + 1
        delay_s = (steps * characters * 65 / 64 / range_finder.cluster + 30) * byte_s
        optics = (
            range_finder.window_mm * 1e-3,
            range_finder.range_noise_um * 1e-6,
            range_finder.systematic_um * 1e-6,
        )
        return ScannerFacts("SCIP range finder", *optics, delay_s + calibrated_s, calibrated_s, _SCIP_CLOCK_PERIOD_S)
    described = load_scanner(scanner.format)
    delay_s = described.exposure_s / 2.0 + described.layout.size * byte_s
    clock = described.layout.clock
    return ScannerFacts(
        described.title or described.name,
        described.window_m,
        described.range_noise_m,
        described.systematic_m,
        delay_s + calibrated_s,
        calibrated_s,
        None if clock is None else clock.modulus * clock.unit_s,
    )
