"""One self-contained HTML page for a located scan: scan and model from two sides, residuals on the model, evidence."""

from __future__ import annotations

import base64
import io
import os
import tempfile
from pathlib import Path

import jinja2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from perception.errors import InputError
from perception.estimate import PortEstimate, Prior
from perception.geometry import Array
from perception.port_model import PortModel
from perception.scan import Cloud

_MAX_POINTS = 30_000
_RESIDUAL_RANGE_MM = 0.5

_PAGE = jinja2.Environment(autoescape=True).from_string(
    """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{{ scan }}: {{ e.port }}</title><style>
body{font:15px/1.4 sans-serif;max-width:1100px;margin:1.5em auto;padding:0 1em;color:#222}
h1{font-size:1.3em}table{border-collapse:collapse}td,th{border:1px solid #ccc;padding:.25em .6em;text-align:left}
.yes{color:#176b2c}.no{color:#a11}img{max-width:100%}code{font-size:.9em}</style></head><body>
<h1>{{ scan }}: {{ e.port }}
<span class="{{ 'yes' if e.accepted else 'no' }}">{{ 'accepted' if e.accepted else 'refused' }}</span></h1>
<ul>{% for reason in e.reasons %}<li>{{ reason }}</li>{% endfor %}</ul>
<img alt="scan and model" src="data:image/png;base64,{{ picture }}">
<table><tr><th>quantity</th><th>value</th></tr>
{% for name, value in rows %}<tr><td>{{ name }}</td><td><code>{{ value }}</code></td></tr>{% endfor %}</table>
<p>Time: {% for step, seconds in e.timings_s %}
{{ step }} {{ '%.3f' % seconds }} s{{ ', ' if not loop.last }}{% endfor %}</p>
</body></html>"""
)


def write_report(
    path: Path, scan: str, cloud: Cloud, model: PortModel, estimate: PortEstimate, prior: Prior | None
) -> None:
    """Writes the page beside ``path`` and moves it there. Raises InputError when the folder cannot be written."""
    page = _PAGE.render(
        scan=scan, e=estimate, picture=_picture(cloud, model, estimate), rows=_rows(estimate, prior, model)
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", dir=path.parent, prefix=".report-", delete=False
        ) as file:
            file.write(page)
        Path(file.name).chmod(0o644)
        os.replace(file.name, path)
    except OSError as error:
        raise InputError(
            f"the report {path} cannot be written: {error.strerror or error}",
            remedy="Name a folder with --report that can be written.",
        ) from error


def _rows(estimate: PortEstimate, prior: Prior | None, model: PortModel) -> list[tuple[str, str]]:
    sigma = np.sqrt(np.diag(estimate.covariance))
    shown = {"precision": 3, "suppress_small": True, "separator": ", "}
    rows = [
        (f"T_{estimate.ref}_port", np.array2string(estimate.T_ref_port.matrix, precision=6, suppress_small=True)),
        ("1 sigma x, y, z in mm (port frame)", np.array2string(sigma[:3] * 1e3, **shown)),  # type: ignore[arg-type]
        ("1 sigma about x, y, z in deg", np.array2string(np.rad2deg(sigma[3:]), **shown)),  # type: ignore[arg-type]
        ("residual, mm", f"{estimate.rms_residual_m * 1e3:.3f}"),
        ("share of the outline that the scan confirms", f"{estimate.inlier_ratio:.0%}"),
        ("margin over the next best pose", f"{estimate.runner_up_margin:.0%}"),
        ("verdict", estimate.verdict),
        ("model", f"{model.name} {model.checksum[:12]}"),
    ]
    if prior is not None:
        offset = prior.T_ref_port.inverse() @ estimate.T_ref_port
        rows.append(("offset from the prior in mm", np.array2string(offset.translation * 1e3, **shown)))  # type: ignore[arg-type]
        rows.append(
            ("turned from the prior in deg", f"{np.rad2deg(prior.T_ref_port.angle_to(estimate.T_ref_port)):.2f}")
        )
    return rows


def _picture(cloud: Cloud, model: PortModel, estimate: PortEstimate) -> str:
    """PNG in base64: the scan over the model from the front and from the side, and its distances to the model."""
    local = estimate.T_ref_port.inverse().apply(cloud.points)
    low, high = model.size
    near = ((local > low - 0.03) & (local < high + 0.03)).all(axis=1)
    local = local[near][:: max(1, int(near.sum()) // _MAX_POINTS)] * 1e3
    outline = model.surface.points[:: max(1, len(model.surface) // 8000)] * 1e3
    figure = Figure(figsize=(15, 5.5), layout="constrained")
    front, side, misfit = figure.subplots(1, 3)
    front.scatter(outline[:, 0], outline[:, 1], s=1, c="#bbbbbb", label="model")
    front.scatter(local[:, 0], local[:, 1], s=0.4, c=local[:, 2], cmap="viridis")
    front.set(title="from the front; colour: height", xlabel="x mm", ylabel="y mm", aspect="equal")
    middle = np.abs(local[:, 0]) < 8
    side.scatter(*outline[np.abs(outline[:, 0]) < 8][:, [2, 1]].T, s=1, c="#bbbbbb")
    side.scatter(local[middle, 2], local[middle, 1], s=0.5, c="#1f77b4")
    side.set(title="from the side, |x| < 8 mm", xlabel="z mm", ylabel="y mm", aspect="equal")
    distance = _distances(local / 1e3, model) * 1e3
    on = np.isfinite(distance)
    drawn = misfit.scatter(
        *local[on, :2].T, s=0.6, c=distance[on], cmap="coolwarm", vmin=-_RESIDUAL_RANGE_MM, vmax=_RESIDUAL_RANGE_MM
    )
    misfit.set(title="distance to the model, mm", xlabel="x mm", aspect="equal")
    figure.colorbar(drawn, ax=misfit)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def _distances(local: Array, model: PortModel) -> Array:
    """Signed distances of points (N, 3) to the nearest model plane; NaN further than 2 mm away."""
    index: NDArray[np.int32] = model.nearest.lookup(local)
    known = index < len(model.surface)
    index = np.minimum(index, len(model.surface) - 1)
    gap = np.einsum("ij,ij->i", local - model.surface.points[index], model.surface.normals[index])
    return np.where(known & (np.abs(gap) < 0.002), gap, np.nan)
