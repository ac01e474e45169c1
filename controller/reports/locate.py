"""One located scan -> one self-contained HTML page: verdict with reasons, scan and model at the pose, residuals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controller.reports import figures
from controller.reports.facts import aligned, place_of, sigma
from controller.reports.html import address, render, write_page
from controller.reports.locate_pictures import Confirmed, confirmed, model_map
from controller.reports.page import AMBER, GREEN, Tile
from perception.cover import OpenCover
from perception.estimate import PortEstimate, Prior
from perception.port_model import PortModel
from perception.scan import Cloud


@dataclass(frozen=True, slots=True)
class LocatePage:
    """Everything the template prints."""

    headline: str
    tone: str
    scan: str
    port: str
    took: str
    reasons: tuple[str, ...]
    tiles: tuple[Tile, ...]
    pose: str
    numbers: tuple[tuple[str, str], ...]
    aligned: str
    residuals: str
    model_map: str
    evidence: tuple[tuple[str, str, str], ...]
    """Part of the inlet, share of it that is seen, median offset."""
    rivals: tuple[str, ...]
    """The poses that were tried and lost, best first."""


def write_report(
    target: Path,
    scan: str,
    cloud: Cloud,
    model: PortModel,
    estimate: PortEstimate,
    prior: Prior | None,
    cover: OpenCover | None = None,
) -> Path:
    """Write the page of one scan to ``target``, replacing an older one. Raises ReportError."""
    found = confirmed(cloud.points, model, estimate)
    view = aligned(estimate, cloud.points, model.surface.points)
    page = LocatePage(
        headline="Located" if estimate.accepted else f"Refused: {estimate.verdict}",
        tone=GREEN if estimate.accepted else AMBER,
        scan=scan,
        port=estimate.port,
        took=f"{estimate.elapsed_s:.2f} s",
        reasons=estimate.reasons,
        tiles=_tiles(estimate),
        pose=f"T_{estimate.ref}_port = {place_of(estimate.T_ref_port)}",
        numbers=(*_numbers(cloud, estimate, prior), *_cover_rows(cover)),
        aligned=address("png", figures.aligned_views(view)),
        residuals=address("png", figures.residuals(view)),
        model_map=address("png", model_map(found, cover, estimate)),
        evidence=_evidence(found),
        rivals=_rivals(estimate),
    )
    return write_page(target, render("locate.html.j2", page))


def _tiles(estimate: PortEstimate) -> tuple[Tile, ...]:
    return (
        Tile("rms residual", _shown(1e3 * estimate.rms_residual_m, 3), "mm"),
        Tile("of the visible model seen", _shown(100 * estimate.inlier_ratio, 0), "%"),
        Tile("margin to the runner-up", _shown(estimate.runner_up_margin, 2), ""),
        Tile("1σ of the position", _shown(1e3 * sigma(estimate.covariance[:3, :3]), 3), "mm"),
        Tile("1σ of the orientation", _shown(math.degrees(sigma(estimate.covariance[3:, 3:])), 3), "°"),
    )


def _numbers(cloud: Cloud, estimate: PortEstimate, prior: Prior | None) -> tuple[tuple[str, str], ...]:
    rows = [("points in the scan", f"{len(cloud):,}")]
    if prior is not None:
        distance_mm = 1e3 * estimate.T_ref_port.distance_to(prior.T_ref_port)
        turn_deg = math.degrees(estimate.T_ref_port.angle_to(prior.T_ref_port))
        rows.append(("offset from the prior", f"{distance_mm:.1f} mm, {turn_deg:.1f}°"))
    rows += [(f"time: {step}", f"{seconds:.3f} s") for step, seconds in estimate.timings_s]
    matrix = np.array2string(estimate.T_ref_port.matrix, precision=9, suppress_small=True, max_line_width=200)
    return (*rows, ("pose as a 4x4 matrix, m", matrix))


def _evidence(found: Confirmed) -> tuple[tuple[str, str, str], ...]:
    rows = []
    for name, region in found.regions:
        if region.any():
            share, offset_m = found.seen(region)
            rows.append((name, f"{share:.0%}", f"{_shown(1e3 * offset_m, 3)} mm"))
    return tuple(rows)


def _rivals(estimate: PortEstimate) -> tuple[str, ...]:
    """One line for each pose that was tried and lost."""
    inverse = estimate.T_ref_port.inverse()
    return tuple(
        f"{place_of(inverse @ pose)} from the pose found; score {score:.2f}" for score, pose in estimate.runner_ups
    )


def _cover_rows(cover: OpenCover | None) -> tuple[tuple[str, str], ...]:
    if cover is None:
        return (("open cover", "none found"),)
    x, y, z = 2e3 * np.asarray(cover.half_size_m)
    text = (
        f"hinged {cover.side}, opened {math.degrees(cover.opening_rad):.0f}°, seen up to {1e3 * cover.seen_m:.0f} mm"
        f" from its hinge; box of {x:.0f} x {y:.0f} x {z:.0f} mm at {place_of(cover.T_ref_box)}"
    )
    return (("open cover", text),)


def _shown(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "unknown"
