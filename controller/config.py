"""The site configuration: typed, bounded, unknown keys refused. YAML in; every key carries its unit.

A site file overrides what differs from ``config/default.yaml``, and that what differs from the values below. Nothing
here opens a device.
"""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, ValidationError

from controller.arm_config import ArmConfig
from controller.charger_config import ChargerConfig
from controller.coarse_config import CoarseConfig
from controller.config_layers import layers, merged
from controller.config_section import ConfigError, PoseConfig, Section
from controller.config_units import unit_of
from controller.insertion_config import InsertionConfig
from controller.scanner_config import ScannerConfig
from controller.service_config import ServiceConfig


class PortConfig(Section):
    """Which port the site expects, and where."""

    model: str = "ccs2"
    """Bundled port name or path of a port file."""
    T_base_port: PoseConfig = PoseConfig()
    """Where the port is when the car stands as it should."""
    lateral_mm: Annotated[float, Field(gt=0, le=200)] = 40.0
    """How far sideways of its expected place the port may be."""
    along_mm: Annotated[float, Field(gt=0, le=200)] = 30.0
    """How much nearer or farther than expected it may be."""
    tilt_deg: Annotated[float, Field(gt=0, le=45)] = 20.0
    """How far its axis may point elsewhere than expected."""
    roll_deg: Annotated[float, Field(gt=0, le=180)] = 15.0
    """How far it may be turned about its axis."""
    T_port_tcp: PoseConfig | None = None
    """The mated plug in the port's frame: `portdock teach` finds it. None: as the port's description says."""


class ViewpointConfig(Section):
    """From where a sweep looks at the port: rotated about the port's axes."""

    pitch_deg: Annotated[float, Field(ge=-40, le=40)] = 0.0
    """About the port's x axis."""
    yaw_deg: Annotated[float, Field(ge=-40, le=40)] = 0.0
    """About the port's y axis."""


class ScanConfig(Section):
    """How a sweep is made."""

    standoff_mm: Annotated[float, Field(ge=50, le=1000)] = 290.0
    """Distance of the scanner from the port plane while it sweeps."""
    length_mm: Annotated[float, Field(ge=20, le=500)] = 180.0
    """Way of the sweep, acceleration not counted."""
    width_mm: Annotated[float, Field(gt=0, le=500)] | None = None
    """Across the sweep. None: the port's own width and ``margin_mm`` on both sides."""
    margin_mm: Annotated[float, Field(ge=0, le=100)] = 15.0
    """How far off its expected place the port must still be seen whole."""
    overlap_percent: Annotated[float, Field(ge=5, le=60)] = 20.0
    """Of the laser line, between neighbouring passes of a scanner with a narrow window."""
    step_mm: Annotated[float, Field(ge=0.1, le=10)] = 1.0
    """Between two stops of a sweep with ``scanner.sync: stop_and_go``."""
    speed_mm_s: Annotated[float, Field(gt=0, le=100)] = 35.0
    """Speed of the sweep."""
    acceleration_mm_s2: Annotated[float, Field(gt=0, le=2000)] = 200.0
    """Acceleration of the sweep."""
    centre_mm: tuple[float, float] = (0.0, -18.0)
    """Centre of the sweep in the port's plane (x, y)."""
    min_points: Annotated[int, Field(ge=100, le=1_000_000)] = 5000
    """A sweep with fewer points is not tried."""
    viewpoints: Annotated[tuple[ViewpointConfig, ...], Field(min_length=1, max_length=6)] = (
        ViewpointConfig(),
        ViewpointConfig(pitch_deg=12.0),
        ViewpointConfig(yaw_deg=12.0),
    )
    """Where a mission looks from, one after the other, until a scan is accepted."""


class MotionConfig(Section):
    """Speeds and accelerations in free space."""

    joint_speed_deg_s: Annotated[float, Field(gt=0, le=85)] = 40.0
    """Of the fastest joint on the way to staging."""
    joint_acceleration_deg_s2: Annotated[float, Field(gt=0, le=170)] = 80.0
    """Of the fastest joint."""
    linear_speed_mm_s: Annotated[float, Field(gt=0, le=250)] = 80.0
    """Of the tool on straight ways in free space."""
    approach_speed_mm_s: Annotated[float, Field(gt=0, le=100)] = 50.0
    """Of the plug on its way to the pre-contact point."""
    acceleration_mm_s2: Annotated[float, Field(gt=0, le=2000)] = 300.0
    """Of the tool on straight ways."""
    pre_contact_mm: Annotated[float, Field(ge=5, le=200)] = 30.0
    """Gap between plug and rim plane where the guarded motion starts."""
    retreat_mm: Annotated[float, Field(ge=20, le=400)] = 90.0
    """How far the plug backs off the rim plane in the end."""


class MissionConfig(Section):
    """Attempts and what a mission waits for."""

    max_attempts: Annotated[int, Field(ge=1, le=5)] = 3
    """Docking attempts of one mission."""
    charge_s: Annotated[float, Field(ge=0, le=1_000_000)] = 5.0
    """How long current must flow before the mission counts as charged and, in a dry run, ends."""
    min_charge_current_a: Annotated[float, Field(gt=0, le=500)] = 2.0
    """Less is not charging."""
    on_final_failure: Literal["retreat", "hold"] = "retreat"
    """After the last failed attempt. ``retreat``: back out along the inserted axis. ``hold``: stand still, force mode
    off, until a person comes."""
    when_full: Literal["undock", "stay"] = "undock"
    """When the charger says that the vehicle is full."""


