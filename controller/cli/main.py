"""``portdock``: argument handling only. Every error ends as two lines, cause and remedy, and a documented exit code."""

from __future__ import annotations

import logging
import sys
from typing import Annotated

import typer

from controller.cli import (
    calibrate,
    campaign,
    charger,
    config,
    convert,
    doctor,
    dry_run,
    evaluate,
    jobs,
    locate,
    merge,
    mock,
    model,
    recording,
    replay,
    scan,
    scanner,
    service,
    soak,
    states,
    teach,
)
from controller.config_section import ConfigError
from controller.faults import MissionFault
from drivers.base import DriverError
from perception.errors import InputError, PortdockError

EXIT_DONE = 0
EXIT_OTHERWISE = 1
EXIT_USAGE = 2
EXIT_LINK = 3
EXIT_GATE = 4
EXIT_BUSY = 5

app = typer.Typer(
    name="portdock",
    help="Locates an electric vehicle's charging port and docks the plug that a UR arm carries.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    epilog="Exit codes: 0 done, 1 ended otherwise than asked, 2 usage or input, 3 a link could not be opened, "
    "4 the safety gate refused, 5 the daemon is busy with something else. portdock is not a safety function.",
)
app.command("dry-run")(dry_run.dry_run)
app.command("run")(service.run)
for command in (jobs.dock, jobs.undock, jobs.stop, jobs.abort, jobs.reset, jobs.status):
    app.command()(command)
app.command("soak")(soak.soak)
app.command("locate")(locate.locate)
app.command("teach")(teach.teach)
app.command("merge")(merge.merge)
app.command("states")(states.states)
app.command("replay")(replay.replay)
app.command("campaign")(campaign.campaign)
app.command("scan")(scan.scan)
app.command("convert")(convert.convert)
app.command("doctor")(doctor.doctor)
app.add_typer(config.app, name="config")
app.add_typer(mock.app, name="mock")
app.add_typer(model.app, name="model")
app.add_typer(recording.app, name="recording")
app.add_typer(charger.app, name="charger")
app.add_typer(scanner.app, name="scanner")
app.add_typer(calibrate.app, name="calibrate")
app.add_typer(evaluate.app, name="evaluate")


@app.callback()
def _options(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log what happens to stderr.")] = False,
) -> None:
    level = logging.INFO if verbose else logging.ERROR
    logging.basicConfig(level=level, format="%(asctime)s %(name)s %(message)s", stream=sys.stderr)


def main() -> None:
    """Entry point of the ``portdock`` command."""
    try:
        app()
    except PortdockError as error:
        sys.stderr.write(f"portdock: {error.cause}\n  remedy: {error.remedy}\n")
        raise SystemExit(exit_code(error)) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    except BrokenPipeError:
        raise SystemExit(EXIT_OTHERWISE) from None
    except OSError as error:  # a path that was typed: commands name the likely ones themselves
        if error.filename is None:
            raise
        cause, remedy = f"{error.filename}: {error.strerror}", "Check the path, its permissions and the free space."
        sys.stderr.write(f"portdock: {cause}\n  remedy: {remedy}\n")
        raise SystemExit(EXIT_USAGE) from None


def exit_code(error: PortdockError) -> int:
    """The documented exit code of an error."""
    if isinstance(error, InputError | ConfigError):
        return EXIT_USAGE
    if isinstance(error, DriverError):
        return EXIT_LINK
    if isinstance(error, MissionFault) and error.fault.code.value == "gate-refused":
        return EXIT_GATE
    return EXIT_OTHERWISE


if __name__ == "__main__":
    main()
