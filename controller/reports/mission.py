"""A recording -> one self-contained HTML page: what happened, how good it was, what an operator does now.

The page is written from the recording alone, so it can be made again at any time and anywhere; it loads nothing from
anywhere and runs no script.
"""

from __future__ import annotations

from pathlib import Path

from controller.recording.reader import Recording, read_recording
from controller.reports import figures
from controller.reports.facts import Alignment, StateSpan, alignment, insertion_traces, state_spans
from controller.reports.html import address, render, write_page
from controller.reports.page import Pictures, page_of

REPORT_NAME = "report.html"


def write_report(recording: Path, out: Path) -> Path:
    """Write the report of a recording to ``out``, a file or an existing folder; an older report is replaced.

    Raises RecordingFileError if there is no readable recording, ReportError if the report cannot be written.
    """
    return write_page(out / REPORT_NAME if out.is_dir() else out, render_report(read_recording(recording)))


def render_report(recording: Recording) -> str:
    """The report of a recording as HTML."""
    spans, view = state_spans(recording), alignment(recording)
    return render("report.html.j2", page_of(recording, spans, view, _pictures(recording, spans, view)))


def _pictures(recording: Recording, spans: tuple[StateSpan, ...], view: Alignment | None) -> Pictures:
    traces = insertion_traces(recording)
    return Pictures(
        timeline=address("svg", figures.timeline(spans)) if spans else "",
        aligned=address("png", figures.aligned_views(view)) if view else "",
        residuals=address("png", figures.residuals(view)) if view else "",
        force_depth=address("svg", figures.force_over_depth(traces)) if traces else "",
        force_time=address("svg", figures.force_over_time(traces)) if traces else "",
    )
