"""A port model by name or path: bundled descriptions are built into meshes, the user's own and mesh files are read."""

from __future__ import annotations

from pathlib import Path

from controller.port_files import bundled_ports, load_port
from controller.port_library import has_model, load_model, user_models
from perception.errors import UnknownPortError
from perception.mesh_io import MESH_SUFFIXES, read_mesh
from perception.port_model import PortModel
from perception.port_solid import build_mesh, loose_heights_m


def port_model(name_or_path: str, unit: str = "m") -> PortModel:
    """The prepared model of a bundled port, one of the user's, a description (.yaml) or a mesh file (unit m, cm or mm).

    Raises UnknownPortError, PortFileError, ModelLibraryError, MeshError or UnitError.
    """
    if has_model(name_or_path) and name_or_path not in bundled_ports():
        return load_model(name_or_path)
    suffix = Path(name_or_path).suffix.lower()
    if suffix in MESH_SUFFIXES:
        vertices, faces = read_mesh(Path(name_or_path), unit)
        return PortModel.from_mesh(Path(name_or_path).stem, vertices, faces)
    if suffix and suffix not in (".yaml", ".yml"):
        known = f"{', '.join(bundled_ports())}; mesh files end with {', '.join(MESH_SUFFIXES)}"
        raise UnknownPortError(f"{name_or_path} is neither a port's name nor a mesh file", remedy=f"Known: {known}.")
    try:
        port = load_port(name_or_path)
    except UnknownPortError as error:
        own = ", ".join(model.name for model in user_models())
        raise UnknownPortError(error.cause, remedy=f"{error.remedy}{f' Your own: {own}.' if own else ''}") from error
    vertices, faces = build_mesh(port.shape)
    # A port that is not known well (some round ones: by flange corners alone) is found by all that it has.
    loose = () if port.teach_before_docking else loose_heights_m(port)
    return PortModel.from_mesh(port.name, vertices, faces, T_port_tcp=port.T_port_tcp, loose_heights_m=loose)
