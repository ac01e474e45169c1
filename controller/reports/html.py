"""Reports as HTML files: templates filled in, pictures put inside, files written whole or not at all."""

from __future__ import annotations

import base64
import contextlib
import os
from pathlib import Path
from typing import ClassVar, Literal

from jinja2 import Environment, PackageLoader, StrictUndefined

from perception.errors import PortdockError


class ReportError(PortdockError):
    """The report cannot be written."""

    code: ClassVar[str] = "report"
    default_remedy: ClassVar[str] = "Give a writable folder with enough space; nothing else is touched."


def render(template: str, page: object) -> str:
    """A page of ``reports/templates`` with the values of ``page``; text is escaped, a missing value is an error."""
    loader = PackageLoader("controller.reports", "templates")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    return environment.get_template(template).render(page=page)


def write_page(target: Path, text: str) -> Path:
    """Write a page, replacing an older one; its folder is made. Raises ReportError and leaves no half page behind."""
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


def address(kind: Literal["svg", "png"], picture: bytes) -> str:
    """A picture as a ``data:`` address, so that the page needs no other file."""
    media_type = {"svg": "image/svg+xml", "png": "image/png"}[kind]
    return f"data:{media_type};base64,{base64.b64encode(picture).decode('ascii')}"
