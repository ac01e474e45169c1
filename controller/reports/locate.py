"""One located scan -> one self-contained HTML page: verdict with reasons, scan and model at the pose, residuals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controller.reports import figures
from controller.reports.facts import aligned, place_of, sigma
from controller.reports.html import address, render, write_page
from controller.reports.page import AMBER, GREEN, Tile
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


def write_report(
    target: Path, scan: str, cloud: Cloud, model: PortModel, estimate: PortEstimate, prior: Prior | None
) -> Path:
    """Write the page of one scan to ``target``, replacing an older one. Raises ReportError."""
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
        numbers=_numbers(cloud, estimate, prior),
        aligned=address("png", figures.aligned_views(view)),
        residuals=address("png", figures.residuals(view)),
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


def _shown(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "unknown"