class DeadlinesConfig(Section):
    """The longest stay in each state. In a dry run with --fast they count emulated time."""

    self_check_s: Annotated[float, Field(gt=0, le=600)] = 30.0
    """Self check."""
    staging_s: Annotated[float, Field(gt=0, le=600)] = 40.0
    """Way to staging."""
    scanning_s: Annotated[float, Field(gt=0, le=600)] = 60.0
    """One sweep."""
    locating_s: Annotated[float, Field(gt=0, le=600)] = 120.0
    """Locating the port in one scan."""
    approaching_s: Annotated[float, Field(gt=0, le=600)] = 40.0
    """Approach."""
    inserting_s: Annotated[float, Field(gt=0, le=600)] = 60.0
    """Contact, push and search."""
    verifying_s: Annotated[float, Field(gt=0, le=600)] = 15.0
    """Proof of mating."""
    charging_s: Annotated[float, Field(gt=0, le=1_000_000)] = 100_000.0
    """Charging."""
    releasing_s: Annotated[float, Field(gt=0, le=600)] = 30.0
    """Power off, unlock, unplug."""
    retreating_s: Annotated[float, Field(gt=0, le=600)] = 40.0
    """Retreat."""
    hold_s: Annotated[float, Field(gt=0, le=36_000)] = 300.0
    """A pause; one that lasts longer is a fault."""


class HostConfig(Section):
    """What is asked of the computer that portdock runs on."""

    stall_ms: Annotated[float, Field(ge=50, le=10_000)] = 500.0
    """A supervisor's tick that comes later than this stops whatever moves."""


class RecordingConfig(Section):
    """Where missions are recorded."""

    folder: str = "portdock-runs"
    """Where each mission gets a folder of its own."""
    keep_mb: Annotated[float, Field(gt=1, le=1_000_000)] = 2000.0
    """Oldest recordings are removed while all of them together are larger."""


class CalibrationConfig(Section):
    """Where calibrations are kept, and how long they may be used."""

    folder: str = "portdock-calibrations"
    """What `portdock calibrate` and `portdock teach` write, and what missions read."""
    max_age_days: Annotated[float, Field(gt=0, le=10_000)] = 180.0
    """An older calibration is not used: calibrate again."""


class SiteConfig(Section):
    """Everything a site can set."""

    site: str = "unnamed"
    """Name of the site, as it stands in recordings and reports."""
    port: PortConfig = PortConfig()
    scan: ScanConfig = ScanConfig()
    scanner: ScannerConfig = ScannerConfig()
    coarse: CoarseConfig | None = None
    """A second scanner that roughly finds the port first. None: the port is near where it is expected."""
    arm: ArmConfig = ArmConfig()
    charger: ChargerConfig = ChargerConfig()
    motion: MotionConfig = MotionConfig()
    insertion: InsertionConfig = InsertionConfig()
    mission: MissionConfig = MissionConfig()
    deadlines: DeadlinesConfig = DeadlinesConfig()
    host: HostConfig = HostConfig()
    recording: RecordingConfig = RecordingConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    service: ServiceConfig = ServiceConfig()

    @property
    def insertion_here(self) -> InsertionConfig:
        """``insertion`` with what differs for the site's port."""
        return self.insertion.on(Path(self.port.model).stem)


def load_config(path: Path | None = None, scanner: str | None = None) -> SiteConfig:
    """The defaults, a scanner's bundled site on top, the site file at ``path`` on top of both. Raises ConfigError."""
    return parse_config(merged(layers(path, scanner)))


def parse_config(values: dict[str, Any]) -> SiteConfig:
    """Values as read from YAML -> configuration. Raises ConfigError that names key, bound and unit."""
    try:
        return SiteConfig.model_validate(values)
    except ValidationError as error:
        raise _explained(error) from None


def as_yaml(config: SiteConfig) -> str:
    """The effective values, every key, as YAML."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, default_flow_style=None)


def _explained(error: ValidationError) -> ConfigError:
    """The first problem as one line of cause and one of remedy."""
    problem = error.errors()[0]
    key = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        near = difflib.get_close_matches(str(problem["loc"][-1]), _keys_beside(problem["loc"]), n=1, cutoff=0.5)
        remedy = f"Did you mean '{near[0]}'?" if near else "Remove it; `portdock config show` lists every key."
        return ConfigError(f"unknown key '{key}'", remedy=remedy)
    unit = unit_of(str(problem["loc"][-1]))
    unit = f" {unit}" if unit else ""
    bounds = {"greater_than": ">", "greater_than_equal": ">=", "less_than": "<", "less_than_equal": "<="}
    if problem["type"] in bounds:
        limit = next(iter(problem["ctx"].values()))
        text = f"{key} is {problem['input']}{unit}, outside its bound"
        return ConfigError(text, remedy=f"Give a value {bounds[problem['type']]} {limit:g}{unit}.")
    return ConfigError(f"{key}: {problem['msg'].lower()} (got {problem['input']!r})")


def _keys_beside(location: tuple[int | str, ...]) -> list[str]:
    """The keys that are known where an unknown one stands."""
    model: Any = SiteConfig
    for part in location[:-1]:
        field = model.model_fields.get(str(part)) if hasattr(model, "model_fields") else None
        model = field.annotation if field else model
    return list(getattr(model, "model_fields", {}))
