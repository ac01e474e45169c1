"""The folder of calibrations: every file is kept, and a small pointer for each slot names the one that is in force.

A file is written whole and durably before its pointer moves, so a calibration that is interrupted leaves the old one in
force.
"""

from __future__ import annotations

import os
from pathlib import Path

from controller.calibrations.record import Calibration, CalibrationFileError, from_yaml, to_yaml
from controller.durable import write_durably

_POINTER = ".in-force"


class CalibrationStore:
    """A folder of calibrations; it need not exist yet."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def add(self, calibration: Calibration) -> Path:
        """Write it and put it in force; the path of its file. Raises CalibrationFileError."""
        stamp = calibration.measured.strftime("%Y%m%dT%H%M%S")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            path = self._free(f"{calibration.slot}-{stamp}")
            write_durably(path, to_yaml(calibration))
            self._point(calibration.slot, path.name)
        except OSError as error:
            raise CalibrationFileError(
                f"{self.folder}: {error.strerror or error}", remedy="Give this user the folder: calibration.folder."
            ) from error
        return path

    def restore(self, path: Path) -> Calibration:
        """Put a file of this folder in force again. Raises CalibrationFileError."""
        path = self.folder / path.name
        calibration = self.read(path)
        self._point(calibration.slot, path.name)
        return calibration

    def read(self, path: Path) -> Calibration:
        """One file. Raises CalibrationFileError."""
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise CalibrationFileError(f"{path} cannot be read: {error}") from error
        return from_yaml(text, path.name)

    def slots(self) -> tuple[str, ...]:
        """For which of them a calibration is in force."""
        return tuple(sorted(path.name.removesuffix(_POINTER) for path in self.folder.glob(f"*{_POINTER}")))

    def path_in_force(self, slot: str) -> Path | None:
        """The file that is in force, None where there is none. Raises CalibrationFileError for a damaged pointer."""
        try:
            name = (self.folder / f"{slot}{_POINTER}").read_text(encoding="utf-8").strip()
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise CalibrationFileError(f"{slot}{_POINTER} cannot be read: {error}") from error
        if name != Path(name).name or not name.endswith(".yaml"):
            raise CalibrationFileError(f"{slot}{_POINTER} names no calibration file")
        return self.folder / name

    def in_force(self, slot: str) -> Calibration | None:
        """The calibration in force, None where there is none. Raises CalibrationFileError."""
        path = self.path_in_force(slot)
        if path is None:
            return None
        calibration = self.read(path)
        if calibration.slot != slot:
            raise CalibrationFileError(f"{path.name} is a calibration of {calibration.slot}, not of {slot}")
        return calibration

    def files(self, slot: str) -> tuple[Path, ...]:
        """All files of a slot, oldest first."""
        stamped = self.folder.glob(f"{slot}-[0-9]*T[0-9]*.yaml")
        return tuple(sorted(stamped))

    def _free(self, stem: str) -> Path:
        names = (f"{stem}.yaml", *(f"{stem}-{k}.yaml" for k in range(2, 1000)))
        return next(self.folder / name for name in names if not (self.folder / name).exists())

    def _point(self, slot: str, name: str) -> None:
        write_durably(self.folder / f"{slot}{_POINTER}", name + os.linesep)
