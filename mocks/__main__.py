"""``python -m mocks NAME [options]``: one mock device that ends with the process that started it, however that ends.

A dry run that is killed must leave no emulated robot behind: the kernel is asked for SIGTERM on the parent's death
(prctl PR_SET_PDEATHSIG). Started by hand, ``python -m mocks.NAME`` has no such tie.
"""

from __future__ import annotations

import ctypes
import os
import runpy
import signal
import sys

PR_SET_PDEATHSIG = 1


def main() -> None:
    """Tie this process to its parent, then become the mock."""
    parent = os.getppid()
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        return  # the parent died before the tie was made
    name = sys.argv.pop(1)
    runpy.run_module(f"mocks.{name}", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
