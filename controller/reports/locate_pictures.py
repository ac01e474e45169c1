"""What the page of one located scan draws beside the common pictures: how well each place of the model is confirmed."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from controller.reports import figures
from perception.cover import OpenCover
from perception.estimate import PortEstimate
from perception.geometry import Array
from perception.port_model import PortModel

SEEN_M = 0.0015
"""A place of the model is seen when scan points lie this near."""
_MAX_MM = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Confirmed:
    """The model's samples and what the scan says about each."""

    points: Array
    """(M, 3) m, port frame."""
    offset_m: Array
    """(M,) mean distance of the scan points near, along the sample's normal, positive outside; NaN: none near."""
    regions: tuple[tuple[str, NDArray[np.bool_]], ...]
    """Names of the parts of the inlet, and which samples (M,) belong to each."""

    def seen(self, region: NDArray[np.bool_]) -> tuple[float, float]:
        """Share of a region's samples that are seen, and the median size of their offsets (m)."""
        offset = self.offset_m[region]
        known = offset[np.isfinite(offset)]
        share = len(known) / max(len(offset), 1)
        return share, float(np.median(np.abs(known))) if len(known) else float("nan")


def confirmed(cloud: Array, model: PortModel, estimate: PortEstimate) -> Confirmed:
    """The model at the estimate against scan points (N, 3) in the estimate's frame."""
    surface = model.surface
    local = estimate.T_ref_port.inverse().apply(cloud)
    low, high = model.size
    local = local[((local > low - 0.01) & (local < high + 0.01)).all(axis=1)]
    offset = np.full(len(surface.points), np.nan)
    if len(local):
        distance, index = cKDTree(local).query(surface.points, k=min(4, len(local)), distance_upper_bound=SEEN_M)
        distance, index = np.atleast_2d(distance.T).T, np.atleast_2d(index.T).T
        near = np.isfinite(distance)
        gap = local[np.where(near, index, 0)] - surface.points[:, None]
        along = np.where(near, np.einsum("nkj,nj->nk", gap, surface.normals), 0.0)
        any_near = near.any(axis=1)
        offset[any_near] = along[any_near].sum(axis=1) / near[any_near].sum(axis=1)
    return Confirmed(surface.points, offset, _regions(model))


def _regions(model: PortModel) -> tuple[tuple[str, NDArray[np.bool_]], ...]:
    front, points = model.front, model.surface.points
    i, j, known = front.cells(points)
    inner = front.inner[i, j] & known
    contact = (front.feature[i, j] > 0) & known
    deep = points[:, 2] < -0.012
    return (
        ("the whole that can be seen", np.ones(len(points), dtype=bool)),
        ("rim and what lies outside it", ~inner),
        ("contacts and wells", inner & contact),
        ("inlet's faces within the rim", inner & ~contact & ~deep),
        ("deeper than 12 mm", inner & deep),
    )


def model_map(found: Confirmed, cover: OpenCover | None, estimate: PortEstimate) -> bytes:
    """The model from the front and from the right, coloured by the scan's offset; grey where nothing was seen. PNG."""
    points, offset = 1e3 * found.points, 1e3 * found.offset_m
    seen = np.isfinite(offset)
    order = np.flatnonzero(seen)[np.argsort(points[seen, 2])]
    with figures.styled(10.0, 4.8) as figure:
        views = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
        for axes, (across, title, x) in zip(
            views, ((0, "from the front", "x, mm"), (2, "from the right", "z, mm")), strict=True
        ):
            axes.scatter(points[~seen, across], points[~seen, 1], s=1.0, color="#d5dbe1", linewidths=0)
            drawn = axes.scatter(
                *(points[order, across], points[order, 1]),
                c=offset[order],
                s=2.0,
                cmap="coolwarm",
                vmin=-_MAX_MM,
                vmax=_MAX_MM,
                linewidths=0,
            )
            if cover is not None:
                _outline(axes, 1e3 * estimate.T_ref_port.inverse().apply(cover.corners)[:, [across, 1]])
            figures.label(axes, f"scan against the model, {title}", x, "y, mm")
        bar = figure.colorbar(drawn, ax=views[1], extend="both", shrink=0.8)
        bar.set_label("mm, positive: scan before the surface")
        return figures.picture(figure, "png")


def _outline(axes: object, corners: Array) -> None:
    """The edges of a box whose corners (8, 2) come in binary order."""
    for a, b in combinations(range(8), 2):
        if bin(a ^ b).count("1") == 1:
            axes.plot(*corners[[a, b]].T, color=figures.FORCE, linewidth=1.0)  # type: ignore[attr-defined]
