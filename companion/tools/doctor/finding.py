"""A finding, and the rules that make one: a function, or a row of a table."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from typing import Any

from companion.tools.doctor.snapshot import Snapshot


class Severity(IntEnum):
    """The severity of a finding; the worst comes first."""

    ERROR = 0
    """The setup will not work."""
    WARNING = 1
    """The setup works until a critical moment."""
    ADVICE = 2
    """The setup could work better."""


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """A parameter of the autopilot, and the value that it should have."""

    parameter: str
    value: float


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of the setup, with its fix."""

    rule: str
    """Short name, the same in every release."""
    severity: Severity
    what: str
    """Description of the fault, in one line."""
    fix: str
    """The fix, in one line."""
    changes: tuple[ParameterChange, ...] = ()
    """Parameters that `doctor --fix` sets; none where the fix is not a parameter, or needs a choice first."""


Rule = Callable[[Snapshot], Finding | None]
"""A pure function from a snapshot to a finding; None if the fault is not there or cannot be judged."""


def _finding(severity: Severity, rule: str, what: str, fix: str, changes: Mapping[str, float] | None = None) -> Finding:
    """Return a finding with the parameters that `doctor --fix` sets."""
    return Finding(rule, severity, what, fix, tuple(ParameterChange(name, value) for name, value in (changes or {}).items()))


error, warning, advice = (partial(_finding, severity) for severity in Severity)


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """A rule as data."""

    rule: str
    severity: Severity
    sign: Callable[[Snapshot], object]
    """Sign of the fault, such as a wrong value. Without the fault it is None, False or empty."""
    what: str
    """Description of the fault, in which {0} is the sign."""
    fix: str
    """The fix, in which {0} is the sign, too."""
    changes: Mapping[str, float] | Callable[[Any], Mapping[str, float]] = field(default_factory=dict)
    """Parameters that `doctor --fix` sets, as they are or by the sign."""

    def __call__(self, snapshot: Snapshot) -> Finding | None:
        """Return the finding, or None without a sign of the fault."""
        sign = self.sign(snapshot)
        if not sign:
            return None
        changes = self.changes(sign) if callable(self.changes) else self.changes
        return _finding(self.severity, self.rule, self.what.format(sign), self.fix.format(sign), changes)
