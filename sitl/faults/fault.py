"""A fault of a simulated flight: when it begins, and how long it lasts.

A fault has a `kind`, exactly one beginning (`at_s`, `below_height_m`, `above_height_m`, `in_phase` or `per_minute`) and a
duration `for_s`; without one it lasts for the rest of the flight. The seed may put the beginning off (`drawn_within_s`).
"""

from typing import Annotated

from msgspec import Struct

from companion.base.mission import State
from estimator.contracts.keys import number, text

PHASES = tuple(state.value for state in State)
"""The phases of guidance that a fault may begin in."""
_BEGINNINGS = ("at_s", "below_height_m", "above_height_m", "in_phase", "per_minute")


class Fault(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"):
    """Something that goes wrong, and when."""

    at_s: Annotated[float, number("begins this long after the start of the flight", "s", 0.0, 36000.0)] | None = None
    below_height_m: (
        Annotated[float, number("begins when the vehicle first comes down to this height over the deck", "m", 0.05, 60.0)] | None
    ) = None
    above_height_m: (
        Annotated[float, number("begins when the vehicle is first higher than this over the deck", "m", 0.05, 60.0)] | None
    ) = None
    in_phase: (
        Annotated[str, text(f"begins when guidance first enters this phase: {', '.join(PHASES)}; in virtual time only", 40)]
        | None
    ) = None
    per_minute: (
        Annotated[float, number("average rate of a recurring fault, at times drawn by the seed", "per min", 0.01, 6000.0)] | None
    ) = None
    drawn_within_s: (
        Annotated[float, number("begins later by a time that the seed draws, up to this", "s", 0.001, 60.0)] | None
    ) = None
    for_s: Annotated[float, number("duration; without it, the rest of the flight", "s", 0.001, 36000.0)] | None = None

    def __post_init__(self) -> None:
        given = [name for name in _BEGINNINGS if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "none of them"
            raise ValueError(f"exactly one of {', '.join(_BEGINNINGS)} must say when it begins, found {found}")
        if self.in_phase is not None and self.in_phase not in PHASES:
            raise ValueError(f"in_phase must be one of {', '.join(PHASES)}, found {self.in_phase!r}")
        if self.per_minute is not None and self.for_s is None:
            raise ValueError("for_s must say how long the fault lasts each time")
        if self.per_minute is not None and self.drawn_within_s is not None:
            raise ValueError("drawn_within_s does not go with per_minute, whose times are drawn already")
        self.check()

    def check(self) -> None:
        """Refuse values that contradict each other; raises ValueError."""

    @property
    def kind(self) -> str:
        """The word that names this kind of fault in a scenario file."""
        return str(self.__struct_config__.tag)

    @property
    def words(self) -> str:
        """The fault in words, for people."""
        return self.kind
