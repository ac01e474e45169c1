"""``portdock model``: the ports that can be located: bundled ones, and the user's own from CAD or merged scans."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from perception.geometry import Array, Pose

app = typer.Typer(help="Port models: list, add from CAD or a merged scan, draw, build.", no_args_is_help=True)


@app.command("list")
def list_models(as_json: Annotated[bool, typer.Option("--json", help="one JSON array")] = False) -> None:
    """Name every port model, where it comes from and how far its numbers can be trusted."""
    rows = _rows()
    if as_json:
        typer.echo(
            json.dumps([dict(zip(("name", "title", "grade", "teach_before_docking"), r, strict=True)) for r in rows])
        )
        return
    for name, title, grade, teach in rows:
        typer.echo(f"{name:12} {title}; grade {grade}{'; teach before docking' if teach else ''}")


def _rows() -> list[tuple[str, str, str, bool]]:
    from controller.port_files import bundled_ports, load_port
    from controller.port_library import user_models

    rows: list[tuple[str, str, str, bool]] = []
    for name in bundled_ports():
        port = load_port(name)
        rows.append((name, port.title, port.grade, port.teach_before_docking))
    rows += [
        (own.name, f"{own.title} (yours, from {own.source})", "-", own.mated_depth_mm is None) for own in user_models()
    ]
    return rows


@app.command("add")
def add(
    file: Annotated[Path, typer.Argument(help="a mesh (.stl .ply .obj) or a merged scan (.ply .pcd .xyz .npz)")],
    name: Annotated[str, typer.Option(help="what --model will call it")],
    unit: Annotated[str, typer.Option(help="unit of the file: m, cm or mm")],
    title: Annotated[str, typer.Option(help="one line for people")] = "",
    pose: Annotated[
        Path | None, typer.Option(help="JSON with the key 'T': 4x4 pose of the port frame in the file's frame, metres")
    ] = None,
    crop_mm: Annotated[
        float, typer.Option(min=10.0, max=300.0, help="of a scan: keep what lies within so much of the port's axis")
    ] = 90.0,
    mated_depth_mm: Annotated[
        float | None, typer.Option(min=0.0, max=200.0, help="depth of the mated plug's front below the rim plane")
    ] = None,
    replace: Annotated[bool, typer.Option("--replace", help="overwrite a model of this name")] = False,
) -> None:
    """Make a port model of CAD or of a merged scan. Port frame: z out of the vehicle, y up, origin on the rim plane."""
    from controller.locate_inputs import read_pose
    from controller.port_files import bundled_ports
    from controller.port_library import ModelLibraryError, UserModel, check_name, has_model, load_model, store_model

    check_name(name)
    if name in bundled_ports():
        raise ModelLibraryError(f"{name!r} is a bundled port", remedy="Give your model another name.")
    if has_model(name) and not replace:
        raise ModelLibraryError(f"there is a model {name!r} already", remedy="Add --replace, or give another name.")
    T_file_port = None if pose is None else read_pose(pose, "T")
    vertices, faces = _surface(file, unit, T_file_port, crop_mm / 1e3)
    path = store_model(UserModel(name, title or file.stem, file.name, mated_depth_mm), vertices, faces)
    samples = load_model(name).surface
    typer.echo(f"{path}: {len(faces)} faces, {len(samples)} samples that can be seen from the front")


def _surface(file: Path, unit: str, T_file_port: Pose | None, radius_m: float) -> tuple[Array, NDArray[np.int64]]:
    """Mesh in metres and the port frame, of a mesh file or of a scan."""
    from perception.mesh_io import MESH_SUFFIXES, read_mesh
    from perception.port_model import PortModel

    if file.suffix.lower() not in MESH_SUFFIXES or _is_cloud(file):
        vertices, faces = _scanned(file, unit, T_file_port, radius_m)
    else:
        vertices, faces = read_mesh(file, unit)
        vertices = vertices if T_file_port is None else T_file_port.inverse().apply(vertices)
    PortModel.from_mesh(file.stem, vertices, faces)  # whatever is wrong with it shows before anything is stored
    return vertices, faces


def _is_cloud(file: Path) -> bool:
    """Whether a .ply holds points without faces."""
    if file.suffix.lower() != ".ply" or not file.is_file():
        return False
    with file.open("rb") as stream:
        head = stream.read(4096).split(b"end_header")[0]
    words = head.split()
    return b"face" not in words or words[words.index(b"face") + 1] == b"0"


def _scanned(file: Path, unit: str, T_file_port: Pose | None, radius_m: float) -> tuple[Array, NDArray[np.int64]]:
    from perception.cloud_io import read_cloud
    from perception.errors import InputError
    from perception.scan_mesh import mesh_from_points

    if T_file_port is None:
        raise InputError(
            f"{file.name} is a scan: where in it the port frame is must be told",
            remedy="Give --pose with a JSON file whose key 'T' is the 4x4 pose of the port frame, in metres.",
        )
    points = T_file_port.inverse().apply(read_cloud(file, unit).points)
    near = (points[:, 0] ** 2 + points[:, 1] ** 2 < radius_m**2) & (abs(points[:, 2]) < 0.1)
    return mesh_from_points(points[near])


@app.command("show")
def show(
    model: Annotated[str, typer.Argument(help="name of a model, or a mesh file")],
    out: Annotated[Path | None, typer.Option(help="picture to write, .png; NAME.png here by default")] = None,
    unit: Annotated[str, typer.Option(help="unit of a mesh file: m, cm or mm")] = "m",
) -> None:
    """Draw a model as the locator knows it: what can be seen, from the front and from two sides."""
    from controller.port_models import port_model
    from controller.reports.model_drawing import write_drawing

    prepared = port_model(model, unit)
    low, high = prepared.size
    width, height, depth = (high - low) * 1e3
    typer.echo(
        f"{prepared.name}: {width:.1f} x {height:.1f} mm, {depth:.1f} mm deep; {len(prepared.surface)} samples;"
        f" checksum {prepared.checksum[:12]}"
    )
    typer.echo(write_drawing(out or Path(f"{prepared.name}.png"), prepared))


@app.command("build")
def build(out: Annotated[Path, typer.Argument(help="folder for the meshes; made if it is missing")]) -> None:
    """Build the meshes of all bundled port descriptions: binary STL, metres, port frame."""
    from controller.port_files import bundled_ports, load_port
    from controller.port_library import as_stl
    from perception.errors import InputError
    from perception.port_solid import build_mesh

    for name in bundled_ports():
        path = out / f"{name}.stl"
        vertices, faces = build_mesh(load_port(name).shape)
        try:
            out.mkdir(parents=True, exist_ok=True)
            path.write_bytes(as_stl(vertices, faces))
        except OSError as error:
            raise InputError(
                f"cannot write {path}: {error.strerror or error}", remedy="Name a writable folder."
            ) from error
        typer.echo(path)
