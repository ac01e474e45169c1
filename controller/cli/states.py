"""``portdock states``: the transition table from the code itself."""

from __future__ import annotations

import enum
from typing import Annotated

import typer

from controller.states import as_dot, as_markdown


class TableFormat(enum.StrEnum):
    """How to print the table."""

    MARKDOWN = "md"
    DOT = "dot"


def states(
    table_format: Annotated[
        TableFormat, typer.Option("--format", help="Markdown or Graphviz dot.")
    ] = TableFormat.MARKDOWN,
) -> None:
    """Print the state machine's transition table."""
    print(as_dot() if table_format is TableFormat.DOT else as_markdown())
