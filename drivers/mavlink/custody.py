"""Custody of the vehicle: one total table for an autopilot over MAVLink, and to whom a reported mode is attributed. No I/O.

Theory of operation.

The vehicle belongs to the autopilot and to the person with the remote control. This program borrows it by asking for a mode, and
loses it when another mode is reported. `Hand` names who has it; every message that may move the vehicle, arm it or change its
mode is sent in one of the states in which it is borrowed, and `setpoint_streamer` knows for each state what is sent.

- NOBODY: no order, nothing is sent. TAKING: the velocity mode is requested. OURS: guidance or a person at the computer steers.
- LANDING, LEAVING, HOLDING, STANDING, TAKING_OFF: the autopilot does a thing by our order, and what it needs goes on being sent.
- PERSON: a person, a failsafe or a refusal ended what we did, or the autopilot holds by itself.
- CUT: a person cut the motors at the computer.

The orders of guidance come in every cycle, so no repeated command is ever an order to take the vehicle back. A person's are: a
take-off, and `ENGAGE` (where setpoints steer what flies, `ENGAGE_ALOFT`), given once for each order to begin or to land.

What holds in every state (`tests/drivers/mavlink/test_custody.py` flies random sequences against toy autopilots):

1. A mode that is reported, that differs from the one before, and that we have not requested since, is a person's or a failsafe's.
   It leads to PERSON from every state in which something of ours runs, at that report, in flight from an order to begin on.
2. A request is used up when it is obeyed. The same mode once more, or the mode from before our request, is a person's choice.
   A mode that was there when the request began is no change and says nothing. A mode of the autopilot's own that we requested
   is in doubt until the request is answered: nothing leaves it before, and after `ANSWERED_S`, or where the request had to be
   repeated, it is a person's. Once the autopilot holds by itself and our stream has ended it stays so until an order: a person's
   hold could not be known from ours.
3. PERSON ends by an order of a person, or when the vehicle stands disarmed. The velocity mode, which a ground station chooses for
   its own "fly here", ends it only where the settings say so (`mode_is_order`).
4. A disarm that we did not order ends everything, as another mode does, and so does an arming that we did not order. Nothing arms
   without a new order to take off.
5. A disarm by force needs guidance's own contact, fresh, in the mode that we requested; any other mode since has led to PERSON.
6. After the cut nothing but the cut is sent. It is repeated until the autopilot reports that it is disarmed. A person's reset
   leaves CUT, and so does who arms it again behind that and flies: both to PERSON, not to what went on before.
7. A person's hold or abort ends a take-off: on deck by a plain disarm, in the air by a hold.
8. A failsafe (`Condition.failsafe`) that comes while the autopilot is in a mode of its own has the vehicle from then on, although
   the mode may be the one that we requested. It also has it by any such mode reported while it is in force. One that leaves us
   the velocity mode is flown with: by setpoints alone, and no mode, arming or take-off is requested until it ends. Only an order
   that a person gives after it came takes the vehicle from it. Once it has ended the vehicle stays where it is until an order.

Attribution. An autopilot reports its mode some times a second, so a report may be older than a request, and a request may be
obeyed late. `ModeRequests` keeps each request until it is obeyed, refused, or `LAPSES_S` old. A report that shows a requested
mode uses up that request and all before it; of several, an older one that is obeyed late is still ours (`LATE`), and is
corrected. Once the autopilot has answered all of them, only the newest counts; one that was accepted and is not shown by the
second HEARTBEAT from then was undone by a person in between. When in doubt the mode is a person's: that costs a landing, and the
other error costs a person the vehicle.

Source: ``_state.py`` of h11 for the form.
"""

import sys
from collections.abc import Mapping
from enum import Enum

from drivers.mavlink.vehicle import Condition
from estimator.contracts.tables import total
from estimator.contracts.time import MonoNs, seconds_between

_SHOWN_BEATS = 2
"""Number of HEARTBEATs after an accepted request until its mode must show; the first may have been under way."""
ANSWERED_S = 1.0
"""Time after the report of a requested mode in which the answer to the request must come, s: ArduPilot reports first."""
LAPSES_S = 3.0
"""Age at which a request that was not obeyed is no longer expected to be, s: that of an autopilot that counts as silent."""


