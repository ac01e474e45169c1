"""``portdock teach PORT``: learn from a plug that is in how the plug sits in the located port."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from controller.calibrations.in_force import basis_in_force, device_names, examine_calibrations, mock_names
from controller.calibrations.record import Calibration, versions_here
from controller.calibrations.store import CalibrationStore
from controller.calibrations.words import pose_words
from controller.cli.scan import (
    ConfigOption,
    ErrorsOption,
    FastOption,
    MockCellOption,
    MockOption,
    SeedOption,
    cell_for,
    show_quarters,
)
from controller.config import load_config
from controller.mock_calibrations import cell_name
from controller.port_files import load_port


def teach(
    port: Annotated[str, typer.Argument(help="The port that the car has, as port.model names it.")],
    config: ConfigOption = None,
    mock: MockOption = False,
    seed: SeedOption = 0,
    scenario: ErrorsOption = "uncalibrated",
    mock_cell: MockCellOption = None,
    fast: FastOption = False,
) -> None:
    """Dock by force, note where the plug is once it is locked, back off, look three times. The arm will move.

    Stored only if the scans agree within 0.3 mm and 0.2 deg; later docks end where this one did.
    """
    from controller.calibrations.teach_session import teach_port  # devices take seconds to import

    site = load_config(config)
    site = site.model_copy(update={"port": site.port.model_copy(update={"model": port, "T_port_tcp": None})})
    drawn = load_port(port).T_port_tcp
    with ExitStack() as closing:
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="portdock-teach-")))
        cell, pace = cell_for(closing, site, mock, seed, scenario, fast, number=mock_cell, remade=("port",))
        taught = teach_port(cell, folder, show_quarters, pace=pace, heartbeat_mode=1 if mock else 3)
    devices = mock_names(cell_name(site, scenario, seed, mock_cell)) if mock else device_names(site)
    one = Calibration(
        kind="port",
        pose=taught.T_port_tcp,
        covariance=taught.covariance,
        devices=devices,
        measured=datetime.now(UTC),
        residuals=(("spread_mm", 1e3 * taught.spread_m), ("spread_deg", float(np.rad2deg(taught.spread_rad)))),
        port=Path(port).stem,
        made_with=basis_in_force(examine_calibrations(site, devices)),
        versions=versions_here(),
    )
    path = CalibrationStore(Path(site.calibration.folder)).add(one)
    typer.echo(f"T_port_tcp: {pose_words(one.pose)}")
    off_deg = np.rad2deg(drawn.angle_to(one.pose))
    typer.echo(f"  {1e3 * drawn.distance_to(one.pose):.2f} mm and {off_deg:.2f} deg off the port's drawing")
    typer.echo(f"three scans agree within {1e3 * taught.spread_m:.3f} mm and {np.rad2deg(taught.spread_rad):.3f} deg")
    typer.echo(f"in force: {path}")
