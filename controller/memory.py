"""What the C library keeps of memory that was freed: a process that runs for months gives back what a mission needed.

glibc makes an arena for each thread and raises the size up to which it keeps blocks to that of the largest freed so
far; scans of several megabytes that pass from thread to thread leave each arena as large as its largest moment was
(mallopt(3), malloc_trim(3)). Without glibc nothing is done.
"""

from __future__ import annotations

import ctypes
import logging

log = logging.getLogger(__name__)

ARENAS = 2
MAPPED_BYTES = 1 << 20
"""Larger blocks come from the kernel one by one and go back to it when they are freed."""
_M_MMAP_THRESHOLD, _M_ARENA_MAX = -3, -8


def keep_little() -> None:
    """For the rest of this process. Best before its threads start."""
    try:
        library = ctypes.CDLL(None)
        done = [library.mallopt(_M_ARENA_MAX, ARENAS), library.mallopt(_M_MMAP_THRESHOLD, MAPPED_BYTES)]
    except (OSError, AttributeError):
        return
    if not all(done):
        log.info("this C library takes no advice on memory")


def give_back() -> None:
    """Return what is free to the kernel: some milliseconds, in which other threads go on."""
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (OSError, AttributeError):
        return
