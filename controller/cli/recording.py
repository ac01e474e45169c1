"""``portdock recording``: what a mission's recording holds, repair of a damaged one, export to other tools' formats."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from controller.recording.compare import first_difference
from controller.recording.export import ExportFormat, export
from controller.recording.reader import Recording, read_recording
from controller.recording.recovery import recover

app = typer.Typer(help="Look into, repair and export the recording of a mission.", no_args_is_help=True)

RecordingPath = Annotated[Path, typer.Argument(metavar="FILE", help="The .mcap file of a mission.")]


@app.command()
def info(
    file: RecordingPath,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Say what a recording holds, also one that was cut short."""
    facts = _facts(read_recording(file))
    if as_json:
        print(json.dumps(facts))
        return
    for name, value in facts.items():
        if isinstance(value, dict):
            print(f"{name}:")
            for key, entry in value.items():
                print(f"  {key:<22} {entry}")
        elif isinstance(value, list):
            print(f"{name + ':':<12} {'; '.join(map(str, value)) or 'none'}")
        else:
            print(f"{name + ':':<12} {value}")


@app.command(name="recover")
def recover_command(
    file: RecordingPath,
    target: Annotated[Path | None, typer.Argument(metavar="[TARGET]", help="A new file.", show_default=False)] = None,
) -> None:
    """Copy everything that is still readable into a new, complete recording."""
    target = target or file.with_name(f"{file.stem}-recovered.mcap")
    saved = recover(file, target)
    print(f"{target}: {saved.messages} messages and {saved.attachments} attachments saved")
    for damage in saved.damage:
        print(f"  {damage}")


@app.command(name="export")
def export_command(
    file: RecordingPath,
    kind: Annotated[ExportFormat, typer.Option("--format", help="CAN as candump or BLF, scans as PLY, arm as CSV.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder; without one the recording's own.", show_default=False)
    ] = None,
) -> None:
    """Write CAN frames, scans or arm states as files that other tools read."""
    for path in export(read_recording(file), kind, out or file.parent):
        print(path)


@app.command()
def report(
    file: RecordingPath,
    out: Annotated[Path | None, typer.Option(help="File or folder; without one beside the recording.")] = None,
) -> None:
    """Write the report of a recording again."""
    from controller.reports.mission import write_report  # its pictures take half a second to import

    print(write_report(file, out or file.parent))


@app.command()
def compare(
    file: RecordingPath,
    other: Annotated[Path, typer.Argument(metavar="OTHER", help="The recording to hold against it.")],
) -> None:
    """Name the first difference in states, estimates, decisions and arm commands; exit 1 if there is one."""
    difference = first_difference(read_recording(file), read_recording(other))
    print("no difference" if difference is None else difference)
    if difference is not None:
        raise typer.Exit(1)


def _facts(recording: Recording) -> dict[str, object]:
    summary, transitions = recording.summary(), recording.transitions()
    times = [message.time_s for messages in recording.topics.values() for message in messages]
    begin_s = transitions[0].time_s if transitions else min(times, default=0.0)
    return {
        "file": str(recording.path),
        "complete": recording.complete,
        "damage": list(recording.damage),
        "outcome": None if summary is None else summary.outcome,
        "fault": None if summary is None else summary.fault,
        "duration_s": round(max(times) - begin_s, 3) if times else 0.0,
        "states": [step.to_state for step in transitions],
        "topics": {name: len(messages) for name, messages in sorted(recording.topics.items())},
        "attachments": {a.name: len(a.data) for a in recording.attachments.values()},
        "metadata": {
            f"{name}.{key}": value
            for name, table in recording.metadata.items()
            if name != "summary"
            for key, value in table.items()
        },
    }
