"""The root of every error portdock raises on purpose, and those that concern clouds, meshes and ports.

An error is shown to an operator as two lines: the cause (``str(error)``) and the remedy. ``code`` is stable: scripts,
reports and the fault table of ``controller/faults.py`` refer to it.
"""

from __future__ import annotations

from typing import ClassVar


class PortdockError(Exception):
    """Base class: one line of cause, one line of remedy, one stable code."""

    code: ClassVar[str] = "internal"
    default_remedy: ClassVar[str] = "Report this with the log and the recording: it is a defect of portdock."

    def __init__(self, cause: str, *, remedy: str | None = None) -> None:
        super().__init__(cause)
        self.remedy = remedy or self.default_remedy

    @property
    def cause(self) -> str:
        """What went wrong, in one line."""
        return str(self)


class InputError(PortdockError):
    """Something handed to portdock (a file, an option, an array) cannot be used as it is."""

    code = "bad-input"
    default_remedy = "Check the file or option named above."


class ScanFileError(InputError):
    """A scan file is missing, unreadable or of an unknown format."""

    code = "scan-file"
    default_remedy = "Give a readable .ply, .pcd, .xyz or .npz file."


class EmptyScanError(InputError):
    """A scan holds no finite point, or fewer than can be located."""

    code = "scan-empty"
    default_remedy = "Check that the laser saw the vehicle and that the prior points at it; scan again."


class UnitError(InputError):
    """A cloud or mesh has a size that only a wrong unit explains."""

    code = "wrong-unit"
    default_remedy = "Name the unit of the data: --scan-unit or --model-unit m|cm|mm."


class MeshError(InputError):
    """A port model's mesh cannot be read or has no faces."""

    code = "mesh"
    default_remedy = "Give an .stl, .ply or .obj surface mesh in the port frame."


class UnknownPortError(InputError):
    """No port model has this name."""

    code = "unknown-port"
    default_remedy = "Use a bundled port's name or the path of a mesh file."


class DegenerateCloudError(InputError):
    """The points do not determine what was asked for (too few, collinear, all identical)."""

    code = "degenerate-cloud"
    default_remedy = "Scan more of the port, from a viewpoint that sees its depth."