class Authority(Enum):
    """The messages that may leave to move the vehicle. The cut of the motors, which a person orders, is never held back."""

    SETPOINTS = "setpoints"
    MODES = "modes"
    """Requests for the autopilot's own modes alone: its hold takes the place of the velocity mode, and no setpoint leaves."""
    NOTHING = "nothing"


class Hand(Enum):
    """The party that has the vehicle, and what it does with it."""

    NOBODY = "nobody"
    TAKING = "taking"
    OURS = "ours"
    LANDING = "landing"
    STANDING = "standing"
    """It is on the deck: its motors are being stopped."""
    HOLDING = "holding"
    """Guidance is silent, or may not command: the autopilot is in its own hold mode, or on its way there."""
    LEAVING = "leaving"
    """The autopilot returns or flies to another place by itself, and lands there."""
    TAKING_OFF = "taking off"
    PERSON = "a person's"
    """A person or a failsafe has it, or the autopilot refused our mode."""
    CUT = "cut"
    """A person cut the motors."""


class HandEvent(Enum):
    """An order, a report of the autopilot, or the end of a time."""

    STEER = "velocity"
    HOVER = "hover"
    RETURN = "return"
    LEAVE = "elsewhere"
    LAND = "land"
    CONTACT = "contact"
    TAKE_OFF = "takeoff"
    ENGAGE = "begin"
    ENGAGE_ALOFT = "begin aloft"
    """A person's order to begin or to land; in flight guidance's hover before its first velocity is flown, too."""
    CUT = "emergency"
    RESET = "reset"
    IN_MODE = "in mode"
    LATE = "late mode"
    """An older request for a mode is obeyed."""
    OTHER_MODE = "another mode"
    """A mode that was not requested since the last report, or a request that was undone."""
    MODE_SINCE = "mode since order"
    """A change of mode in flight between a person's order to begin and a landing on targets."""
    MODE_ORDER = "mode as order"
    FAILSAFE = "failsafe"
    """A failsafe came while the autopilot is in a mode of its own."""
    FLOWN_AGAIN = "flown again"
    """Somebody armed it after the cut was confirmed, and flies."""
    RESTS = "holds"
    """The autopilot is in its own hold, and our stream has ended."""
    ARMED = "armed"
    """Not by us."""
    DISARMED = "disarmed"
    """Not by us."""
    STOOD = "stands armed"
    DOWN = "stands disarmed"
    LIFTED = "lifts"
    """It lifts although its take-off was ended on deck."""
    ALOFT = "ends aloft"
    """A take-off is over in the air: high enough, out of time, or a person's hold or abort."""
    ON_DECK = "ends on deck"
    STOPPED = "stopped"
    NOT_RENEWED = "unrenewed"
    SILENT = "silence"
    """Guidance is silent."""
    REFUSED = "refused"
    """All requests were used up."""
    UNCLEAR = "unclear"
    """It is not clear which autopilot is meant."""


Row = Mapping[HandEvent, Hand]
Table = Mapping[Hand, Row]

_H, _E = Hand, HandEvent

_CUT: Row = {_E.CUT: _H.CUT}
_TAKEN: Row = {**_CUT, _E.OTHER_MODE: _H.PERSON, _E.FAILSAFE: _H.PERSON, _E.ARMED: _H.PERSON}
_BORROWED: Row = {**_TAKEN, _E.DISARMED: _H.PERSON, _E.TAKE_OFF: _H.TAKING_OFF}
_FLOWN: Row = {**_BORROWED, _E.LAND: _H.LANDING, _E.CONTACT: _H.STANDING}

