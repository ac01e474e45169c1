"""A long-lived process gives back what its threads have freed."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import sys, threading
from controller.memory import give_back, keep_little
from controller.soak.figures import Footprint

if sys.argv[1] == "careful":
    keep_little()

def mission(kept):
    blocks = [bytearray(60_000) for _ in range(600)]  # 36 MB
    kept.append(bytearray(60_000))  # what holds the arena's end
    del blocks

kept, before = [], Footprint.now().rss_mb
for _ in range(6):
    threads = [threading.Thread(target=mission, args=(kept,)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
if sys.argv[1] == "careful":
    give_back()
print(Footprint.now().rss_mb - before)
"""


def grown_mb(how: str) -> float:
    done = subprocess.run([sys.executable, "-c", PROGRAM, how], capture_output=True, text=True, check=True, timeout=60)
    return float(done.stdout)


def test_what_threads_have_freed_goes_back_to_the_kernel() -> None:
    careful, careless = grown_mb("careful"), grown_mb("careless")
    assert careful < 8.0, f"{careful} MB stayed, {careless} MB without care"
    assert careless > 2.0 * careful, "without care as little stays: the module is not needed"
