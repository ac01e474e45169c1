"""Who keeps time goes before who computes for long, by what the kernel says of each thread."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.processor_time import HAND_OVER_S, NICE

_ASK = """
import gc, json, os, sys, threading
from drivers.processor_time import give_way, keep_out_of_collections, keep_time

def other_thread():
    ready, found = threading.Event(), []
    def live():
        found.append(threading.get_native_id())
        ready.set()
        threading.Event().wait()
    threading.Thread(target=live, daemon=True).start()
    ready.wait()
    return found[0]
"""


def asked(program: str) -> dict:
    """What a program says of itself, in a process of its own: pytest keeps its priority."""
    done = subprocess.run([sys.executable, "-c", _ASK + program], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_every_thread_of_a_long_sum_gives_way() -> None:
    answer = asked("""
other = other_thread()
before = os.getpriority(os.PRIO_PROCESS, 0)
give_way()
print(json.dumps({"before": before, "nice": [os.getpriority(os.PRIO_PROCESS, t) for t in (0, other)]}))
""")
    assert answer["nice"] == [min(19, answer["before"] + NICE)] * 2


def test_a_long_sum_has_a_session_of_its_own_that_gives_way_too() -> None:
    answer = asked("""
give_way()
path = "/proc/self/autogroup"
group = open(path).read().split() if os.path.exists(path) else None
print(json.dumps({"leads": os.getsid(0) == os.getpid(), "group": group}))
""")
    assert answer["leads"]
    if not Path("/proc/self/autogroup").exists():
        pytest.skip("SKIPPED LOUDLY: this kernel has no autogroups")
    assert answer["group"][-2:] == ["nice", str(NICE)]


def test_who_leads_a_session_already_gives_way_all_the_same() -> None:
    answer = asked("""
os.setsid()
give_way()
print(json.dumps(os.getpriority(os.PRIO_PROCESS, 0)))
""")
    assert answer >= NICE


def test_a_thread_that_computes_hands_the_interpreter_over_soon() -> None:
    assert asked("keep_time(); print(json.dumps(sys.getswitchinterval()))") == pytest.approx(HAND_OVER_S)


def test_what_is_loaded_is_kept_out_of_collections() -> None:
    kept, looked_through = asked("""
import numpy
keep_out_of_collections()
print(json.dumps([gc.get_freeze_count(), len(gc.get_objects())]))
""")
    assert kept > 10_000 > looked_through


def test_a_second_call_lets_go_of_what_nobody_uses_any_more() -> None:
    assert asked("""
import weakref
class Knot:
    pass
knot = Knot()
knot.itself = knot
seen = weakref.ref(knot)
keep_out_of_collections()
del knot
keep_out_of_collections()
print(json.dumps(seen() is None))
""")


def test_whoever_keeps_time_in_the_same_session_does_not_give_way_with_it() -> None:
    if not Path("/proc/self/autogroup").exists():
        pytest.skip("SKIPPED LOUDLY: this kernel has no autogroups")
    answer = asked("""
os.setsid()
child = os.fork()
if child == 0:
    os.setpgid(0, 0)  # a group's leader cannot begin a session
    give_way()
    os._exit(0)
os.waitpid(child, 0)
print(json.dumps(open("/proc/self/autogroup").read().split()))
""")
    assert answer[-2:] == ["nice", "0"]
