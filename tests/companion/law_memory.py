"""The law's memory as the core holds it, and as plain values."""

from typing import Any, NamedTuple

from msgspec import Struct, structs

from companion.guidance.law.follow_deck import FollowDeckMemory, TuningChoice
from estimator.contracts.time import MonoNs
from estimator.core.library import CORE
from tests.companion.law_axis import Observed, TiltAxis


class DeckTurn(NamedTuple):
    """The observer of the deck's turn: the heading against the arrow, and the deck's rate."""

    yaw_rad: float
    rate_rad_s: float


class OwnPart(NamedTuple):
    """The tilt of one axis that the vehicle adds by itself, the tilt that its response explains, and that one's rate."""

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


def _axis(axis: Any, n: int) -> TiltAxis:
    return TiltAxis(Observed(axis.p, axis.w, axis.d, axis.b), axis.lean, axis.rate, axis.lag, tuple(axis.under_way)[:n])


def plain(memory: FollowDeckMemory, n: int, *, over_ground: bool = False) -> LawMemory:
    """Return a memory as plain values; `n` commands are remembered."""
    core = memory.core
    one, two = core.axes
    return LawMemory(
        memory.at,
        (_axis(one, n), _axis(two, n)) if core.begun else None,
        core.pushed_down_m_s2,
        tuple(core.climbs)[:n],
        memory.tuning,
        memory.tuning_before,
        memory.share,
        tuple(OwnPart(part.own, part.lean, part.rate) for part in core.own) if core.begun and over_ground else None,  # type: ignore[arg-type]
        DeckTurn(core.turn_yaw_rad, core.turn_rate_rad_s) if core.has_turn else None,
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
    core = CORE.ffi.new("dl_law_memory *", values)
    return FollowDeckMemory(core, memory.at, memory.tuning, memory.tuning_before, memory.share)
