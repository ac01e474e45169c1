"""What the report's pictures show, taken from a recording: pure functions, no drawing.

Everything is put on one time axis: seconds of the host's monotonic clock since the first transition.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from controller.recording import schemas
from controller.recording.reader import Recording
from controller.recording.values import Located
from perception.estimate import PortEstimate
from perception.geometry import Array, Pose

MODEL_ATTACHMENT = "model_points.npz"
AROUND_M = 0.010
"""So much of the scan around the model's bounds is shown."""
NEAR_MODEL_M = 0.002
"""Scan points farther than this from every model point belong to something else."""
_NORMAL_NEIGHBOURS = 10
_EDGE_SPACINGS = 4.0
"""A point this many sample spacings aside of its nearest sample lies beside the model's edge."""
_CONTACT_STATES = ("INSERTING", "VERIFYING")


@dataclass(frozen=True, slots=True)
class StateSpan:
    """A stay in one state, in seconds since the mission began."""

    state: str
    start_s: float
    end_s: float
    event: str
    """What ended it; empty for the last one."""


@dataclass(frozen=True, slots=True, eq=False)
class InsertionTrace:
    """One insertion as the arm felt it; all arrays (N,)."""

    attempt: int
    time_s: Array
    depth_mm: Array
    """Depth of the TCP below the port's rim plane."""
    axial_n: Array
    """Positive when it resists insertion."""
    lateral_n: Array


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """A scan and the model, both in the port frame of an estimate."""

    estimate: PortEstimate
    scan: Array
    """(N, 3) m, cropped to the model's surroundings."""
    model: Array
    """(M, 3) m."""
    distance_m: Array
    """(N,) distance of each scan point from the model's surface; inf where no model point is near."""

    @property
    def near(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """(N,) which scan points lie near the model."""
        return np.asarray(np.isfinite(self.distance_m))


def start_time_s(recording: Recording) -> float:
    """Host time of the first transition, or of the first message when there is none."""
    transitions = recording.raw(schemas.STATE)
    times = transitions[:1] or [message for messages in recording.topics.values() for message in messages[:1]]
    return min((message.time_s for message in times), default=0.0)


def state_spans(recording: Recording) -> tuple[StateSpan, ...]:
    """Every state that was entered, in order; the last one ends with the recording."""
    steps = recording.transitions()
    if not steps:
        return ()
    start_s = steps[0].time_s
    last_s = max(message.time_s for messages in recording.topics.values() for message in messages)
    ends = [(step.time_s, step.event) for step in steps[1:]] + [(last_s, "")]
    return tuple(
        StateSpan(step.to_state, step.time_s - start_s, end_s - start_s, event)
        for step, (end_s, event) in zip(steps, ends, strict=True)
    )


def insertion_traces(recording: Recording) -> tuple[InsertionTrace, ...]:
    """Depth and force of each insertion, in the port frame of the estimate it was planned from."""
    if not recording.raw(schemas.ARM):
        return ()
    start_s, table = start_time_s(recording), recording.arm_table()
    traces: list[InsertionTrace] = []
    for begin_s, end_s in _contact_periods(state_spans(recording)):
        located = _accepted_before(recording, start_s + begin_s)
        rows = table[(table["time_s"] >= start_s + begin_s) & (table["time_s"] <= start_s + end_s)]
        if located is None or len(rows) < 2:
            continue
        T_port_base = located.estimate.T_ref_port.inverse()
        depth_m = -T_port_base.apply(rows["base_tcp_translation_m"])[:, 2]
        force = T_port_base.rotate(rows["wrench"][:, :3])
        lateral = np.linalg.norm(force[:, :2], axis=1)
        traces.append(InsertionTrace(len(traces) + 1, rows["time_s"] - start_s, 1e3 * depth_m, force[:, 2], lateral))
    return tuple(traces)


def alignment(recording: Recording) -> Alignment | None:
    """The last estimate with the scan it was made from and the model; None if one of them is not recorded."""
    model = model_points(recording)
    pairs = [(located, _cloud_before(recording, located)) for located in recording.estimates()]
    usable = [(located, points) for located, points in pairs if points is not None]
    if model is None or not usable:
        return None
    located, points = usable[-1]
    return aligned(located.estimate, points, model)


def aligned(estimate: PortEstimate, points: Array, model: Array) -> Alignment:
    """Scan points (N, 3) in the estimate's frame and model points (M, 3) in the port frame, brought together."""
    seen = estimate.T_ref_port.inverse().apply(points)
    inside = ((seen > model.min(axis=0) - AROUND_M) & (seen < model.max(axis=0) + AROUND_M)).all(axis=1)
    return Alignment(estimate, seen[inside], model, surface_distance(seen[inside], model))


def model_points(recording: Recording) -> Array | None:
    """The port model's sample points (M, 3) in the port frame, as the recording carries them."""
    attachment = recording.attachments.get(MODEL_ATTACHMENT)
    if attachment is None:
        return None
    try:
        with np.load(io.BytesIO(attachment.data)) as arrays:
            points = np.asarray(arrays["points"], dtype=np.float64)
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile):
        return None
    usable = points.ndim == 2 and points.shape[1] == 3 and len(points) > _NORMAL_NEIGHBOURS
    return points if usable else None


