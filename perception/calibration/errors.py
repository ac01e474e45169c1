"""Why a calibration is refused."""

from __future__ import annotations

from typing import ClassVar

from perception.errors import PortdockError


class CalibrationError(PortdockError):
    """Measurements do not give a calibration that could be trusted. What was in force before stays in force."""

    code: ClassVar[str] = "calibration"
    default_remedy: ClassVar[str] = "Mend what is named above and measure again; the calibration in force is unchanged."
