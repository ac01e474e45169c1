"""JSON messages of a recording <-> values: transitions, decisions, estimates, clouds, contact numbers, links, log.

Numbers keep all their digits (Python writes the shortest text that reads back to the same float64); a number that
is not finite becomes null, because JSON has none, and reads back as NaN. Decoders raise KeyError, TypeError or
ValueError for anything else than what the encoders write.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from controller.recording.values import (
    Contacted,
    Decision,
    Drops,
    Level,
    LinkReport,
    Located,
    Note,
    Scanned,
    SweepTaken,
    Transition,
)
from controller.summary import ContactSummary, LocateSummary, MissionSummary
from drivers.base import ArmCommandRecord, LinkHealth
from perception.estimate import PortEstimate
from perception.geometry import Pose
from perception.scan import Cloud

_LEVELS: tuple[Level, ...] = ("debug", "info", "warning", "error", "fatal")  # foxglove.Log: 1 to 5
_FLOAT32, _FLOAT64 = 7, 8  # foxglove.PackedElementField
_NUMPY_TYPES = {_FLOAT32: "<f4", _FLOAT64: "<f8"}
_BASE64_SLICE = 3 * 16384
CLOUD_FIELDS = ("x", "y", "z")


def encode_transition(transition: Transition) -> bytes:
    """Topic /state."""
    step = {"from": transition.from_state, "event": transition.event, "to": transition.to_state}
    return _dump({"time_s": transition.time_s, "mission_time_s": transition.mission_time_s, **step})


def decode_transition(data: bytes) -> Transition:
    """Topic /state."""
    m = json.loads(data)
    return Transition(m["time_s"], m["from"], m["event"], m["to"], m["mission_time_s"])


def encode_arm_command(record: ArmCommandRecord) -> bytes:
    """Topic /arm/command."""
    arguments = [_number(value) for value in record.arguments]
    return _dump({"time_s": record.time_s, "name": record.name, "arguments": arguments, "result": record.result})


def decode_arm_command(data: bytes) -> ArmCommandRecord:
    """Topic /arm/command."""
    m = json.loads(data)
    return ArmCommandRecord(m["time_s"], m["name"], tuple(_float(v) for v in m["arguments"]), m["result"])


def encode_decision(d: Decision) -> bytes:
    """Topic /command."""
    return _dump({"time_s": d.time_s, "name": d.name, "detail": d.detail, "allowed": d.allowed, "reason": d.reason})


def decode_decision(data: bytes) -> Decision:
    """Topic /command."""
    return Decision(**json.loads(data))


def encode_estimate(located: Located) -> bytes:
    """Topic /estimate."""
    e = located.estimate
    return _dump(
        {
            "time_s": located.time_s,
            "port": e.port,
            "ref": e.ref,
            "T_ref_port": _matrix(e.T_ref_port.matrix),
            "covariance": _matrix(e.covariance),
            "rms_residual_m": _number(e.rms_residual_m),
            "inlier_ratio": _number(e.inlier_ratio),
            "runner_up_margin": _number(e.runner_up_margin),
            "accepted": bool(e.accepted),
            "verdict": e.verdict,
            "reasons": list(e.reasons),
            "timings_s": [[name, _number(seconds)] for name, seconds in e.timings_s],
        }
    )


def decode_estimate(data: bytes) -> Located:
    """Topic /estimate."""
    m = json.loads(data)
    estimate = PortEstimate(
        port=m["port"],
        T_ref_port=Pose.from_matrix(m["T_ref_port"]),
        ref=m["ref"],
        covariance=np.array(m["covariance"], dtype=np.float64),
        rms_residual_m=_float(m["rms_residual_m"]),
        inlier_ratio=_float(m["inlier_ratio"]),
        runner_up_margin=_float(m["runner_up_margin"]),
        accepted=m["accepted"],
        reasons=tuple(m["reasons"]),
        timings_s=tuple((name, _float(seconds)) for name, seconds in m["timings_s"]),
        verdict=m["verdict"],
    )
    return Located(m["time_s"], estimate)


def encode_contact(contacted: Contacted) -> bytes:
    """Topic /contact."""
    values = {name: _number(getattr(contacted.contact, name)) for name in ContactSummary.__slots__}
    return _dump({"time_s": contacted.time_s, "attempt": contacted.attempt, **values})


def decode_contact(data: bytes) -> Contacted:
    """Topic /contact."""
    m = json.loads(data)
    contact = ContactSummary(**{name: _float(m[name]) for name in ContactSummary.__slots__})
    return Contacted(m["time_s"], m["attempt"], contact)


def encode_link(report: LinkReport) -> bytes:
    """Topic /link."""
    h = report.health
    health = {"up": h.up, "last_rx_s": _number(h.last_rx_s), "counters": dict(h.counters), "detail": h.detail}
    return _dump({"time_s": report.time_s, "link": report.link, **health})


def decode_link(data: bytes) -> LinkReport:
    """Topic /link."""
    m = json.loads(data)
    health = LinkHealth(m["up"], m["last_rx_s"], tuple(m["counters"].items()), m["detail"])
    return LinkReport(m["time_s"], m["link"], health)


def encode_wait(time_s: float) -> bytes:
    """Topic /wait."""
    return _dump({"time_s": time_s})


def decode_wait(data: bytes) -> float:
    """Topic /wait."""
    return float(json.loads(data)["time_s"])


def encode_sweep(sweep: SweepTaken) -> bytes:
    """Topic /sweep."""
    return _dump({name: getattr(sweep, name) for name in SweepTaken.__slots__})


def decode_sweep(data: bytes) -> SweepTaken:
    """Topic /sweep."""
    return SweepTaken(**json.loads(data))


def encode_drops(drops: Drops) -> bytes:
    """Topic /recorder/drops."""
    return _dump({"time_s": drops.time_s, "topic": drops.topic, "count": drops.count})


def decode_drops(data: bytes) -> Drops:
    """Topic /recorder/drops."""
    return Drops(**json.loads(data))


def encode_cloud(cloud: Cloud, wall_ns: int) -> bytes:
    """Topic /scan/points, foxglove.PointCloud: x, y, z as float64, so that a replay locates in the very same points."""
    points = np.ascontiguousarray(cloud.points, dtype="<f8")
    fields = [{"name": name, "offset": 8 * k, "type": _FLOAT64} for k, name in enumerate(CLOUD_FIELDS)]
    head = {"timestamp": _time(wall_ns), "frame_id": cloud.frame, "pose": _pose(Pose.identity())}
    opening = _dump({**head, "point_stride": 24, "fields": fields})[:-1]
    return b"".join([opening, b',"data":"', *_base64_slices(memoryview(points.tobytes())), b'"}'])


def decode_cloud(data: bytes, time_s: float) -> Scanned:
    """Topic /scan/points. The places of the laser are not recorded there."""
    m = json.loads(data)
    columns = {"names": [f["name"] for f in m["fields"]], "offsets": [f["offset"] for f in m["fields"]]}
    formats = [_NUMPY_TYPES[f["type"]] for f in m["fields"]]
    layout = np.dtype({**columns, "formats": formats, "itemsize": m["point_stride"]})  # type: ignore[call-overload]
    table = np.frombuffer(base64.b64decode(m["data"]), dtype=layout)
    points = np.stack([table[name].astype(np.float64) for name in CLOUD_FIELDS], axis=1)
    return Scanned(time_s, Cloud(points, m["frame_id"]))


def encode_pose_in_frame(T_frame_port: Pose, frame: str, wall_ns: int) -> bytes:
    """Topic /dock/pose, foxglove.PoseInFrame."""
    return _dump({"timestamp": _time(wall_ns), "frame_id": frame, "pose": _pose(T_frame_port)})


def encode_transform(parent: str, child: str, T_parent_child: Pose, wall_ns: int) -> bytes:
    """Topic /tf, foxglove.FrameTransform."""
    pose = _pose(T_parent_child)
    frames = {"timestamp": _time(wall_ns), "parent_frame_id": parent, "child_frame_id": child}
    return _dump({**frames, "translation": pose["position"], "rotation": pose["orientation"]})


def encode_note(note: Note, wall_ns: int) -> bytes:
    """Topic /log, foxglove.Log."""
    level = _LEVELS.index(note.level) + 1
    where = {"name": "portdock", "file": "", "line": 0}
    return _dump({"timestamp": _time(wall_ns), "level": level, "message": note.text, **where})


def decode_note(data: bytes, time_s: float) -> Note:
    """Topic /log."""
    m = json.loads(data)
    return Note(time_s, _LEVELS[max(0, m["level"] - 1)], m["message"])


def encode_summary(summary: MissionSummary) -> str:
    """The result that the recording's metadata holds."""
    return json.dumps({**summary.to_json(), "remedy": summary.remedy})


