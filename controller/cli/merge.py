"""``portdock merge``: several scans of one port into one complete cloud, without a model."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Annotated

import numpy as np
import typer

from perception.geometry import Array

_THIN_M = 0.001


def merge(
    scans: Annotated[list[Path], typer.Argument(metavar="SCAN...", help=".ply, .pcd, .xyz or .npz, two or more")],
    out: Annotated[Path, typer.Option(help="merged cloud, .ply or .npz, in the first scan's frame, metres")],
    scan_unit: Annotated[str, typer.Option(help="unit of the scans: m, cm or mm")] = "m",
) -> None:
    """Register scans of one port, one after another and then jointly, and write them as one cloud."""
    import small_gicp

    from perception.cloud_io import read_cloud
    from perception.published.merging import merge_views

    _check_target(out)  # before anything is computed
    clouds = [read_cloud(scan, scan_unit) for scan in scans]
    thin = [np.asarray(small_gicp.voxelgrid_sampling(cloud.points, _THIN_M, 1).points())[:, :3] for cloud in clouds]
    merged = merge_views([points * 1e3 for points in thin])
    everything = merged.cloud([cloud.points * 1e3 for cloud in clouds]) / 1e3
    _write(out, everything)
    for scan, pose, overlap in zip(scans, merged.T_first_view, merged.overlap, strict=True):
        x, y, z = pose.translation
        rx, ry, rz = pose.rotvec * 180 / np.pi
        typer.echo(
            f"{scan.name}: moved by {x:.2f} {y:.2f} {z:.2f} mm, {rx:.2f} {ry:.2f} {rz:.2f} deg; {overlap:.0%} overlap"
        )
    typer.echo(f"{out}: {len(everything)} points")


def _check_target(out: Path) -> None:
    from perception.errors import InputError

    if out.suffix not in _WRITERS:
        raise InputError(f"{out.name} is no known kind of cloud", remedy="Name a .ply or .npz file.")
    if not out.parent.is_dir():
        raise InputError(f"the folder {out.parent} does not exist", remedy="Make it, or name another file.")


def _write(out: Path, points: Array) -> None:
    """Writes beside and renames: an interruption leaves no half a file."""
    with tempfile.NamedTemporaryFile(dir=out.parent, suffix=out.suffix, delete=False) as file:
        _WRITERS[out.suffix](file, points)
    os.replace(file.name, out)


def _write_ply(file: IO[bytes], points: Array) -> None:
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    file.write((header + "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n").encode())
    file.write(points.astype("<f4").tobytes())


def _write_npz(file: IO[bytes], points: Array) -> None:
    np.savez_compressed(file, points=points)


_WRITERS: dict[str, Callable[[IO[bytes], Array], None]] = {".ply": _write_ply, ".npz": _write_npz}
