"""Grade a flight: what its outcome is worth by what the scenario expects, and what the referee found."""

from collections.abc import Sequence
from enum import Enum
from typing import Literal, NamedTuple

from companion.base.mission import CONTACT_INTENDED, REFUSALS, FlightOutcome
from companion.guidance.operator.arbiter import BY_HAND, LANDING_FOR_PERSON
from sitl.world.truth import Touchdown

Expected = Literal["land", "refuse", "go_around", "hold", "either"]
"""The outcome that a scenario expects: it lands on the pad, refuses to, goes around and then lands, holds for the operator, or
either lands or refuses."""
_INTENDED = frozenset({*(state.value for state in CONTACT_INTENDED), BY_HAND, LANDING_FOR_PERSON})


def outside_commit(contacts: Sequence[Touchdown]) -> int:
    """Return the number of contacts with turning motors in a phase of guidance that intends none, while no person commands."""
    return sum(contact.motors and contact.guidance_phase not in _INTENDED for contact in contacts)


class Grade(Enum):
    """The grade of a flight."""

    ON_PAD = "on pad"
    REFUSED_RIGHTLY = "refused rightly"
    FAILED = "failed"


def on_pad_m(contacts: Sequence[Touchdown]) -> float | None:
    """Return the distance of the newest contact from the pad's centre, or None if it was not on the pad."""
    return contacts[-1].lateral_m if contacts and contacts[-1].on_pad else None


class AtEnd(NamedTuple):
    """The situation in which a flight ended."""

    left_alone: bool = False
    """There was no service or no link, so that nothing could be decided."""
    asks: bool = False
    """It hovered and waited for the operator's decision about another pad, which nobody makes in a simulation."""
    held: bool = False
    """A person held it, flew it, or had ended the landing."""
    theirs: str = ""
    """The newest act of a person that stands; empty without one."""
    go_arounds: int = 0
    """Number of go-arounds."""
    refusal: tuple[str, str] = ("", "")
    """Words that the reason of a refusal must hold, and the reason that it gave."""
    put_down: bool = False
    """It stands because it landed by itself while nothing reached it, and the scenario allows that."""


def grade(
    outcome: FlightOutcome | None,
    landed_m: float | None,
    unsafe: Sequence[str],
    expect: Expected,
    at_end: AtEnd | None = None,
) -> tuple[Grade, str]:
    """Return the grade of a flight and the reason for it.

    Args:
        outcome: the pilot's outcome; None if the time ran out.
        landed_m: the result of `on_pad_m`.
        unsafe: the result of `dangers`.
        expect: the outcome that the scenario expects.
        at_end: the situation in which it ended.
    """
    end = at_end or AtEnd()
    if unsafe:
        return Grade.FAILED, "; ".join(unsafe)
    if expect == "either" and end.theirs:
        return Grade.REFUSED_RIGHTLY, f"left to the person who ordered {end.theirs}"
    if expect == "hold":
        if end.held:
            return Grade.REFUSED_RIGHTLY, "held for the operator"
        return Grade.FAILED, f"did not hold for the operator: {'time ran out' if outcome is None else outcome.value}"
    if outcome is FlightOutcome.LANDED and landed_m is not None:
        if expect == "go_around" and not end.go_arounds:
            return Grade.FAILED, f"landed {100 * landed_m:.1f} cm from the centre without going around first"
        return Grade.ON_PAD, f"{100 * landed_m:.1f} cm from the centre"
    if end.put_down and outcome is FlightOutcome.LANDED_BY_OTHERS:
        return Grade.REFUSED_RIGHTLY, "landed by itself while nothing reached it"
    if outcome in REFUSALS or (outcome is None and (end.left_alone or end.asks)):
        output = "hovered without a service" if end.left_alone else "hovered and waited for the operator"
        if outcome is not None:
            output = outcome.value
        if expect in ("land", "go_around"):
            return Grade.FAILED, f"{output}, though nothing was wrong enough for that"
        if outcome in REFUSALS and end.refusal[0].lower() not in end.refusal[1].lower():
            return Grade.FAILED, f"{output} for another reason than {end.refusal[0]!r}: {end.refusal[1]}"
        return Grade.REFUSED_RIGHTLY, output
    return Grade.FAILED, "time ran out: it neither landed nor gave up" if outcome is None else outcome.value
