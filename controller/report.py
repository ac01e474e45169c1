"""A recording -> one self-contained HTML page: what happened, how good it was, what an operator does now.

The page is written from the recording alone, so it can be made again at any time and anywhere; it loads nothing from
anywhere and runs no script.
"""

from __future__ import annotations

import base64
import contextlib
import os
from pathlib import Path
from typing import ClassVar, Literal

from jinja2 import Environment, PackageLoader, StrictUndefined

from controller import report_figures as figures
from controller.recording_reader import Recording, read_recording
from controller.report_facts import Alignment, StateSpan, alignment, insertion_traces, state_spans
from controller.report_page import Pictures, page_of
from perception.errors import PortdockError

REPORT_NAME = "report.html"


class ReportError(PortdockError):
    """The report cannot be written."""

    code: ClassVar[str] = "report"
    default_remedy: ClassVar[str] = "Give a writable folder with enough space; the recording itself is not touched."


def write_report(recording: Path, out: Path) -> Path:
    """Write the report of a recording to ``out``, a file or an existing folder; an older report is replaced.

    Raises RecordingFileError if there is no readable recording, ReportError if the report cannot be written.
    """
    target = out / REPORT_NAME if out.is_dir() else out
    text = render_report(read_recording(recording))
    partial = target.with_name(target.name + ".part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, target)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink()
        raise ReportError(f"cannot write the report {target}: {error.strerror}") from error
    return target


def render_report(recording: Recording) -> str:
    """The report of a recording as HTML."""
    spans, view = state_spans(recording), alignment(recording)
    page = page_of(recording, spans, view, _pictures(recording, spans, view))
    loader = PackageLoader("controller", "templates")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    return environment.get_template("report.html.j2").render(page=page)


def _pictures(recording: Recording, spans: tuple[StateSpan, ...], view: Alignment | None) -> Pictures:
    traces = insertion_traces(recording)
    return Pictures(
        timeline=_address("svg", figures.timeline(spans)) if spans else "",
        aligned=_address("png", figures.aligned_views(view)) if view else "",
        residuals=_address("png", figures.residuals(view)) if view else "",
        force_depth=_address("svg", figures.force_over_depth(traces)) if traces else "",
        force_time=_address("svg", figures.force_over_time(traces)) if traces else "",
    )


def _address(kind: Literal["svg", "png"], picture: bytes) -> str:
    media_type = {"svg": "image/svg+xml", "png": "image/png"}[kind]
    return f"data:{media_type};base64,{base64.b64encode(picture).decode('ascii')}"
