"""``portdock locate``: where the port is in scan files."""

from __future__ import annotations

import enum
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from perception.errors import InputError
from perception.estimate import PortEstimate, Prior
from perception.port_model import PortModel
from perception.scan import Cloud

if TYPE_CHECKING:
    from perception.cover import OpenCover
    from perception.geometry import Pose
    from perception.views_locate import ViewsEstimate


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
    merge: Annotated[
        bool, typer.Option("--merge", help="the scans show one port: register them and locate once")
    ] = False,
    poses: Annotated[
        Path | None,
        typer.Option(help="with --merge: JSON with 'poses', the arm's 4x4 T_base_scanner of each scan, metres"),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="write one HTML page for each scan into this folder")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object for each scan")] = False,
) -> None:
    """Find the charging port in scans. Exit code 0: all accepted, 1: some refused, 2: bad input."""
    from controller.locate_inputs import read_poses, read_prior, requested_models
    from controller.reports.locate import write_report
    from perception.cloud_io import read_cloud
    from perception.cover import find_cover

    # Everything is read before anything is computed or written: bad input leaves nothing half done.
    expected = None if prior is None else read_prior(prior)
    models = requested_models(model, model_unit)
    T_base_scanner = None if poses is None else read_poses(poses, len(scans))
    clouds = [read_cloud(scan, scan_unit) for scan in scans]
    merged = None
    if merge or poses is not None:
        merged = _merged(clouds, models, expected, method, T_base_scanner)
        scans, clouds = [_merged_name(scans)], [merged.cloud]
    refused = False
    for scan, cloud in zip(scans, clouds, strict=True):
        estimate = merged.estimate if merged is not None else _located(cloud, models, expected, method)
        cover = find_cover(cloud, estimate) if estimate.accepted else None
        refused |= not estimate.accepted
        typer.echo(json.dumps(as_record(scan, estimate, cover)) if as_json else as_text(scan, estimate, cover))
        if report is not None:
            named = {one.name: one for one in models}
            write_report(
                report / f"{scan.stem}.html", scan.name, cloud, named[estimate.port], estimate, expected, cover
            )
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


def _merged(
    clouds: Sequence[Cloud],
    models: Sequence[PortModel],
    prior: Prior | None,
    method: Method,
    T_base_scanner: Sequence[Pose] | None,
) -> ViewsEstimate:
    from perception.views_locate import locate_views

    if len(models) > 1 or method is not Method.DEFAULT:
        raise InputError("--merge takes one model and the default method", remedy="Name one port with --model.")
    T_first_view = None
    if T_base_scanner is not None:
        T_first_view = [T_base_scanner[0].inverse() @ pose for pose in T_base_scanner]
    return locate_views(clouds, models[0], prior, T_first_view)


def _merged_name(scans: Sequence[Path]) -> Path:
    """What the merged scan is called in output and reports."""
    return Path("+".join(scan.stem for scan in scans))


def as_record(scan: Path, estimate: PortEstimate, cover: OpenCover | None = None) -> dict[str, object]:
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
        "cover": None if cover is None else _cover_record(cover),
    }


def _cover_record(cover: OpenCover) -> dict[str, object]:
    return {
        "hinge": cover.side,
        "opening_deg": math.degrees(cover.opening_rad),
        "T_box": cover.T_ref_box.matrix.tolist(),
        "size_mm": [2e3 * half for half in cover.half_size_m],
    }


def as_text(scan: Path, estimate: PortEstimate, cover: OpenCover | None = None) -> str:
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
        + (
            ""
            if cover is None
            else f"\n  open cover, hinged {cover.side}, opened {math.degrees(cover.opening_rad):.0f} deg"
        )
    )
