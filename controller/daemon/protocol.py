"""What goes over the daemon's socket: JSON objects, one a line, UTF-8. Values here, no sockets.

A client sends requests, ``{"request": "dock"}``, and gets one answer each, in order. After ``subscribe`` events follow
as they happen: ``state``, ``progress``, ``result``, ``note``. Unknown keys are to be ignored by either side.
"""

from __future__ import annotations

import enum
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

from perception.errors import InputError

MAX_LINE = 65536


class Request(enum.Enum):
    """What a client may ask."""

    DOCK = "dock"
    UNDOCK = "undock"
    RESET = "reset"
    STOP = "stop"
    ABORT = "abort"
    STATUS = "status"
    SUBSCRIBE = "subscribe"


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to one request."""

    answer: str
    """accepted, refused, nothing-to-do, status."""
    job: int | None = None
    """Number of the accepted job, or of the one that the request is about; its ``result`` event carries it."""
    reason: str = ""
    status: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class StateEvent:
    """A transition."""

    kind: ClassVar[str] = "state"
    state: str
    cause: str
    elapsed_s: float
    """Since the job began."""


@dataclass(frozen=True, slots=True)
class ProgressEvent:
    """How far a sweep or an insertion is."""

    kind: ClassVar[str] = "progress"
    label: str
    fraction: float
    detail: str


@dataclass(frozen=True, slots=True)
class NoteEvent:
    """A line worth knowing, such as what a changed configuration would do."""

    kind: ClassVar[str] = "note"
    text: str


@dataclass(frozen=True, slots=True)
class ResultEvent:
    """A job is over, or the procedure has ended by itself (job None): a fault, a full vehicle."""

    kind: ClassVar[str] = "result"
    job: int | None
    outcome: str
    fault: str | None
    remedy: str
    """What a person does now; empty when there is nothing to do."""
    summary: Mapping[str, Any] = field(default_factory=dict)
    """The mission's summary as `portdock dry-run --json` prints it; empty for what was answered at once."""


Event = StateEvent | ProgressEvent | NoteEvent | ResultEvent


def encode(message: Answer | Event) -> bytes:
    """One line."""
    values = asdict(message)
    if not isinstance(message, Answer):
        values = {"event": message.kind} | values
    return json.dumps(values, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def request_of(line: bytes) -> Request:
    """What a line asks. Raises InputError with what is wrong with it."""
    try:
        values = json.loads(line)
    except (ValueError, RecursionError) as error:  # the latter: a line of nothing but brackets
        raise InputError("not a JSON object") from error
    if not isinstance(values, dict) or not isinstance(values.get("request"), str):
        raise InputError('no "request" with a text')
    try:
        return Request(values["request"])
    except ValueError as error:
        names = ", ".join(request.value for request in Request)
        raise InputError(f"unknown request '{values['request'][:40]}'; known: {names}") from error


def message_of(line: bytes) -> Answer | Event:
    """An answer or event as it came. Raises InputError for what is neither."""
    try:
        values = json.loads(line)
        kind = values.pop("event", None)
        types = {cls.kind: cls for cls in (StateEvent, ProgressEvent, NoteEvent, ResultEvent)}
        message: Any = Answer if kind is None else types[kind]
        known = {name: value for name, value in values.items() if name in message.__slots__}
        made: Answer | Event = message(**known)
        return made
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"the daemon sent what cannot be read: {line[:80]!r}") from error
