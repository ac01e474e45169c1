"""``portdock replay``: a recorded mission once more through the same controller, and where the two part."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

EXIT_DIFFERENT = 1


def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The .mcap file of a mission.")],
    recorded_estimates: Annotated[
        bool, typer.Option("--recorded-estimates", help="Do not locate anew: give the recorded answers.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Replay a recording without devices: exit 0 if the controller does the same again, 1 at the first difference."""
    from controller.recording.reader import read_recording  # these take seconds to import
    from controller.replay.replay import replay as run

    show = (lambda state: None) if as_json else (lambda state: print(f"  {state}"))
    result = run(read_recording(file), show, recorded_estimates=recorded_estimates)
    if as_json:
        facts = {
            "same": result.difference is None,
            "difference": None if result.difference is None else str(result.difference),
            "ended": result.ended,
            "complete": result.complete,
            "outcome": result.outcome,
            "states": list(result.states),
            "decisions": result.decisions,
            "arm_commands": result.arm_commands,
            "estimates": result.estimates,
        }
        print(json.dumps(facts))
    else:
        counts = f"{len(result.states)} states, {result.decisions} decisions, {result.arm_commands} arm commands, "
        cut = "" if result.complete else "; the recording has no end and is compared as far as it goes"
        print(f"replayed: {counts}{result.estimates} estimates{cut}")
        print("no difference" if result.difference is None else f"first difference: {result.difference}")
    if result.difference is not None:
        raise typer.Exit(EXIT_DIFFERENT)