def decode_summary(text: str) -> MissionSummary:
    """The result that the recording's metadata holds; where recording and report lie is not in it."""
    m = json.loads(text)
    locate, contact = m["locate"], m["contact"]
    if locate is not None:
        locate = LocateSummary(**{**locate, "reasons": tuple(locate["reasons"])})
    if contact is not None:
        contact = ContactSummary(**{key: _float(value) for key, value in contact.items()})
    states = tuple((name, _float(seconds)) for name, seconds in m["states"])
    return MissionSummary(m["outcome"], m["fault"], m["remedy"], states, m["attempts"], locate, contact)


def _dump(message: dict[str, Any]) -> bytes:
    return json.dumps(message, separators=(",", ":")).encode()


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _float(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _matrix(matrix: np.ndarray[Any, Any]) -> list[list[float]]:
    if not np.isfinite(matrix).all():
        matrix = np.nan_to_num(matrix, nan=0.0, posinf=1e9, neginf=-1e9)  # an unbounded covariance stays large
    return [[float(v) for v in row] for row in matrix]


def _base64_slices(data: memoryview) -> Iterator[bytes]:
    """Base64 in slices: one call on megabytes would hold up every other thread, the supervisor's tick too."""
    for start in range(0, len(data), _BASE64_SLICE):
        yield base64.b64encode(data[start : start + _BASE64_SLICE])


def _time(wall_ns: int) -> dict[str, int]:
    return {"sec": wall_ns // 1_000_000_000, "nsec": wall_ns % 1_000_000_000}


def _pose(pose: Pose) -> dict[str, dict[str, float]]:
    position = dict(zip("xyz", pose.translation.tolist(), strict=True))
    orientation = dict(zip("xyzw", Rotation.from_matrix(pose.rotation).as_quat().tolist(), strict=True))
    return {"position": position, "orientation": orientation}
