"""Faults of the line while the mock runs: one JSON object for each line of standard input, as ``{"flipped": 0.01}``.

Keys are the fields of ``FaultRates``; what is not named stays as it is. The input's end changes nothing.
"""

from __future__ import annotations

import json
import logging
import threading
from dataclasses import replace
from typing import TextIO

from mocks.scanner.wire_faults import FaultRates, WireFaults

logger = logging.getLogger(__name__)


def changed(rates: FaultRates, line: str) -> FaultRates:
    """The rates after one control line. Raises ValueError or TypeError for a line that is none."""
    values = json.loads(line)
    if not isinstance(values, dict):
        raise ValueError("a control line is one JSON object")
    return replace(rates, **values)


def listen(faults: WireFaults, lines: TextIO) -> None:
    """Carry out lines as they come, in a thread of its own that ends with the input or the process."""
    threading.Thread(target=_obey, args=(faults, lines), name="controls", daemon=True).start()


def _obey(faults: WireFaults, lines: TextIO) -> None:
    for line in lines:
        try:
            faults.rates = changed(faults.rates, line)
        except (ValueError, TypeError) as error:
            logger.warning("control line ignored: %s", error)
