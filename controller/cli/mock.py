"""``portdock mock scanner|arm|charger``: one mock device in the foreground, for any client, until SIGTERM.

Each prints one JSON line that says where it listens. Options are the mock's own: ``portdock mock arm --help``.
"""

from __future__ import annotations

import typer

app = typer.Typer(help="Start one mock device in the foreground; prints where it listens.", no_args_is_help=True)

_PASS_ON = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}


@app.command(context_settings=_PASS_ON)
def scanner(context: typer.Context) -> None:
    """A laser profiler on a pseudo-terminal behind a symlink."""
    _become("scanner", context.args)


@app.command(context_settings=_PASS_ON)
def arm(context: typer.Context) -> None:
    """A UR e-Series controller on a loopback address."""
    _become("ur", context.args)


@app.command(context_settings=_PASS_ON)
def charger(context: typer.Context) -> None:
    """A charger's control unit behind an slcan adapter."""
    _become("charger", context.args)


def _become(name: str, arguments: list[str]) -> None:
    from controller.mock_cell import run_mock  # the world takes a second to import, the mock imports it anyway

    run_mock(name, arguments)
