"""The CAN contract as a page for a charger's supplier: what the DBC holds, in the words of ``config/dbc/can.md.j2``."""

from __future__ import annotations

import importlib.resources
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools
import jinja2

from perception.errors import InputError

_LONGEST_FRAME_BITS = 160
"""An extended frame of 8 bytes with every possible stuff bit."""


@dataclass(frozen=True, slots=True)
class SignalRow:
    """One line of a message's table."""

    name: str
    bits: str
    type: str
    scale: str
    unit: str
    range: str
    meaning: str


@dataclass(frozen=True, slots=True)
class MessageRow:
    """One message with its signals."""

    name: str
    identifier: str
    sender: str
    cycle_ms: int
    send_type: str
    degraded: str
    lost: str
    data_id: str
    length: int
    comment: str
    signals: list[SignalRow]


def describe(dbc: Path | None = None) -> str:
    """The contract as Markdown. Raises InputError for a file that cannot be read as a DBC."""
    folder = importlib.resources.files("config") / "dbc"
    path = dbc or Path(str(folder / "portdock.dbc"))
    database, fd = _load(path), _load(Path(str(folder / "portdock_fd.dbc")))
    rows = [_message(message) for message in database.messages]
    per_second = sum(1000 // row.cycle_ms for row in rows if row.cycle_ms)
    bit_rate = int(_attribute(database, "Baudrate") or 250_000)
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, autoescape=False, keep_trailing_newline=True)
    template = environment.from_string((folder / "can.md.j2").read_text(encoding="utf-8"))
    return template.render(
        file=path.name,
        bit_rate=bit_rate,
        frames_per_second=per_second,
        load_percent=100.0 * per_second * _LONGEST_FRAME_BITS / bit_rate,
        is_fd=any(message.is_fd for message in database.messages),
        messages=rows,
        fd_messages=[_message(message) for message in fd.messages],
        fd_pose=_message(fd.get_message_by_name("RC_DockPose")),
        fd_bit_rate=int(_attribute(fd, "Baudrate")),
        fd_data_rate=int(_attribute(fd, "DataBaudrate")),
    )


def _load(path: Path) -> Any:
    try:
        return cantools.database.load_file(path, database_format="dbc", strict=True)
    except FileNotFoundError:
        raise InputError(f"there is no DBC at {path}") from None
    except Exception as error:  # cantools lets its parser's own exceptions through
        raise InputError(f"{path} is not a usable DBC: {' '.join(str(error).split())}") from error


def _message(message: Any) -> MessageRow:
    data_id = _attribute(message, "E2EDataID")
    return MessageRow(
        name=message.name,
        identifier=f"0x{message.frame_id:08X}" if message.is_extended_frame else f"0x{message.frame_id:03X}",
        sender=", ".join(message.senders),
        cycle_ms=message.cycle_time or 0,
        send_type=message.send_type or "",
        degraded=_milliseconds(_attribute(message, "TimeoutDegradedMs")),
        lost=_milliseconds(_attribute(message, "TimeoutLostMs")),
        data_id="" if data_id is None else f"0x{data_id:04X}",
        length=message.length,
        comment=message.comment or "",
        signals=[_signal(signal) for signal in message.signals],
    )


def _signal(signal: Any) -> SignalRow:
    conversion = signal.conversion
    scale = f"{conversion.scale:g}" + (f", offset {conversion.offset:g}" if conversion.offset else "")
    return SignalRow(
        name=signal.name,
        bits=f"{signal.start}\\|{signal.length}",
        type="signed" if signal.is_signed else "unsigned",
        scale=scale if scale != "1" else "",
        unit=signal.unit or "",
        range=f"{signal.minimum:.10g} to {signal.maximum:.10g}",
        meaning=_meaning(signal),
    )


def _meaning(signal: Any) -> str:
    choices = ", ".join(f"{number} {name}" for number, name in sorted((signal.choices or {}).items()))
    comment = signal.comment or _HEADER.get(signal.name, "")
    return f"{comment} {choices}.".strip() if choices else comment


_HEADER = {"CRC8": "Checksum.", "CRC16": "Checksum.", "Counter": "Alive counter."}


def _attribute(owner: Any, name: str) -> Any:
    attributes = owner.dbc.attributes if owner.dbc else {}
    return attributes[name].value if name in attributes else None


def _milliseconds(value: Any) -> str:
    return f"{value} ms" if value else ""
