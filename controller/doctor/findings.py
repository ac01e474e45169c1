"""What a check finds."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Grade(enum.StrEnum):
    """How bad it is."""

    OK = "ok"
    WARN = "warn"
    """It works, but not as well as it could or not for long."""
    FAIL = "fail"
    """A mission cannot start, or must not."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor's report."""

    check: str
    grade: Grade
    text: str
    fix: str = ""
    """What to do; empty when all is well."""


def ok(check: str, text: str) -> Finding:
    """All is well."""
    return Finding(check, Grade.OK, text)


def warn(check: str, text: str, fix: str) -> Finding:
    """It works, but."""
    return Finding(check, Grade.WARN, text, fix)


def fail(check: str, text: str, fix: str) -> Finding:
    """It does not work."""
    return Finding(check, Grade.FAIL, text, fix)
