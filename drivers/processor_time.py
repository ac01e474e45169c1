"""Whose turn it is on a processor: threads that keep time ask for short turns and so get them soon, long sums give way.

Linux lets a thread in at once when the one that runs has had its turn, or has a longer turn than the one that comes.
A turn is about 3 ms by itself: with three links, a tick and perception on two processors that adds up to the lateness
that a stop can least afford. No right is needed for any of this, and where a kernel (before 6.12) or a machine does
not know turns, nothing is different.
"""

from __future__ import annotations

import ctypes
import gc
import logging
import os
import platform
import struct
import sys
from pathlib import Path

log = logging.getLogger(__name__)

SHORT_TURN_NS = 100_000
"""The shortest that the kernel grants."""
HAND_OVER_S = 0.001
"""After so long a Python thread that computes lets another one of its process have the interpreter."""
NICE = 10
"""What long sums add to their nice value: a tenth of the share of a thread that keeps time."""

_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
"""The system call's number; the C library has had a name for it only since 2.41."""
_ATTRIBUTES = struct.Struct("=IIQiIQQQ")
"""sched_attr, first version: size, policy, flags, nice, priority, runtime, deadline, period; see sched_setattr(2)."""


def take_short_turns() -> bool:
    """This thread keeps time, and what it starts from now on. Returns whether the machine grants turns at all."""
    sys.setswitchinterval(HAND_OVER_S)
    return _ask_for_turns(SHORT_TURN_NS, 0)


def take_usual_turns() -> bool:
    """This thread may run for as long as any other before the next one gets in."""
    return _ask_for_turns(0, 0)


def keep_out_of_collections() -> None:
    """What this process has loaded by now stays loaded, and garbage collection no longer looks through it.

    Otherwise a full collection stops all threads for long: 0.2 s with all that a mission imports.
    """
    gc.collect()
    gc.freeze()


def give_way() -> None:
    """This process computes for long: what keeps time goes first. For all its threads, numerical libraries' too."""
    for task in Path("/proc/self/task").iterdir():
        try:
            thread_id = int(task.name)
            os.setpriority(os.PRIO_PROCESS, thread_id, os.getpriority(os.PRIO_PROCESS, thread_id) + NICE)
            _ask_for_turns(0, thread_id)
        except ProcessLookupError:
            continue  # it has ended meanwhile


def _ask_for_turns(length_ns: int, thread_id: int) -> bool:
    """Turns of this length for one thread, 0 for the calling one; a length of 0 is the kernel's own."""
    number = _SCHED_SETATTR.get(platform.machine())
    if number is None or os.sched_getscheduler(thread_id) != os.SCHED_OTHER:
        return False  # an operator who gave it real-time priority knows better
    nice = os.getpriority(os.PRIO_PROCESS, thread_id)
    attributes = _ATTRIBUTES.pack(_ATTRIBUTES.size, os.SCHED_OTHER, 0, nice, 0, length_ns, 0, 0)
    library = ctypes.CDLL(None, use_errno=True)
    if library.syscall(number, thread_id, attributes, 0) == 0:
        return True
    log.debug("turns of %d ns are not granted: %s", length_ns, os.strerror(ctypes.get_errno()))
    return False