_ROWS: Table = {
    _H.NOBODY: {
        **_CUT, _E.STEER: _H.TAKING, _E.ENGAGE_ALOFT: _H.TAKING, _E.LAND: _H.LANDING, _E.CONTACT: _H.LANDING,
        _E.TAKE_OFF: _H.TAKING_OFF, _E.MODE_SINCE: _H.PERSON, _E.FAILSAFE: _H.PERSON,
    },
    _H.TAKING: {
        **_FLOWN, _E.IN_MODE: _H.OURS, _E.REFUSED: _H.PERSON, _E.STOOD: _H.NOBODY, _E.UNCLEAR: _H.HOLDING,
    },
    # Armed on deck it stays ours: to the autopilot the end of its setpoints would be a failure.
    _H.OURS: {
        **_FLOWN, _E.RETURN: _H.LEAVING, _E.LEAVE: _H.LEAVING, _E.LATE: _H.TAKING, _E.SILENT: _H.HOLDING,
        _E.UNCLEAR: _H.HOLDING,
    },
    _H.LANDING: {
        **_BORROWED, _E.STEER: _H.TAKING, _E.HOVER: _H.TAKING, _E.CONTACT: _H.STANDING, _E.STOOD: _H.STANDING,
        _E.NOT_RENEWED: _H.TAKING, _E.SILENT: _H.HOLDING, _E.UNCLEAR: _H.HOLDING,
    },
    _H.STANDING: {
        **_TAKEN, _E.TAKE_OFF: _H.TAKING_OFF, _E.STEER: _H.TAKING, _E.HOVER: _H.TAKING, _E.LIFTED: _H.OURS,
        _E.STOPPED: _H.NOBODY,
    },
    _H.HOLDING: {**_FLOWN, _E.STEER: _H.TAKING, _E.STOOD: _H.STANDING, _E.RESTS: _H.PERSON},
    _H.LEAVING: {**_FLOWN, _E.STEER: _H.TAKING, _E.HOVER: _H.TAKING, _E.STOOD: _H.NOBODY},
    _H.TAKING_OFF: {
        **_TAKEN, _E.DISARMED: _H.PERSON, _E.LAND: _H.LANDING, _E.CONTACT: _H.LANDING, _E.ALOFT: _H.OURS,
        _E.ON_DECK: _H.STANDING,
    },
    _H.PERSON: {
        **_CUT, _E.ENGAGE: _H.NOBODY, _E.DOWN: _H.NOBODY, _E.ENGAGE_ALOFT: _H.TAKING, _E.TAKE_OFF: _H.TAKING_OFF,
        _E.MODE_ORDER: _H.OURS,
    },
    _H.CUT: {_E.RESET: _H.PERSON, _E.FLOWN_AGAIN: _H.PERSON},
}  # fmt: skip


def whole(rows: Table) -> Table:
    """Return the table with every pair: an event that a row does not name leaves the vehicle where it is.

    Raises:
        ValueError: a state has no row, a row names an event that leads nowhere else, or a person cannot take the vehicle.
    """
    table = total(rows, HandEvent)
    for hand in Hand:
        if hand not in LEFT_ALONE and table[hand][HandEvent.OTHER_MODE] is not Hand.PERSON:
            raise ValueError(f"{hand}: another mode must be a person's")
        if hand is not Hand.CUT and table[hand][HandEvent.FAILSAFE] is not Hand.PERSON:
            raise ValueError(f"{hand}: a failsafe must have the vehicle")
        if table[hand][HandEvent.CUT] is not Hand.CUT:
            raise ValueError(f"{hand}: the motors must be cut")
    return table


LEFT_ALONE = (Hand.NOBODY, Hand.PERSON, Hand.CUT)
"""States in which nothing of ours moves the vehicle."""
TABLE: Table = whole(_ROWS)

_UNKNOWN = Condition().mode


