"""A mission on the terminal: live on a real one, plain lines elsewhere, nothing at all with ``--json``.

``make_display`` chooses; whoever runs a mission talks to a ``MissionDisplay`` and never asks which one it is.
"""

from __future__ import annotations

from itertools import pairwise
from types import TracebackType
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from controller.summary import MissionSummary

_REST = "READY"
_TONES = {"charged": "green", "refused": "yellow", "intervention-needed": "red", "fault": "red", "stopped": "white"}
_PLAIN_STEPS = 4
"""A plain log tells progress in quarters."""


class MissionDisplay:
    """Shows nothing. The others override what they show."""

    def state(self, name: str, elapsed_s: float) -> None:
        """The mission entered a state, ``elapsed_s`` after it began."""

    def progress(self, label: str, fraction: float, detail: str) -> None:
        """How far the sweep or the insertion is, 0 to 1."""

    def note(self, text: str) -> None:
        """One line worth knowing."""

    def finish(self, result: MissionSummary) -> None:
        """The mission is over."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the terminal back."""


class PlainDisplay(MissionDisplay):
    """One line for each event, for logs and pipes."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._told: tuple[str, int] = ("", 0)

    def state(self, name: str, elapsed_s: float) -> None:
        self._line(f"{elapsed_s:8.1f} s  {name}")
        self._told = ("", 0)

    def progress(self, label: str, fraction: float, detail: str) -> None:
        step = (label, int(_PLAIN_STEPS * max(0.0, min(1.0, fraction))))
        if step[1] and step != self._told:
            self._line(f"            {label} {100 * step[1] // _PLAIN_STEPS} %  {detail}".rstrip())
            self._told = step

    def note(self, text: str) -> None:
        self._line(text)

    def finish(self, result: MissionSummary) -> None:
        self._line("")
        for name, value in result_rows(result):
            self._line(f"{name + ':':<24} {value}")
        for name, seconds in time_by_state(result):
            self._line(f"{'time in ' + name + ':':<24} {seconds:.1f} s")
        for name, path in evidence(result):
            self._line(f"{name + ':':<24} {path}")

    def _line(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)


class LiveDisplay(MissionDisplay):
    """States as they pass, a bar for sweep and insertion, a table in the end."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._passed: list[tuple[str, float]] = []
        """(state, time of its entry)."""
        self._progress: tuple[str, float, str] | None = None
        self._ended = False
        self._spinner = Spinner("dots")
        self._live = Live(console=console, get_renderable=self.picture, refresh_per_second=8)

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended = True
        self._live.stop()

    def state(self, name: str, elapsed_s: float) -> None:
        self._progress = None
        self._passed.append((name, elapsed_s))

    def progress(self, label: str, fraction: float, detail: str) -> None:
        self._progress = (label, max(0.0, min(1.0, fraction)), detail)

    def note(self, text: str) -> None:
        self._console.print(Text(text, style="dim"))

    def finish(self, result: MissionSummary) -> None:
        self._ended = True
        self._progress = None
        self._live.stop()
        self._console.print(result_table(result))
        for name, path in evidence(result):
            self._console.print(f"{name:<10} {path}", markup=False, highlight=False, soft_wrap=True)

    def picture(self) -> RenderableType:
        """What the terminal shows now; called by the refreshing thread."""
        passed, progress = list(self._passed), self._progress
        table = Table.grid(padding=(0, 2))
        table.add_column(width=1)
        table.add_column(min_width=12)
        table.add_column(justify="right")
        for (name, begin_s), (_, end_s) in pairwise(passed):
            table.add_row(Text("✓", style="green"), name, Text(f"{end_s - begin_s:.1f} s", style="dim"))
        if passed:
            mark = Text("✓", style="green") if self._ended or passed[-1][0] == _REST else self._spinner
            table.add_row(mark, Text(passed[-1][0], style="bold"), "")
        if progress is None:
            return table
        label, fraction, detail = progress
        bar = Table.grid(padding=(0, 2))
        bar.add_row(
            "   " + label, ProgressBar(total=1.0, completed=fraction, width=30), f"{100 * fraction:.0f} %", detail
        )
        return Group(table, bar)


def make_display(*, quiet: bool = False, console: Console | None = None) -> MissionDisplay:
    """Live on a terminal, plain lines without one, silent where the output is for a program."""
    console = console or Console()
    if quiet:
        return MissionDisplay()
    return LiveDisplay(console) if console.is_terminal else PlainDisplay(console)


def result_table(result: MissionSummary) -> Table:
    """What the mission came to, and the time in each state."""
    table = Table(title=None, show_header=False, border_style=_TONES[result.outcome])
    table.add_column(style="dim")
    table.add_column(overflow="fold")
    for name, value in result_rows(result):
        table.add_row(name, Text(value, style=_TONES[result.outcome] if name == "outcome" else ""))
    times = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in time_by_state(result))
    table.add_row("time in states", times)
    return table


def result_rows(result: MissionSummary) -> list[tuple[str, str]]:
    """(name, value with unit) of everything that is known about the result."""
    rows: list[tuple[str, str]] = [("outcome", result.outcome)]
    if result.fault is not None:
        rows.append(("fault", result.fault))
    rows += [("warning", warning) for warning in result.warnings]
    if result.remedy:
        rows.append(("remedy", result.remedy))
    rows.append(("attempts", str(result.attempts)))
    locate, contact = result.locate, result.contact
    if locate is not None:
        rows.append(("located", f"{'accepted' if locate.accepted else 'refused'} in {locate.elapsed_s:.2f} s"))
        if not locate.accepted:
            rows.append(("reasons", "; ".join(locate.reasons)))
        if locate.error_mm is not None and locate.error_deg is not None:
            rows.append(("pose against truth", f"{locate.error_mm:.2f} mm, {locate.error_deg:.2f}°"))
    if contact is not None:
        offsets = f"along {contact.along_mm:.2f} mm, lateral {contact.lateral_mm:.2f} mm"
        rows.append(("contact offsets", f"{offsets}, roll {contact.roll_deg:.2f}°, tilt {contact.tilt_deg:.2f}°"))
        rows.append(("peak force", f"{contact.peak_force_n:.1f} N"))
    return rows


def time_by_state(result: MissionSummary) -> list[tuple[str, float]]:
    """(state, seconds in it, all stays together) in the order of the first stay."""
    totals: dict[str, float] = {}
    for name, seconds in result.states:
        totals[name] = totals.get(name, 0.0) + seconds
    return list(totals.items())


def evidence(result: MissionSummary) -> list[tuple[str, str]]:
    """(name, path) of what the mission left behind."""
    paths = (("recording", result.recording), ("report", result.report))
    return [(name, str(path)) for name, path in paths if path is not None]
