"""The laser scanner's section of the configuration: its protocol, its line, its place on the arm, its optics."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from controller.config_section import PoseConfig, Section

Protocol = Literal["framed", "profiler2", "scip"]
Sync = Literal["stop_and_go", "timestamp", "trigger", "shared_clock"]


class Profiler2Config(Section):
    """What a SICK Profiler 2 needs to be told; see ``drivers.scanner.profiler2``. Optics: inferred, to be confirmed."""

    reference_mm: Annotated[float, Field(ge=10, le=1000)] = 100.0
    """Distance at which the device's Y is 0."""
    y_away: bool = False
    """Whether the device's Y grows away from it."""
    thinning: Annotated[int, Field(ge=1, le=15)] = 4
    """Every n-th of the 832 points is read: whole profiles take 0.3 s at 115,200 baud."""
    address_in_words: bool = False
    """Whether block addresses count words instead of bytes: the manual's example fits both."""
    tolerant: bool = False
    """Accept replies with the manual's known misprints."""
    window_mm: Annotated[float, Field(gt=0, le=500)] = 30.0
    """Width of the laser line."""
    range_noise_um: Annotated[float, Field(ge=0, le=1e6)] = 20.0
    """1 sigma of one range."""
    systematic_um: Annotated[float, Field(ge=0, le=1e6)] = 50.0
    """1 sigma of what neighbouring ranges have in common. Averaging does not help."""


class ScipConfig(Section):
    """What a SCIP 2 range finder measures and how well; see ``drivers.scanner.scip``."""

    first_step: Annotated[int, Field(ge=0, le=9999)] | None = None
    """First step of a scan. None: the device's first."""
    last_step: Annotated[int, Field(ge=0, le=9999)] | None = None
    """Last step of a scan. None: the device's last."""
    cluster: Annotated[int, Field(ge=1, le=99)] = 1
    """So many neighbouring steps are one range, the least of them."""
    skip: Annotated[int, Field(ge=0, le=9)] = 0
    """So many scans are left out after each that is sent."""
    intensity: bool = False
    """Ask for intensities as well."""
    two_characters: bool = False
    """Two-character ranges: shorter frames, at most 4095 mm."""
    window_mm: Annotated[float, Field(gt=0, le=5000)] = 400.0
    """Width that the sweep counts on at its stand-off."""
    range_noise_um: Annotated[float, Field(ge=0, le=1e6)] = 10_000.0
    """1 sigma of one range. Averaging helps against this one."""
    systematic_um: Annotated[float, Field(ge=0, le=1e6)] = 10_000.0
    """1 sigma of what colour, incidence and distance add to neighbouring ranges alike. Averaging does not help."""


class ScannerConfig(Section):
    """The laser profiler."""

    protocol: Protocol = "framed"
    """``framed``: a stream of frames described by ``format``. ``profiler2``, ``scip``: drivers of their own."""
    format: str = "wide_xz"
    """Name of a bundled frame description, or path of one. Only with ``protocol: framed``."""
    device: str = "/dev/serial/by-id/scanner"
    """Serial device; a name under /dev/serial/by-id survives replugging."""
    serial: str | None = None
    """The scanner's serial number, for its calibrations. None: its device name stands for it."""
    baud_rate: Annotated[int, Field(ge=9600, le=12_000_000)] = 3_000_000
    """Of the serial line."""
    T_flange_scanner: PoseConfig = PoseConfig()
    """Hand-eye: the scanner's frame at the flange."""
    latency_ms: Annotated[float, Field(ge=-500, le=500)] = 0.0
    """Constant delay from the device's time stamp to the measurement: ``portdock calibrate time-offset``."""
    sync: Sync = "timestamp"
    """How profiles find their arm pose. ``stop_and_go``: the arm rests for each. ``timestamp``: both devices' clocks
    are fitted to the host's. ``trigger``: an edge of the arm's digital output starts each exposure. ``shared_clock``:
    scanner and arm stamp by one clock, so delays on the way do not matter."""
    trigger_output: Annotated[int, Field(ge=0, le=7)] = 0
    """Standard digital output of the arm's controller that is wired to the scanner's trigger input."""
    trigger_hz: Annotated[float, Field(gt=0, le=100)] = 25.0
    """Rate of the trigger edges."""
    silence_ms: Annotated[float, Field(ge=50, le=60_000)] = 1000.0
    """With the laser on, a scanner that sends no good profile for so long is lost."""
    max_lost_profiles_percent: Annotated[float, Field(ge=0, le=50)] = 5.0
    """A sweep that lost more is repeated."""
    profiler2: Profiler2Config = Profiler2Config()
    scip: ScipConfig = ScipConfig()
