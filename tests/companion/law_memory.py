"""The law's memory as the core holds it, and as plain values."""

from __future__ import annotations

from typing import Any, NamedTuple

from msgspec import Struct, structs

from companion.guidance.follow_deck import FollowDeckMemory, TuningChoice
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs
from estimator.core.interface import places_of, size_of
from estimator.core.library import address
from estimator.core.records import record
from tests.companion.law_axis import Observed, TiltAxis


class DeckTurn(NamedTuple):
    """The observer of the deck's turn: the heading against the arrow, and the deck's rate."""

    yaw_rad: float
    rate_rad_s: float


class OwnPart(NamedTuple):
    """The lean of one axis that the vehicle adds by itself, the lean that its response explains, and that one's rate."""

    own: float
    lean: float
    rate: float


class LawMemory(Struct, frozen=True):
    """The memory of `FollowDeck`. Its axes are north and east by the filter's heading."""

    at: MonoNs | None
    axes: tuple[TiltAxis, TiltAxis] | None
    pushed_down_m_s2: float
    climbs: tuple[float, ...]
    tuning: TuningChoice
    tuning_before: TuningChoice
    share: float
    own: tuple[OwnPart, OwnPart] | None
    turn: DeckTurn | None


_MEMORY, _AXIS = places_of("law_memory"), places_of("law_axis")


def _axis(words: F64, n: int) -> TiltAxis:
    p, w, d, b, lean, rate, lag = words[:7].tolist()
    return TiltAxis(Observed(p, w, d, b), lean, rate, lag, tuple(words[_AXIS["under_way"]][:n].tolist()))


def plain(memory: FollowDeckMemory, n: int, *, over_ground: bool = False) -> LawMemory:
    """Return a memory as plain values; `n` commands are remembered."""
    words = memory.words
    begun, has_turn = words.view("int64")[:2].tolist()
    one, two = words[_MEMORY["axes"]].reshape(2, -1)
    mine, other = words[_MEMORY["own"]].reshape(2, -1).tolist()
    turn = DeckTurn(words[_MEMORY["turn_yaw_rad"]].item(), words[_MEMORY["turn_rate_rad_s"]].item())
    return LawMemory(
        memory.at,
        (_axis(one, n), _axis(two, n)) if begun else None,
        words[_MEMORY["pushed_down_m_s2"]].item(),
        tuple(words[_MEMORY["climbs"]][:n].tolist()),
        memory.tuning,
        memory.tuning_before,
        memory.share,
        (OwnPart(*mine), OwnPart(*other)) if begun and over_ground else None,
        turn if has_turn else None,
    )


def packed(memory: LawMemory) -> FollowDeckMemory:
    """Return a memory as the core holds it."""
    values: dict[str, Any] = {
        "begun": memory.axes is not None,
        "has_turn": memory.turn is not None,
        "pushed_down_m_s2": memory.pushed_down_m_s2,
        "climbs": memory.climbs,
        "axes": [
            {**structs.asdict(axis.seen), "lean": axis.lean, "rate": axis.rate, "lag": axis.lag, "under_way": axis.under_way}
            for axis in memory.axes or ()
        ],
        "own": [part._asdict() for part in memory.own or ()],
    }
    if memory.turn is not None:
        values |= {"turn_yaw_rad": memory.turn.yaw_rad, "turn_rate_rad_s": memory.turn.rate_rad_s}
    words = record("law_memory", values)
    assert words.size == size_of("law_memory")
    return FollowDeckMemory(words, address(words), memory.at, memory.tuning, memory.tuning_before, memory.share)
