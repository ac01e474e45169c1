"""``portdock locate``: where the port is in scan files."""

from __future__ import annotations

import enum
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, cast

import typer

from perception.errors import InputError
from perception.estimate import PortEstimate, Prior
from perception.port_model import PortModel
from perception.scan import Cloud


class Method(enum.StrEnum):
    """How to locate: the default locator, or a profile of the published method."""

    DEFAULT = "default"
    LITERAL = "literal"
    FAITHFUL = "faithful"
    ROBUST = "robust"


def locate(
    scans: Annotated[list[Path], typer.Argument(metavar="SCAN...", help=".ply, .pcd, .xyz or .npz")],
    model: Annotated[str, typer.Option(help="bundled port, several with commas, auto, or a mesh: .stl .ply .obj")],
    model_unit: Annotated[str, typer.Option(help="unit of the mesh: m, cm or mm")] = "m",
    scan_unit: Annotated[str, typer.Option(help="unit of the scans: m, cm or mm")] = "m",
    prior: Annotated[Path | None, typer.Option(help="JSON with the key 'prior': 4x4 T_scanner_port in metres")] = None,
    method: Annotated[Method, typer.Option(help="the default locator, or a profile of the published method")] = (
        Method.DEFAULT
    ),
    report: Annotated[Path | None, typer.Option(help="write one HTML page for each scan into this folder")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object for each scan")] = False,
) -> None:
    """Find the charging port in scans. Exit code 0: all accepted, 1: some refused, 2: bad input."""
    from controller.locate_inputs import read_prior, requested_models
    from perception.cloud_io import read_cloud

    # Everything is read before anything is computed or written: bad input leaves nothing half done.
    expected = None if prior is None else read_prior(prior)
    models = requested_models(model, model_unit)
    clouds = [read_cloud(scan, scan_unit) for scan in scans]
    refused = False
    for scan, cloud in zip(scans, clouds, strict=True):
        estimate = _located(cloud, models, expected, method)
        refused |= not estimate.accepted
        typer.echo(json.dumps(as_record(scan, estimate)) if as_json else as_text(scan, estimate))
        if report is not None:
            _write_report(report, scan, cloud, estimate, expected, {one.name: one for one in models}[estimate.port])
    if refused:
        raise typer.Exit(1)


def _located(cloud: Cloud, models: Sequence[PortModel], prior: Prior | None, method: Method) -> PortEstimate:
    from perception.locate import locate as run

    if method is Method.DEFAULT:
        return run(cloud, models[0] if len(models) == 1 else models, prior)
    if len(models) > 1:
        raise InputError("the published method takes one model", remedy="Name one port with --model.")
    from perception.published.pipeline import locate_published
    from perception.published.profiles import ProfileName

    return locate_published(cloud, models[0], prior, cast(ProfileName, method.value))


def as_record(scan: Path, estimate: PortEstimate) -> dict[str, object]:
    """What ``--json`` prints for a scan."""
    rms = estimate.rms_residual_m
    return {
        "scan": str(scan),
        "T": estimate.T_ref_port.matrix.tolist(),
        "port": estimate.port,
        "ok": estimate.accepted,
        "verdict": estimate.verdict,
        "reasons": list(estimate.reasons),
        "covariance": [[v if math.isfinite(v) else None for v in row] for row in estimate.covariance.tolist()],
        "rms_residual_mm": rms * 1e3 if math.isfinite(rms) else None,
        "inlier_ratio": estimate.inlier_ratio,
        "runner_up_margin": estimate.runner_up_margin,
        "timings_s": dict(estimate.timings_s),
    }


def as_text(scan: Path, estimate: PortEstimate) -> str:
    """A few lines for people."""
    if not estimate.accepted:
        return "\n".join([f"{scan.name}: {estimate.port} refused", *(f"  - {reason}" for reason in estimate.reasons)])
    pose = estimate.T_ref_port
    x, y, z = pose.translation * 1e3
    rx, ry, rz = pose.rotvec * 180 / math.pi
    sigma = [math.sqrt(v) for v in estimate.covariance.diagonal()]
    return (
        f"{scan.name}: {estimate.port} at x {x:.2f} y {y:.2f} z {z:.2f} mm,"
        f" rotation vector {rx:.2f} {ry:.2f} {rz:.2f} deg\n"
        f"  1 sigma {math.hypot(*sigma[:3]) * 1e3:.3f} mm, {math.degrees(math.hypot(*sigma[3:])):.3f} deg;"
        f" residual {estimate.rms_residual_m * 1e3:.3f} mm; {estimate.elapsed_s:.2f} s\n"
        f"  {'; '.join(estimate.reasons)}"
    )


def _write_report(
    folder: Path, scan: Path, cloud: Cloud, estimate: PortEstimate, prior: Prior | None, model: PortModel
) -> None:
    from controller.reports.locate import write_report

    write_report(folder / f"{scan.stem}.html", scan.name, cloud, model, estimate, prior)
