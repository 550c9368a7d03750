"""The precedence of people's orders as a table: which order is accepted in which situation, and from whom.

`python -m companion.guidance.operator.precedence` prints the table of docs/operator.md.
"""

import sys
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType

from companion.base.orders import OperatorOrder

CROSSING_S = 0.5
"""An order that ranks lower and arrives within this time after another sender's was given without knowledge of it, s."""

IDLE_HAND_S = 3.0
"""The time with centred sticks after which another person may take the hand: its holder may be gone, s."""


class ControlSituation(Enum):
    """The state of the vehicle and of its control, as far as orders depend on it."""

    UNHEARD = "silent"
    """The vehicle has not reported its status lately."""
    GROUND = "on ground"
    DONE = "landed"
    """The vehicle is on the ground, and the flight before has ended."""
    GUIDED = "guided"
    """Guidance commands the vehicle, or waits for the start."""
    HELD = "held"
    """A person holds the vehicle."""
    OVER = "over"
    """Guidance or a person has ended the attempt; the vehicle hovers, or somebody else flies it."""
    MANUAL = "by hand"
    """A person flies by hand, or has the hand already on the ground."""
    LANDING = "landing"
    """A landing where the vehicle is, by a person's order or with its last charge."""
    CUTTING = "cutting"
    """The motors are to be cut, and the vehicle has not reported it."""
    EMERGENCY = "emergency"
    """The motors were cut."""


class Rule(Enum):
    """The answer to an order in one situation."""

    YES = "yes"
    HOLDER = "holder"
    """Accepted from the sender that has the hand, refused from all others."""
    IDLE = "holder, or idle"
    """Accepted from the holder, and from everybody while the holder's sticks have been centred for `IDLE_HAND_S`."""
    FLYING = "no: flies"
    ON_GROUND = "no: ground"
    NO_HAND = "no: no hand"
    NO_EMERGENCY = "no: none"
    CUTTING = "no: cutting"
    EMERGENCY = "no: motors off"
    UNHEARD = "no: silent"


REASONS: Mapping[Rule, str] = MappingProxyType(
    {
        Rule.HOLDER: '{holder} has the hand; "manual" takes it while its sticks rest',
        Rule.IDLE: f"{{holder}} has the hand, and moved it in the last {IDLE_HAND_S:g} s",
        Rule.FLYING: "the vehicle flies already",
        Rule.ON_GROUND: 'the vehicle stands on the ground: "takeoff" first, or order it in the air',
        Rule.NO_HAND: "nobody flies by hand",
        Rule.NO_EMERGENCY: "the vehicle is not in its emergency state",
        Rule.CUTTING: 'the motors are to be cut, and the vehicle has not confirmed it yet: "reset" ends that order',
        Rule.EMERGENCY: "the motors were cut: {way}",
        Rule.UNHEARD: "the vehicle is silent",
    }
)
"""The text of each refusal."""


def _row(*cells: Rule) -> Mapping[ControlSituation, Rule]:
    return MappingProxyType(dict(zip(ControlSituation, cells, strict=True)))


_Y, _H = Rule.YES, Rule.HOLDER
_F, _G, _N, _X, _C, _E, _U = (
    Rule.FLYING, Rule.ON_GROUND, Rule.NO_HAND, Rule.NO_EMERGENCY, Rule.CUTTING, Rule.EMERGENCY, Rule.UNHEARD,
)  # fmt: skip

TABLE: Mapping[OperatorOrder, Mapping[ControlSituation, Rule]] = MappingProxyType(
    {
        #                     unheard ground done guided held over manual landing cutting emergency
        OperatorOrder.EMERGENCY: _row(_Y, _Y, _Y, _Y, _Y, _Y, _Y, _Y, _Y, _Y),
        OperatorOrder.MANUAL: _row(_U, _Y, _Y, _Y, _Y, _Y, Rule.IDLE, _Y, _C, _E),
        # Anybody stops a vehicle that somebody else flies by hand, as he stops guidance: it hovers, and he reads who did.
        OperatorOrder.ABORT: _row(_Y, _Y, _Y, _Y, _Y, _Y, _Y, _Y, _C, _E),
        OperatorOrder.HOLD: _row(_Y, _Y, _Y, _Y, _Y, _Y, _Y, _Y, _C, _E),
        OperatorOrder.LAND: _row(_Y, _Y, _Y, _Y, _Y, _Y, _H, _Y, _C, _E),
        OperatorOrder.TAKE_OFF: _row(_U, _Y, _Y, _F, _F, _F, _H, _Y, _C, _E),
        # An order to fly to the pad is not kept on the ground: it would take the vehicle from who lifts it by hand.
        OperatorOrder.STAY: _row(_U, _G, _G, _Y, _Y, _Y, _H, _Y, _C, _E),
        OperatorOrder.BEGIN: _row(_U, _G, _G, _Y, _Y, _Y, _H, _Y, _C, _E),
        OperatorOrder.RELEASE: _row(_N, _N, _N, _N, _N, _N, _H, _N, _N, _N),
        OperatorOrder.RESET: _row(_X, _X, _X, _X, _X, _X, _X, _X, _Y, _Y),
        OperatorOrder.CLEAR: _row(_Y, _G, _G, _Y, _Y, _Y, _H, _Y, _C, _E),
        OperatorOrder.RECORD: _row(_Y, _Y, _Y, _Y, _Y, _Y, _Y, _Y, _Y, _Y),
    }
)
"""The rule for each order in each situation."""
RANKED = tuple(TABLE)[: tuple(TABLE).index(OperatorOrder.BEGIN) + 1]
"""The orders that command the vehicle; the first wins over all that follow."""


def crossed(order: OperatorOrder, earlier: OperatorOrder) -> bool:
    """Return whether `order` yields to another sender's order that was accepted within the last `CROSSING_S` seconds."""
    return order in RANKED and earlier in RANKED and RANKED.index(earlier) < RANKED.index(order)


def markdown() -> str:
    """Return the table as docs/operator.md shows it."""
    lines = ["| order | " + " | ".join(s.value for s in ControlSituation) + " |", "|---|" + "---|" * len(ControlSituation)]
    lines += [f"| `{order.value}` | " + " | ".join(row[s].value for s in ControlSituation) + " |" for order, row in TABLE.items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(markdown())
