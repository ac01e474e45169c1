"""``portdock doctor``: what is wrong with this computer and its links, and what to do about it."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from controller.config import load_config
from controller.doctor.examination import examine
from controller.doctor.findings import Finding, Grade


def doctor(
    config: Annotated[Path | None, typer.Option("--config", help="A site file.")] = None,
    devices: Annotated[bool, typer.Option("--devices/--no-devices", help="Look at the devices' links too.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a finding.")] = False,
) -> None:
    """Check versions, disk, clocks, port, serial devices, CAN and the robot's address. Sends nothing; nothing moves.

    Exit code 1 if a mission could not start.
    """
    worst = Grade.OK
    for finding in examine(load_config(config), devices):
        print(json.dumps(asdict(finding)) if as_json else _line(finding), flush=True)
        worst = max(worst, finding.grade, key=list(Grade).index)
    raise SystemExit(1 if worst is Grade.FAIL else 0)


def _line(finding: Finding) -> str:
    text = f"{finding.grade:4}  {finding.check:10}  {finding.text}"
    return f"{text}\n{'':18}fix: {finding.fix}" if finding.fix else text
