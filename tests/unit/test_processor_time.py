"""Who keeps time goes before who computes for long, by what the kernel says of each thread."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from drivers.processor_time import NICE, SHORT_TURN_NS

_ASK = """
import ctypes, json, os, platform, struct, sys, threading
from drivers.processor_time import give_way, take_short_turns, take_usual_turns

def turn_ns(thread_id=0):
    room = ctypes.create_string_buffer(48)
    number = {"x86_64": 315, "aarch64": 275}[platform.machine()]
    if ctypes.CDLL(None).syscall(number, thread_id, room, 48, 0) != 0:
        return 0
    return struct.unpack_from("=Q", room, 24)[0]

def other_thread():
    ready, done = threading.Event(), threading.Event()
    found = []
    def live():
        found.append(threading.get_native_id())
        ready.set()
        done.wait()
    threading.Thread(target=live, daemon=True).start()
    ready.wait()
    return found[0]
"""


def asked(program: str) -> dict:
    """What a program says of itself, in a process of its own: pytest's keeps its turns."""
    done = subprocess.run([sys.executable, "-c", _ASK + program], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def needs_turns(answer: dict) -> None:
    if not answer["granted"]:
        pytest.skip("SKIPPED LOUDLY: this kernel or machine does not know turns")


def test_short_turns_pass_to_what_is_started_later() -> None:
    answer = asked("""
before = turn_ns()
granted = take_short_turns()
print(json.dumps({"granted": granted, "before": before, "own": turn_ns(), "thread": turn_ns(other_thread()),
                  "switch": sys.getswitchinterval()}))
""")
    assert answer["switch"] == pytest.approx(0.001)
    needs_turns(answer)
    if answer["before"] == 0:
        pytest.skip("SKIPPED LOUDLY: this kernel does not tell turns")
    assert answer["own"] == answer["thread"] == SHORT_TURN_NS < answer["before"]


def test_usual_turns_are_for_the_calling_thread_only() -> None:
    answer = asked("""
before = turn_ns()
granted = take_short_turns()
other = other_thread()
take_usual_turns()
print(json.dumps({"granted": granted, "before": before, "own": turn_ns(), "thread": turn_ns(other)}))
""")
    needs_turns(answer)
    if answer["before"] == 0:
        pytest.skip("SKIPPED LOUDLY: this kernel does not tell turns")
    assert answer["own"] == answer["before"]
    assert answer["thread"] == SHORT_TURN_NS


def test_every_thread_of_a_long_sum_gives_way() -> None:
    answer = asked("""
take_short_turns()
other = other_thread()
before = os.getpriority(os.PRIO_PROCESS, 0)
give_way()
print(json.dumps({"before": before, "nice": [os.getpriority(os.PRIO_PROCESS, t) for t in (0, other)],
                  "turns": [turn_ns(t) for t in (0, other)]}))
""")
    assert answer["nice"] == [min(19, answer["before"] + NICE)] * 2
    assert SHORT_TURN_NS not in answer["turns"]


def test_a_policy_that_an_operator_has_chosen_stays() -> None:
    answer = asked("""
os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
granted = take_short_turns()
print(json.dumps({"granted": granted, "policy": os.sched_getscheduler(0) == os.SCHED_BATCH}))
""")
    assert answer == {"granted": False, "policy": True}
