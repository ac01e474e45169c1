"""The coarse stage's section of the configuration: another scanner that finds roughly where the car's port is."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from controller.config_section import Section
from controller.scanner_config import ScannerConfig


class CoarseConfig(Section):
    """A first look with a second scanner on the arm: it only says where the precise one is to look."""

    scanner: ScannerConfig = ScannerConfig(protocol="scip", device="/dev/serial/by-id/coarse-scanner", baud_rate=115200)
    """A SCIP range finder, or any other scanner: what is too coarse to dock with is good enough here."""
    lateral_mm: Annotated[float, Field(gt=0, le=250)] = 120.0
    """How far sideways of its expected place the port may be: takes the place of ``port.lateral_mm`` for this look."""
    along_mm: Annotated[float, Field(gt=0, le=200)] = 60.0
    """How much nearer or farther than expected it may be: takes the place of ``port.along_mm``."""
    standoff_mm: Annotated[float, Field(ge=100, le=1000)] = 400.0
    """Distance of the coarse scanner from the expected port plane."""
    speed_mm_s: Annotated[float, Field(gt=0, le=100)] = 40.0
    """Of its sweep: at 10 scans a second, lines are a tenth of this apart."""
