"""A port model as the locator knows it, drawn: samples from the front, from the right and from above. PNG."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from controller.reports import figures
from controller.reports.html import ReportError
from perception.port_model import PortModel

_VIEWS = (
    ("from the front", 0, 1, "x, mm", "y, mm"),
    ("from the right", 2, 1, "z, mm", "y, mm"),
    ("from above", 0, 2, "x, mm", "z, mm"),
)


def write_drawing(target: Path, model: PortModel) -> Path:
    """Write the picture, its folder made. Raises ReportError."""
    picture = drawing(model)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(picture)
    except OSError as error:
        raise ReportError(f"cannot write {target}: {error.strerror or error}") from error
    return target


def drawing(model: PortModel) -> bytes:
    """Samples coloured by depth in the front view, by the share of viewpoints that see them in the side views."""
    points = model.surface.points * 1e3
    order = np.argsort(points[:, 2])
    with figures.styled(11.0, 4.2) as figure:
        grid = figure.subplots(1, 3)
        for axes, (title, across, up, x, y) in zip(grid, _VIEWS, strict=True):
            front = across == 0 and up == 1
            colour = points[order, 2] if front else model.surface.visibility[order]
            shown = axes.scatter(
                points[order, across], points[order, up], c=colour, s=1.2, cmap="viridis", linewidths=0, rasterized=True
            )
            figures.label(axes, f"{model.name} {title}", x, y)
            figure.colorbar(shown, ax=axes, shrink=0.75, label="depth z, mm" if front else "share of viewpoints")
        return figures.picture(figure, "png")
