"""``portdock convert``: a recording's scan, or a scan file, as PLY, PCD or NPZ."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from perception.errors import InputError
from perception.scan import Cloud

SUFFIXES = (".ply", ".pcd", ".npz")


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A recording (.mcap) or a scan: .ply .pcd .npz .xyz")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="The file to write: .ply, .pcd or .npz")],
    scan: Annotated[int | None, typer.Option(min=1, help="Of a recording: which sweep; default: all merged.")] = None,
    unit: Annotated[str, typer.Option(help="Unit of a scan file: m, cm or mm. Metres are written.")] = "m",
) -> None:
    """Write a scan in another format. An existing OUT is replaced."""
    from perception.cloud_write import npz_bytes, pcd_bytes, ply_bytes

    if target.suffix.lower() not in SUFFIXES:
        raise InputError(f"{target.name}: cannot write {target.suffix or 'this'}", remedy="Use .ply, .pcd or .npz.")
    cloud = _recorded(source, scan) if source.suffix.lower() == ".mcap" else _read(source, unit)
    match target.suffix.lower():
        case ".ply":
            data = ply_bytes(cloud.points, cloud.frame)
        case ".pcd":
            data = pcd_bytes(cloud.points, cloud.frame)
        case _:
            data = npz_bytes(cloud)
    try:
        target.write_bytes(data)
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror}", remedy="Give another OUT.") from error
    typer.echo(f"{target}: {len(cloud)} points, frame {cloud.frame}")


def _read(source: Path, unit: str) -> Cloud:
    from perception.cloud_io import read_cloud

    return read_cloud(source, unit)


def _recorded(source: Path, number: int | None) -> Cloud:
    from controller.recording.reader import read_recording
    from perception.scan import merge

    scans = [found.cloud for found in read_recording(source).scans()]
    if not scans:
        raise InputError(f"{source} holds no scan", remedy="`portdock recording info` shows what a recording holds.")
    if number is None:
        return merge(scans)
    if number > len(scans):
        raise InputError(f"{source} holds {len(scans)} scans, not {number}", remedy="Give a smaller --scan.")
    return scans[number - 1]