class ModeRequests:
    """Attributes each mode that the autopilot reports: requested by us, or chosen by others."""

    def __init__(self) -> None:
        self._asked: dict[str, MonoNs] = {}
        """Requests that may still be obeyed, oldest first."""
        self._unanswered: list[tuple[str, MonoNs]] = []
        self._repeated = False
        """True if the newest request repeats one that was not answered."""
        self._unsure_since: MonoNs | None = None
        """Time since when a mode is shown whose request is not answered; None while there is none."""
        self._accepted = ""
        """The newest mode whose request was accepted."""
        self._shown_in = 0
        """HEARTBEATs until the newest request must be shown; 0 while it has not been accepted."""
        self._reported = _UNKNOWN
        self.own = ""
        """The reported mode, if it came by our request or we steer in it."""

    @property
    def pending(self) -> bool:
        """True if a request may still be obeyed."""
        return bool(self._asked)

    @property
    def accepted(self) -> bool:
        """True if the newest request was accepted and is not shown yet: it needs no repetition."""
        return self._shown_in > 0

    @property
    def unsure(self) -> bool:
        """True while it is not clear whether the reported mode is ours."""
        return self._unsure_since is not None

    def ask(self, mode: str, now: MonoNs) -> None:
        """Note that a mode is requested."""
        self._repeated = self._asked.pop(mode, None) is not None
        self._asked[mode] = now
        self._unanswered = [one for one in self._unanswered if seconds_between(one[1], now) <= LAPSES_S] + [(mode, now)]
        self._shown_in, self._accepted = 0, ""

    def on_answer(self, *, accepted: bool) -> None:
        """Take the autopilot's answer to the oldest request that has none; answers come in the order of the requests."""
        mode = self._unanswered.pop(0)[0] if self._unanswered else ""
        if accepted and mode in (self.own, ""):
            self._unsure_since = None
        self._accepted = mode if accepted else ""
        if not accepted and all(mode != other for other, _ in self._unanswered):
            self._asked.pop(mode, None)
        elif accepted and not self._unanswered:
            self._asked = dict(list(self._asked.items())[-1:])
            # One that was reported before its answer is shown already, and the next request waits for no HEARTBEAT.
            self._shown_in = _SHOWN_BEATS if self._asked else 0

    def on_mode(self, mode: str, now: MonoNs, *, ambiguous: bool = False) -> bool | None:
        """Take the mode in a HEARTBEAT; return whether a change is ours, None without a change.

        Args:
            ambiguous: whether the mode is one that a person or a failsafe chooses, too.
        """
        before, self._reported = self._reported, mode
        if mode == before or before == _UNKNOWN:
            return self._unchanged(mode, now)
        self.own, self._unsure_since = "", None
        asked_at, repeated = self._asked.get(mode), ambiguous and self._repeated and mode == next(reversed(self._asked), "")
        if asked_at is None or repeated or seconds_between(asked_at, now) > LAPSES_S:
            return False
        names = list(self._asked)
        self._asked = {name: self._asked[name] for name in names[names.index(mode) + 1 :]}
        self._shown_in, self.own = 0, mode
        self._unsure_since = now if ambiguous and self._accepted != mode else None
        return True

    def _unchanged(self, mode: str, now: MonoNs) -> bool | None:
        """Return False if an accepted request ought to be shown by now, else None."""
        self._asked = {name: at for name, at in self._asked.items() if seconds_between(at, now) <= LAPSES_S}
        if self._unsure_since is not None and seconds_between(self._unsure_since, now) > ANSWERED_S:
            self._unsure_since, self.own = None, ""
            return False
        if self._shown_in:
            self._shown_in = 0 if next(reversed(self._asked), mode) == mode else self._shown_in - 1
            return None if self._shown_in or mode in self._asked or not self._asked else False
        return None

    def forget(self) -> None:
        """Forget all requests, because the vehicle is not ours any more."""
        self._asked.clear()
        self._unanswered.clear()
        self._shown_in, self.own, self._unsure_since = 0, "", None


def markdown() -> str:
    """Return the table as docs/mavlink.md shows it."""
    shared = {**_TAKEN, _E.TAKE_OFF: _H.TAKING_OFF}
    rows = [_row("all of ours", shared)]
    for hand in Hand:
        left = {} if hand in LEFT_ALONE else shared
        rows.append(_row(hand.value, {e: t for e, t in TABLE[hand].items() if t is not hand and e not in left}))
    return "\n".join(("| who has it | next: events |", "|---|---|", *rows)) + "\n"


def _row(name: str, row: Row) -> str:
    ways: dict[Hand, list[str]] = {}
    for event, target in row.items():
        ways.setdefault(target, []).append(event.value)
    cells = "; ".join(f"**{target.value}**: {', '.join(events)}" for target, events in ways.items())
    return f"| {name} | {cells} |"


if __name__ == "__main__":
    sys.stdout.write(markdown())
