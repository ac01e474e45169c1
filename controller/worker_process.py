"""How a process that thinks for the controller begins: it gives way to what keeps time, and ends with its parent."""

from __future__ import annotations

import os
import threading
from multiprocessing import parent_process

from drivers.processor_time import give_way


def begin_worker() -> None:
    """First thing in a worker of a pool. A pool's idle worker would wait for ever once its parent is killed."""
    give_way()
    threading.Thread(target=_end_with_parent, name="end-with-parent", daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