def surface_distance(points: Array, model: Array) -> Array:
    """(N,) distance in m from each point to the plane through the model's neighbourhood of its nearest model point.

    The distance to the nearest sample alone would show the spacing of the samples. Points farther than ``NEAR_MODEL_M``
    from every sample, and points beside the model's edge, get inf.
    """
    tree = cKDTree(model)
    spacing_m = float(np.median(tree.query(model[:: max(1, len(model) // 2000)], k=2)[0][:, 1]))
    gap, nearest = tree.query(points, distance_upper_bound=NEAR_MODEL_M)
    near = np.isfinite(gap)
    used, place = np.unique(nearest[near], return_inverse=True)
    distance = np.full(len(points), np.inf)
    if len(used):
        normals = _normals(model, used, tree)
        height = np.abs(np.einsum("ij,ij->i", points[near] - model[nearest[near]], normals[place]))
        aside = np.sqrt(np.maximum(gap[near] ** 2 - height**2, 0.0))
        distance[near] = np.where(aside < _EDGE_SPACINGS * spacing_m, height, np.inf)
    return distance


def _normals(model: Array, wanted: np.ndarray[tuple[int], np.dtype[np.intp]], tree: cKDTree) -> Array:
    """(K, 3) unit normals of the model at its points ``wanted``: where its neighbourhood is thinnest."""
    _, neighbours = tree.query(model[wanted], k=_NORMAL_NEIGHBOURS)
    patches = model[neighbours]
    centred = patches - patches.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
    return np.asarray(vectors[:, :, 0])


def _contact_periods(spans: tuple[StateSpan, ...]) -> list[tuple[float, float]]:
    """(start, end) of each INSERTING together with the VERIFYING that follows it."""
    periods: list[tuple[float, float]] = []
    for span in spans:
        if span.state == _CONTACT_STATES[0]:
            periods.append((span.start_s, span.end_s))
        elif span.state == _CONTACT_STATES[1] and periods and periods[-1][1] == span.start_s:
            periods[-1] = (periods[-1][0], span.end_s)
    return periods


def _accepted_before(recording: Recording, time_s: float) -> Located | None:
    found = [
        e for e in recording.estimates() if e.estimate.accepted and e.estimate.ref == "base" and e.time_s <= time_s
    ]
    return found[-1] if found else None


def _cloud_before(recording: Recording, located: Located) -> Array | None:
    found = [s for s in recording.scans() if s.time_s <= located.time_s and s.cloud.frame == located.estimate.ref]
    return found[-1].cloud.points if found else None


def place_of(T_ref_port: Pose) -> str:
    """Position in mm and rotation vector in degrees, for a table."""
    x, y, z = (1e3 * T_ref_port.translation).tolist()
    a, b, c = np.rad2deg(T_ref_port.rotvec).tolist()
    return f"({x:.1f}, {y:.1f}, {z:.1f}) mm, ({a:.2f}, {b:.2f}, {c:.2f})°"


def sigma(block: Array) -> float:
    """Standard deviation of three coordinates together, from their (3, 3) covariance."""
    return float(np.sqrt(max(np.trace(block), 0.0)))
