"""The mock scanner's command line: its options, which of them go together, and what is wrong in two lines."""

from __future__ import annotations

import argparse
import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from mcap.exceptions import McapError

from perception.errors import InputError


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError(message, remedy="`portdock mock scanner --help` lists the options.")


def read_options(arguments: list[str] | None) -> argparse.Namespace:
    """Raises InputError for options that are unknown, out of range, or do not go together."""
    options = _parser().parse_args(arguments)
    for wrong, message in _contradictions(options):
        if wrong:
            raise InputError(message, remedy="`portdock mock scanner --help` says what goes together.")
    return options


@contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """What cannot be read here is said as an InputError about ``path``, which should be a ``kind``."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot use {path}: {error.strerror or error}", remedy=f"Give the path of {kind}.") from error
    except (ValueError, KeyError, EOFError, struct.error, McapError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} is not {kind}", remedy=f"Give the path of {kind}.") from error


def _contradictions(options: argparse.Namespace) -> Iterator[tuple[bool, str]]:
    """(whether it is so, what is wrong then)."""
    turning = options.source in ("groove", "world")
    ld19 = options.preset == "ld19"
    scip_in_world = (options.protocol, options.source) == ("scip", "world")
    yield options.trigger_output is not None and options.source != "world", "--trigger-output needs --source world"
    yield options.source == "world" and options.world is None, "--source world needs --world DIR"
    yield ld19 and options.protocol != "framed", "--preset belongs to --protocol framed"
    sees = "sees a room of its own or the world: it takes no recorded sweep"
    yield ld19 and not turning, f"--preset ld19 {sees}"
    yield options.protocol == "scip" and not turning, f"--protocol scip {sees}"
    yield options.coarse and not scip_in_world, "--coarse needs --protocol scip --source world"


def _share(text: str) -> float:
    """A probability."""
    value = float(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is no probability: 0 to 1")
    return value


def _above_zero(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def _not_negative(text: str) -> float:
    value = float(text)
    if not value >= 0.0:
        raise argparse.ArgumentTypeError(f"{text} is below 0")
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="mocks.scanner", description="A mock laser scanner on a pty.")
    add = parser.add_argument
    add("--link", type=Path, help="symlink to make, the device name that clients open; default: one of its own")
    add("--protocol", choices=("framed", "profiler2", "scip"), default="framed", help="framed: see --preset")
    add("--preset", choices=("wide_xz", "ld19"), default="wide_xz", help="framed: which device")
    add("--recording", type=Path, help="a recording (.mcap) whose scanner bytes are played back; overrides --protocol")
    add("--source", default="groove", help="groove, world, or the path of a recorded sweep (.npz)")
    add("--world", type=Path, help="folder of the mock world, for --source world")
    add("--baud", type=_count, help="the device's own baud rate; default: the client's")
    add("--seed", type=int, default=0)
    add("--time-scale", type=_above_zero, default=1.0, help="emulated seconds per second; a world has its own")
    add("--rate-hz", type=_above_zero, help="profiles per emulated second; default 70, less in a fast world")
    add("--exposure-s", type=_not_negative, default=500e-6)
    add("--latency-s", type=_not_negative, default=0.0, help="from the end of exposure to the first bit")
    add("--jitter-s", type=_not_negative, default=0.0, help="further delay of each frame, uniform up to this")
    add("--clock-offset-s", type=float, default=100.0)
    add("--drift-ppm", type=float, default=0.0)
    add("--buffer-bytes", type=_count, default=1 << 20, help="what gateway and client hold before bytes are lost")
    add("--reference-m", type=_not_negative, default=0.10, help="profiler2: distance at which Y is 0")
    add("--address-in-words", action="store_true", help="profiler2: addresses count words, not bytes")
    add("--coarse", action="store_true", help="scip in a world: on the mount of the second, coarse scanner")
    turning = "scip and ld19 in a world: 1 sigma of"
    add("--noise-m", type=_not_negative, default=0.010, help=f"{turning} each range")
    add("--systematic-m", type=_not_negative, default=0.010, help=f"{turning} what one surface adds to all")
    add("--trigger-output", type=int, help="with a world: expose on each rising edge of this output of the arm")
    add("--lost", type=_share, default=0.0, help="fault: probability that a byte is lost")
    add("--doubled", type=_share, default=0.0, help="fault: probability that a byte comes twice")
    add("--flipped", type=_share, default=0.0, help="fault: probability that a bit of a byte flips")
    add("--stall-at-s", type=float, help="fault: silence from this emulated time on")
    add("--stall-s", type=_not_negative, default=float("inf"), help="fault: how long the silence lasts")
    return parser
