"""ANOTHER_PAD: climb, then wait for the operator's decision about a pad in another place.

Where settings decide it (`guidance.tries.another_pad`), the landing goes on by itself, once: the drone is at the safe height and
one other pad alone has been in unbroken sight for long enough. Otherwise a person begins again, or the drone gives up.
"""

from collections.abc import Iterator

from msgspec import Struct, structs

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.mission.out_of_reach import NEAR_SAFE_M
from companion.guidance.mission.phase import LANDING, Phase
from companion.guidance.mission.progress import GuidanceCycle, Progress, unfit
from companion.guidance.mission.rules import EventWithReason
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.time import MonoNs, seconds_between


class OtherPad(Struct, frozen=True):
    """The pad in question."""

    track: int | None = None
    seen_since: MonoNs | None = None
    """Time since which it alone has been in unbroken sight."""


def _note(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    estimate, pad = s.estimate, p.kept if isinstance(p.kept, OtherPad) else OtherPad()
    if estimate is None or unfit(estimate, s.at, o.stale_after_s) is not None:
        return structs.replace(p, kept=structs.replace(pad, seen_since=None))
    steady = pad.seen_since if estimate.track == pad.track else None
    return structs.replace(p, kept=OtherPad(estimate.track, s.at if steady is None else steady))


def _events(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    waited_s = p.in_state_s(s.at)
    if waited_s > o.tries.operator_wait_s:
        yield Event.TIMEOUT, Reason(ReasonCause.NOBODY_DECIDED, waited_s, o.tries.operator_wait_s)
    since = p.kept.seen_since if isinstance(p.kept, OtherPad) else None
    if o.tries.another_pad != "automatic" or p.questions > 1 or since is None or s.estimate is None:
        return
    safe_m = o.tries.safe_height_m - NEAR_SAFE_M
    if min(p.entered_height_m, s.estimate.height_m) >= safe_m and seconds_between(since, s.at) >= o.tries.another_pad_s:
        yield Event.BEGIN, Reason(ReasonCause.AUTOMATIC)


PHASES = {
    State.ANOTHER_PAD: Phase(
        "Climbing, then waiting for the operator's decision about a pad in another place.",
        {**LANDING, Event.BEGIN: State.SEARCH, Event.STAY: State.SEARCH, Event.TIMEOUT: State.GAVE_UP},
        _events,
        note=_note,
    ),
}
