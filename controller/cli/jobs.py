"""``portdock dock|undock|stop|abort|reset|status``: talk to the daemon and end with the mission's result.

Exit codes: 0 done (also when it was done already), 1 ended otherwise than asked, 3 no daemon answers, 4 the safety
gate refused, 5 the daemon is busy with something else.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from controller.cli.progress import MissionDisplay, make_display
from controller.daemon.client import DaemonClient
from controller.daemon.places import socket_for_client
from controller.daemon.protocol import Answer, NoteEvent, ProgressEvent, Request, ResultEvent, StateEvent
from controller.faults import DONE

EXIT_OTHERWISE, EXIT_GATE, EXIT_BUSY = 1, 4, 5

Socket = Annotated[Path | None, typer.Option("--socket", help="The daemon's socket, where it is not found by itself.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of progress.")]


def dock(socket: Socket = None, as_json: Json = False) -> None:
    """Dock and charge; ends when current is measured. The arm will move."""
    _job(Request.DOCK, socket, as_json)


def undock(socket: Socket = None, as_json: Json = False) -> None:
    """End the charge, unlock, pull out, retreat. The arm will move."""
    _job(Request.UNDOCK, socket, as_json)


def stop(socket: Socket = None, as_json: Json = False) -> None:
    """Finish safely: back to READY, from contact on by way of power off, lock open, retreat. The arm may move."""
    _job(Request.STOP, socket, as_json, done=("stopped",))


def abort(socket: Socket = None, as_json: Json = False) -> None:
    """Freeze motion now and latch a fault. Not an emergency stop: use the button."""
    _job(Request.ABORT, socket, as_json, fault="aborted")


def reset(socket: Socket = None, as_json: Json = False) -> None:
    """Out of a latched fault, once its cause is removed: self check, then READY. The arm does not move."""
    _job(Request.RESET, socket, as_json)


def status(socket: Socket = None, as_json: Json = False) -> None:
    """What the daemon is doing. Exit 0 when nobody is needed, 1 when a person is."""
    with DaemonClient(socket_for_client(socket)) as client:
        known = client.ask(Request.STATUS).status or {}
    if as_json:
        sys.stdout.write(json.dumps(known) + "\n")
    else:
        for name, value in _rows(known):
            print(f"{name + ':':<12} {value}")
    if not known.get("healthy"):
        raise typer.Exit(EXIT_OTHERWISE)


DAMAGE = ("bytes_dropped", "bad_checksum", "late", "lost")
"""Of a link's counters, those that a person wants to see once they are not 0; ``--json`` has all."""


def _rows(known: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(name, value) of what a person looks for first."""
    rows = [("state", f"{known['state']} for {known['in_state_s']:.0f} s")]
    if known.get("job"):
        rows.append(("job", str(known["job"])))
    if known.get("fault"):
        rows += [("fault", str(known["fault"])), ("remedy", str(known["remedy"]))]
    if known.get("last_outcome"):
        rows.append(("last", str(known["last_outcome"])))
    if known.get("plug"):
        current = known.get("current_a")
        flow = "" if current is None else f", {current:.1f} A"
        rows.append(("plug", f"{known['plug']}, lock {known['lock']}{flow}"))
    for name, link in known.get("links", {}).items():
        damage = ", ".join(f"{what} {link['counters'][what]}" for what in DAMAGE if link["counters"].get(what))
        rows.append((name, " ".join(filter(None, ("up" if link["up"] else "DOWN", link["detail"], damage)))))
    return rows


def _job(
    request: Request, socket: Path | None, as_json: bool, done: tuple[str, ...] = tuple(DONE), fault: str | None = None
) -> None:
    """Ask, follow, print, exit. A Ctrl-C ends the following, not the mission."""
    with DaemonClient(socket_for_client(socket)) as client, make_display(quiet=as_json) as display:
        client.ask(Request.SUBSCRIBE)
        answer = client.ask(request)
        if answer.answer != "accepted":
            _not_accepted(answer, as_json)
            return
        try:
            result = _followed(client, answer.job, display)
        except KeyboardInterrupt:
            display.note("the mission goes on; `portdock stop` finishes it safely")
            raise
    _print(result, as_json)
    if result.outcome not in done and (fault is None or result.fault != fault):
        raise typer.Exit(EXIT_GATE if result.fault == "gate-refused" else EXIT_OTHERWISE)


def _followed(client: DaemonClient, job: int | None, display: MissionDisplay) -> ResultEvent:
    """Show what happens until the job's result; without a job the next result is the one."""
    for event in client.events():
        match event:
            case StateEvent():
                display.state(event.state, event.elapsed_s)
            case ProgressEvent():
                display.progress(event.label, event.fraction, event.detail)
            case NoteEvent():
                display.note(event.text)
            case ResultEvent() if job is None or event.job == job:
                return event
    raise AssertionError("events end with an error only")


def _not_accepted(answer: Answer, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps({"outcome": answer.answer, "fault": None, "remedy": answer.reason}) + "\n")
    else:
        print(answer.reason)
    if answer.answer == "refused":
        raise typer.Exit(EXIT_BUSY)


def _print(result: ResultEvent, as_json: bool) -> None:
    if as_json:
        values = {"outcome": result.outcome, "fault": result.fault, "remedy": result.remedy}
        sys.stdout.write(json.dumps({**result.summary, **values}) + "\n")
        return
    print(f"outcome:     {result.outcome}")
    if result.remedy:
        print(f"remedy:      {result.remedy}")
    for name in ("recording", "report"):
        if result.summary.get(name):
            print(f"{name + ':':<12} {result.summary[name]}")
