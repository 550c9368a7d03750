"""A trap that was found, and the shape of a rule that finds one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from companion.doctor.picture import Picture


class Gravity(IntEnum):
    """How bad it is; the worst first."""

    ERROR = 0
    """It will not work."""
    WARNING = 1
    """It works until it matters."""
    ADVICE = 2
    """It could work better."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One trap."""

    rule: str
    """Short name, the same in every release."""
    gravity: Gravity
    what: str
    """What is wrong, in one line."""
    cure: str
    """What to do, in one line."""


Rule = Callable[[Picture], Finding | None]
"""A pure function; None where the trap is not there or cannot be judged."""


def error(rule: str, what: str, cure: str) -> Finding:
    return Finding(rule, Gravity.ERROR, what, cure)


def warning(rule: str, what: str, cure: str) -> Finding:
    return Finding(rule, Gravity.WARNING, what, cure)


def advice(rule: str, what: str, cure: str) -> Finding:
    return Finding(rule, Gravity.ADVICE, what, cure)
