"""Whose turn it is on the processor: threads that keep time are not kept waiting, long sums give way.

No right is needed for any of this; docs/decisions/0008-turns-on-the-processor.md tells what was measured.
"""

from __future__ import annotations

import gc
import os
import sys
from contextlib import suppress
from pathlib import Path

HAND_OVER_S = 0.001
"""After so long a Python thread that computes lets another one of its process have the interpreter."""
NICE = 5
"""Of long sums: a third of the share of what keeps time."""


def keep_time() -> None:
    """For a process whose threads must be on time, before its links are opened."""
    sys.setswitchinterval(HAND_OVER_S)


def keep_out_of_collections() -> None:
    """What this process has loaded by now stays loaded, and garbage collection no longer looks through it.

    Otherwise a full collection stops all threads for long: 0.2 s with all that a mission imports.
    """
    gc.unfreeze()  # of an earlier call: what nobody uses any more goes now
    gc.collect()
    gc.freeze()


def give_way() -> None:
    """This process computes for long: what keeps time goes first. For all its threads, numerical libraries' too.

    It gets a session of its own: where Linux shares processors by session first (autogroup), a nice value counts only
    within one, and a session that mixes long sums with threads that wake often kept all others waiting for seconds.
    """
    with suppress(PermissionError):  # it leads a session already, or a group of its parent's
        os.setsid()
    if os.getsid(0) == os.getpid():  # else those that keep time would give way with it
        with suppress(OSError):  # a kernel without autogroups
            Path("/proc/self/autogroup").write_text(str(NICE))
    for task in Path("/proc/self/task").iterdir():
        with suppress(ProcessLookupError):  # it has ended meanwhile
            thread_id = int(task.name)
            os.setpriority(os.PRIO_PROCESS, thread_id, min(19, os.getpriority(os.PRIO_PROCESS, thread_id) + NICE))
