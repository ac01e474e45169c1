"""What a recording gives back that no driver or locator type stands for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from controller.summary import ContactSummary
from drivers.base import Direction, LinkHealth
from perception.estimate import PortEstimate
from perception.scan import Cloud

Level = Literal["debug", "info", "warning", "error", "fatal"]


@dataclass(frozen=True, slots=True)
class ScannerChunk:
    """Bytes of the serial line exactly as one read returned them, or one write took them."""

    direction: Direction
    host_time_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Transition:
    """One step of the state machine."""

    time_s: float
    """Host's monotonic time, as for everything in a recording."""
    from_state: str
    event: str
    to_state: str
    mission_time_s: float
    """The mission's own time: the same on a real cell, faster in a dry run with ``--fast``."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What the safety gate said to a command."""

    time_s: float
    name: str
    detail: str
    allowed: bool
    reason: str


@dataclass(frozen=True, slots=True)
class Located:
    """An answer of the locator, and when it was given."""

    time_s: float
    estimate: PortEstimate


@dataclass(frozen=True, slots=True)
class Scanned:
    """The cloud of a finished sweep."""

    time_s: float
    cloud: Cloud


@dataclass(frozen=True, slots=True)
class SweepTaken:
    """What one sweep was made of: a replay takes the same, to the last sample."""

    time_s: float
    profiles: int
    """Number of profiles that were fetched from the scanner."""
    arm_first_s: float
    arm_last_s: float
    """Times of the first and the last arm sample that were used."""


@dataclass(frozen=True, slots=True)
class Contacted:
    """The contact numbers of one attempt."""

    time_s: float
    attempt: int
    contact: ContactSummary


@dataclass(frozen=True, slots=True)
class LinkReport:
    """The health of one link."""

    time_s: float
    link: str
    health: LinkHealth


@dataclass(frozen=True, slots=True)
class Note:
    """A line of the mission's log."""

    time_s: float
    level: Level
    text: str


@dataclass(frozen=True, slots=True)
class Drops:
    """Messages of a topic that were not recorded because the disk did not keep up."""

    time_s: float
    topic: str
    count: int


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file inside the recording."""

    name: str
    media_type: str
    data: bytes
