"""Advice for each cause that interrupts or ends a landing: one sentence each, for the page and docs/mission.md."""

import tomllib
from collections.abc import Iterator
from pathlib import Path

from companion.base.mission import Reason, ReasonCause, State
from estimator.contracts.estimates import IntegrityAlert, Verdict

_KINDS: dict[str, type[ReasonCause | IntegrityAlert | Verdict]] = {
    "causes": ReasonCause, "alerts": IntegrityAlert, "verdicts": Verdict,
}  # fmt: skip


def _causes() -> Iterator[tuple[str, tuple[ReasonCause | IntegrityAlert | Verdict, ...]]]:
    for row in tomllib.loads(Path(__file__).with_name("advice.toml").read_text(encoding="utf-8"))["advice"]:
        yield row["text"], tuple(kind[name.upper()] for key, kind in _KINDS.items() for name in row.get(key, ()))


CAUSES = dict(_causes())
"""Causes, alerts and verdicts on frames by what a person can do. Those that are no faults are not named."""
_ADVICE = {cause: words for words, causes in CAUSES.items() for cause in causes}
_WAITING = frozenset({State.REFUSED, State.GAVE_UP, State.ABORTED})
_HOVERS = "It hovers until you begin again or land it."


def advice(state: State, reason: Reason) -> str:
    """Return what a person can do after this change of state; empty if there is nothing to do.

    Args:
        state: the state that the machine went to.
        reason: why.
    """
    detail = _ADVICE.get(reason.detail, "") if isinstance(reason.detail, IntegrityAlert | Verdict) else ""
    return " ".join(filter(None, (detail, _ADVICE.get(reason.cause, ""), _HOVERS if state in _WAITING else "")))
