"""The topics of a recording, each with its encoding and schema: raw ones, which are authoritative, and derived ones.

Raw topics are protobuf records of fixed layout; the others are JSON. Derived topics use Foxglove's well-known
schemas: a recording opens there with point cloud, poses, transforms and log. The JSON schemas below state field by
field what portdock writes (https://docs.foxglove.dev/docs/sdk/schemas); optional fields that it never writes are
left out.

Times: ``publish_time`` is the host's monotonic clock in ns (what every decision was based on), ``log_time`` the
same instant on the wall clock as it stood when the recording began, so that a clock step never reorders a
recording. Device times are inside the records. ``sequence`` numbers the messages of a topic from 0; a gap is where
messages were dropped.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

from controller.recording.protobuf import Layout
from controller.recording.records import ARM_STATE, CAN_FRAME, SCANNER_BYTES

FORMAT_VERSION = "1"


@dataclass(frozen=True, slots=True)
class Topic:
    """A channel of the recording."""

    name: str
    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


def _raw(name: str, layout: Layout) -> Topic:
    return Topic(name, "protobuf", layout.name, "protobuf", layout.descriptor())


def _object(properties: dict[str, object]) -> dict[str, object]:
    return {"type": "object", "properties": properties, "required": list(properties)}


def _json(name: str, schema_name: str, properties: dict[str, object]) -> Topic:
    schema = {"title": schema_name, **_object(properties)}
    return Topic(name, "json", schema_name, "jsonschema", json.dumps(schema).encode())


_TEXT = {"type": "string"}
_NUMBER = {"type": "number"}
_MAYBE_NUMBER = {"type": ["number", "null"]}
_COUNT = {"type": "integer", "minimum": 0}
_FLAG = {"type": "boolean"}
_NUMBERS = {"type": "array", "items": _NUMBER}
_MATRIX = {"type": "array", "items": _NUMBERS}
_TEXTS = {"type": "array", "items": _TEXT}
_TIME = {"title": "time", **_object({"sec": _COUNT, "nsec": {**_COUNT, "maximum": 999_999_999}})}
_VECTOR = _object({"x": _NUMBER, "y": _NUMBER, "z": _NUMBER})
_QUATERNION = _object({"x": _NUMBER, "y": _NUMBER, "z": _NUMBER, "w": _NUMBER})
_POSE = _object({"position": _VECTOR, "orientation": _QUATERNION})
_POINT_FIELD = _object({"name": _TEXT, "offset": _COUNT, "type": _COUNT})

SCANNER_RX = _raw("/scanner/rx", SCANNER_BYTES)
SCANNER_TX = _raw("/scanner/tx", SCANNER_BYTES)
COARSE_RX = _raw("/coarse/rx", SCANNER_BYTES)
COARSE_TX = _raw("/coarse/tx", SCANNER_BYTES)
CAN = _raw("/can/raw", CAN_FRAME)
ARM = _raw("/arm/state", ARM_STATE)
ARM_COMMAND = _json(
    "/arm/command", "portdock.ArmCommand", {"time_s": _NUMBER, "name": _TEXT, "arguments": _NUMBERS, "result": _TEXT}
)
STATE = _json(
    "/state",
    "portdock.Transition",
    {"time_s": _NUMBER, "mission_time_s": _NUMBER, "from": _TEXT, "event": _TEXT, "to": _TEXT},
)
COMMAND = _json(
    "/command",
    "portdock.Command",
    {"time_s": _NUMBER, "name": _TEXT, "detail": _TEXT, "allowed": _FLAG, "reason": _TEXT},
)
ESTIMATE = _json(
    "/estimate",
    "portdock.PortEstimate",
    {
        "time_s": _NUMBER,
        "port": _TEXT,
        "ref": _TEXT,
        "T_ref_port": _MATRIX,
        "covariance": _MATRIX,
        "rms_residual_m": _MAYBE_NUMBER,
        "inlier_ratio": _MAYBE_NUMBER,
        "runner_up_margin": _MAYBE_NUMBER,
        "accepted": _FLAG,
        "verdict": _TEXT,
        "reasons": _TEXTS,
        "timings_s": {"type": "array", "items": {"type": "array"}},
    },
)
CONTACT = _json(
    "/contact",
    "portdock.Contact",
    {
        "time_s": _NUMBER,
        "attempt": _COUNT,
        "along_mm": _MAYBE_NUMBER,
        "lateral_mm": _MAYBE_NUMBER,
        "roll_deg": _MAYBE_NUMBER,
        "tilt_deg": _MAYBE_NUMBER,
        "peak_force_n": _MAYBE_NUMBER,
    },
)
LINK = _json(
    "/link",
    "portdock.LinkHealth",
    {
        "time_s": _NUMBER,
        "link": _TEXT,
        "up": _FLAG,
        "last_rx_s": _MAYBE_NUMBER,
        "counters": {"type": "object", "additionalProperties": _COUNT},
        "detail": _TEXT,
    },
)
WAIT = _json("/wait", "portdock.Wait", {"time_s": _NUMBER})
SWEEP = _json(
    "/sweep",
    "portdock.Sweep",
    {"time_s": _NUMBER, "profiles": _COUNT, "arm_first_s": _NUMBER, "arm_last_s": _NUMBER},
)
DROPS = _json("/recorder/drops", "portdock.Drops", {"time_s": _NUMBER, "topic": _TEXT, "count": _COUNT})
POINTS = _json(
    "/scan/points",
    "foxglove.PointCloud",
    {
        "timestamp": _TIME,
        "frame_id": _TEXT,
        "pose": _POSE,
        "point_stride": _COUNT,
        "fields": {"type": "array", "items": _POINT_FIELD},
        "data": {"type": "string", "contentEncoding": "base64"},
    },
)
DOCK_POSE = _json("/dock/pose", "foxglove.PoseInFrame", {"timestamp": _TIME, "frame_id": _TEXT, "pose": _POSE})
TRANSFORM = _json(
    "/tf",
    "foxglove.FrameTransform",
    {
        "timestamp": _TIME,
        "parent_frame_id": _TEXT,
        "child_frame_id": _TEXT,
        "translation": _VECTOR,
        "rotation": _QUATERNION,
    },
)
LOG = _json(
    "/log",
    "foxglove.Log",
    {"timestamp": _TIME, "level": _COUNT, "message": _TEXT, "name": _TEXT, "file": _TEXT, "line": _COUNT},
)

TOPICS = (
    *(
        SCANNER_RX,
        SCANNER_TX,
        COARSE_RX,
        COARSE_TX,
        CAN,
        ARM,
        ARM_COMMAND,
        STATE,
        COMMAND,
        ESTIMATE,
        CONTACT,
        LINK,
        DROPS,
    ),
    *(WAIT, SWEEP),
    *(POINTS, DOCK_POSE, TRANSFORM, LOG),
)
