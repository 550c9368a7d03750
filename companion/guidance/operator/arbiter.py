"""The arbiter of people's orders: it answers each by the table of precedence, and decides who commands the vehicle. No I/O.

It stands between guidance and the vehicle: guidance's command passes while no person commands. A person who flies by hand
replaces it; a landing that a person ordered is guidance's own, which no limit then holds back. Losing the sender that has the
hand leads to a hold, never to its last command.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Protocol

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from companion.base.loop_lag import STOOD_S
from companion.base.mission import ORDERED, Reason, ReasonCause, State
from companion.base.orders import CENTRED, HandledOrder, OperatorOrder, OrderSender, OrderSource, StickPositions
from companion.guidance.operator.command_limits import Limit, PlaceMemory, limited, place_step
from companion.guidance.operator.order_time import Stop, Stops
from companion.guidance.operator.precedence import CROSSING_S, IDLE_HAND_S, REASONS, TABLE, ControlSituation, Rule, crossed
from companion.settings.operator import LimitOptions, ManualOptions
from estimator.contracts.commands import Command, CutMotors, Hover, Land, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.samples import Sample, VehicleStatus
from estimator.contracts.time import MonoNs, after, seconds_between

_STATUS_FRESH_S = 3.0
"""A status older than this is ignored; an autopilot sends one with each heartbeat, every second."""
_REPEAT_S = 0.5
"""The time for which the end of a cut is repeated: a command may be lost on its way."""
_CALL_OFF_S = 0.1
"""The time for which the end of a landing or of a take-off is repeated, and the least of a landing; sticks count after it."""
_OBEYED_S = 2.0
"""Time for which a cut of the motors or its end may be unconfirmed until its sender is warned, s; some report once a second."""
_LIMIT_GAP_S = 1.0  # gap up to which a limit that changes commands counts as lasting
_WAITED_S = 1.0
"""Time after a standstill of this service in which orders still come that waited meanwhile, s."""
NEVER_OLD = (OperatorOrder.ABORT, OperatorOrder.HOLD, OperatorOrder.RELEASE)
"""Orders that a standstill of this service makes no older: a stop stays one, and all others were meant for what was then."""
_SHOWN = (OperatorOrder.ABORT, OperatorOrder.HOLD, OperatorOrder.LAND)
"""Orders whose sender is shown while they stand."""
_TO_PAD = (OperatorOrder.BEGIN, OperatorOrder.STAY)
_SAMPLES_MOST = 64
"""Number of samples from which they are processed though no command needs the place."""
BY_HAND, CUTTING = "flown by hand", "cutting the motors: not confirmed yet"
"""The phases in which a person commands."""
_NOT_LEFT = "the vehicle still reports its emergency state: set it upright on firm ground, or switch it off and on"


class Guided(Protocol):
    """Interface of guidance that the arbiter needs."""

    @property
    def vehicle(self) -> VehicleStatus | None: ...

    @property
    def outcome(self) -> Enum | None: ...

    @property
    def paused(self) -> bool: ...

    @property
    def may_begin(self) -> bool: ...

    @property
    def lands_here(self) -> bool: ...

    def land(self, at: MonoNs) -> None: ...

    def begin(self, at: MonoNs) -> None: ...

    def stay(self, at: MonoNs) -> None: ...

    def hold(self, why: Reason = ORDERED) -> None: ...

    def abort(self) -> None: ...

    def overrule(self) -> None: ...

    def barred(self) -> tuple[str, bool]: ...


class Given(Struct, frozen=True):
    """An order in force: who gave it, and when."""

    sender: OrderSender
    at: MonoNs


class Control(Struct, frozen=True):
    """Holder of the command over the vehicle."""

    hand: OrderSender | None = None
    """The sender that flies by hand."""
    sticks: StickPositions = CENTRED
    sticks_at: MonoNs | None = None
    moved_at: MonoNs | None = None
    """Time when a stick was last out of its centre, or the hand was taken."""
    landing: Given | None = None
    """A landing that guidance does not fly, as it knows of no flight: the vehicle's own is requested."""
    lands_unheard: bool = False
    """True if it was not known then whether the vehicle flies: guidance flies it as soon as it knows of a flight.

    What lifts off after an order on the ground is not landed by it.
    """
    take_off: Given | None = None
    """A take-off that is not sent yet."""
    called_off: Given | None = None
    """The order that ended a landing or a take-off, while it is passed to the vehicle."""
    cut: Given | None = None
    """The order to cut the motors, until the vehicle reports that it is obeyed."""
    cut_failed: str = "the vehicle does not report that its motors stand"
    """Reason why the vehicle's link did not take the cut, or why its sender is warned that it is not obeyed."""
    reset: Given | None = None
    warned: bool = False
    """True if the sender of a cut or of its end was warned that it is not obeyed yet."""
    accepted: tuple[OperatorOrder, Given] | None = None
    """The newest accepted order among those that have a rank."""
    passed_at: MonoNs | None = None
    """Time when that order was first passed to the vehicle; a slow cycle may come long after the order."""

    def passed_s(self, now: MonoNs) -> float:
        """Return for how long the newest order has been passed to the vehicle, s; 0 before."""
        return 0.0 if self.passed_at is None else seconds_between(self.passed_at, now)


class Limited(Struct, frozen=True):
    """The limits that changed commands lately."""

    at: tuple[tuple[Limit, MonoNs], ...] = ()
    """Time when each limit last changed a command."""
    fenced_since: MonoNs | None = None
    """Time since which the fence has changed commands, with gaps below `_LIMIT_GAP_S`."""
    ended: str = ""
    """Reason why the limits ended the landing, while guidance is held for it."""

    def step(self, hit: tuple[Limit, ...], now: MonoNs) -> Limited:
        """Return the memory after a cycle in which these limits changed the command."""
        if not hit and not self.at:
            return self
        recent = {limit: at for limit, at in self.at if seconds_between(at, now) <= _LIMIT_GAP_S} | dict.fromkeys(hit, now)
        since = (self.fenced_since or now) if Limit.FENCE in recent else None
        return replace(self, at=tuple(recent.items()), fenced_since=since)

    def text(self) -> str:
        """Return the limits in force; a limit counts a little longer, so that it is not reported again and again."""
        return "limited by " + ", ".join(sorted(limit.value for limit, _ in self.at)) if self.at else ""


class Chosen(Struct, frozen=True):
    """The command of one cycle."""

    command: Command | None
    phase: str | None = None
    """The phase if a person commands, else None."""
    reason: str = ""
    limit: str = ""
    """The limits that change the command, or ended the landing."""


class OperatorArbiter:
    """Takes orders and stick positions; see the module's docstring.

    Args:
        guided: guidance, which is held while a person commands, or when a limit ends its landing.
        limits: the limits of every command.
    """

    def __init__(self, guided: Guided, manual: ManualOptions | None = None, limits: LimitOptions | None = None) -> None:
        self._guided = guided
        self._o = manual or ManualOptions()
        self._limits = limits or LimitOptions()
        self._place = PlaceMemory()
        self._samples: list[Sample] = []
        """Samples after `_place`."""
        self._trusts_velocity, self._error_m_s = True, 0.0
        self._limited = Limited()
        self._control = Control()
        self._stops, self._was_cut = Stops(), False
        self._ticked: MonoNs | None = None
        self._stood: tuple[float, MonoNs] | None = None
        """Duration of the newest standstill of this service, s, and its end."""
        self.on_order: Callable[[HandledOrder], None] = lambda handled: None
        """Receives every order with its answer."""
        self.hand_taken: tuple[OrderSender, str] | None = None
        """The sender that lost the hand by no order of its own, and why, until its next order."""
        self.ignored_sticks = 0
        """Stick positions of senders that do not have the hand."""

    @property
    def hand(self) -> OrderSender | None:
        """The sender that flies by hand; None while there is none."""
        return self._control.hand

    def newest_status(self, now: MonoNs) -> VehicleStatus | None:
        """Return the vehicle's status, or None if it has not reported one lately."""
        status = self._guided.vehicle
        return status if status is not None and seconds_between(status.stamp.received_at, now) <= _STATUS_FRESH_S else None

    @property
    def ordered_by(self) -> OrderSender | None:
        """The sender of the newest order that was obeyed, if that was a hold, an abort, or to land where it is."""
        order, given = self._control.accepted or (None, None)
        return given.sender if given is not None and order in _SHOWN else None

    @property
    def _lands(self) -> bool:
        return self._control.landing is not None or self._guided.lands_here

    def situation(self, now: MonoNs) -> ControlSituation:
        """Return the situation that decides about an order."""
        status, control = self.newest_status(now), self._control
        if control.cut is not None:
            return ControlSituation.CUTTING
        if status is not None and status.emergency:
            return ControlSituation.EMERGENCY
        if self._lands:
            return ControlSituation.LANDING
        if control.hand is not None:
            return ControlSituation.MANUAL
        if status is None:
            return ControlSituation.UNHEARD
        over = self._guided.outcome is not None
        if status.flying is False:
            return ControlSituation.DONE if over else ControlSituation.GROUND
        return ControlSituation.OVER if over else ControlSituation.HELD if self._guided.paused else ControlSituation.GUIDED

    def take(
        self, order: OperatorOrder, sender: OrderSender, now: MonoNs, detail: str = "", *, given_at: MonoNs | None = None
    ) -> HandledOrder:
        """Answer an order, and carry it out if the tables allow.

        Args:
            given_at: time when it was given (`order_time.given_at`); None if it is given now.
        """
        refusal, hand = self.refusal(order, sender, now, given_at), self.hand
        if self.hand_taken is not None and self.hand_taken[0] == sender:
            self.hand_taken = None
        if refusal is None:
            self._carry_out(order, Given(sender, now))
        if hand not in (None, sender, self.hand):
            self.hand_taken = hand, f'{sender} ordered "{order.value}"'
        return self.tell(HandledOrder(now, sender, order, refusal, detail))

    def tell(self, handled: HandledOrder) -> HandledOrder:
        """Report an order that was answered, and return it."""
        self.on_order(handled)
        return handled

    def move(self, sender: OrderSender, sticks: StickPositions, now: MonoNs) -> None:
        """Take the present stick positions of a sender; they count only if it has the hand."""
        if sender == self._control.hand:
            moved_at = self._control.moved_at if sticks.centred else now
            self._control = replace(self._control, sticks=sticks, sticks_at=now, moved_at=moved_at)
        else:
            self.ignored_sticks += 1

    def lost(self, sender: OrderSender, now: MonoNs, why: str) -> None:
        """Hold if this sender had the hand, because it is gone."""
        if sender == self._control.hand:
            self._hold(sender, now, why)

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Take samples of the vehicle, which the limits need."""
        self._samples += samples
        if len(self._samples) > _SAMPLES_MOST:
            self.place()

    def place(self) -> PlaceMemory:
        """Return the vehicle's place by all samples."""
        if self._samples:
            trusts, error_m_s = self._trusts_velocity, self._error_m_s
            self._place = place_step(self._place, self._samples, trusts_velocity=trusts, error_m_s=error_m_s)
            self._samples.clear()
        return self._place

    def tick(self, now: MonoNs) -> None:
        """Follow the time and the vehicle's status; call it before each cycle of guidance."""
        self._stood, self._ticked = self._stood_still(now), now
        control, status = self._control, self._guided.vehicle
        if control.hand is not None:
            if control.sticks_at is None or seconds_between(control.sticks_at, now) > self._o.silence_s:
                self._hold(control.hand, now, f"nothing received from {control.hand} for {self._o.silence_s:g} s")
            else:
                self._guided.hold()
        if control.called_off is not None and control.passed_s(now) > _CALL_OFF_S:
            self._control = replace(self._control, called_off=None)
        self._follow_motors(now, status)
        if status is None:
            return
        if status.emergency and not self._was_cut and control.cut is None:
            self._stops = self._stops.on_stop(Stop.EMERGENCY, now, "the vehicle cut its motors")
        self._was_cut = status.emergency
        self._follow_landing(control, status, now)

    def _follow_landing(self, control: Control, status: VehicleStatus, now: MonoNs) -> None:
        landing = control.landing
        over = status.flying is False or status.emergency or status.taken is not None
        over = over or (status.flying is True and not control.lands_unheard)
        newest = min(status.stamp.received_at, after(now, -_CALL_OFF_S))
        if landing is not None and over and newest > landing.at:
            self._control = replace(self._control, landing=None)
        elif landing is not None and control.lands_unheard and self._guided.may_begin:
            self._control = replace(self._control, landing=None)
            if self._all_stops().since(OperatorOrder.LAND, landing.sender, landing.at, now) is None:
                self._guided.land(landing.at)

    def _follow_motors(self, now: MonoNs, status: VehicleStatus | None) -> None:
        """End a cut of the motors, or its end, once it is obeyed; tell its sender if that takes long, and when it comes."""
        control, given = self._control, self._control.cut or self._control.reset
        if given is None:
            return
        emergency = status is not None and status.emergency
        if control.cut is not None:
            order, why = OperatorOrder.EMERGENCY, f"not obeyed yet, and sent until it is: {control.cut_failed}"
            obeyed = emergency and status is not None and status.stamp.received_at > given.at
        else:
            order, why = OperatorOrder.RESET, f"not obeyed: {_NOT_LEFT}"
            obeyed = not emergency and control.passed_s(now) > _CALL_OFF_S
        if obeyed:
            self._control = replace(control, cut=None, reset=None, warned=False)
        if control.warned != (not obeyed and seconds_between(given.at, now) > _OBEYED_S):
            self._control = replace(self._control, warned=not obeyed)
            self.tell(HandledOrder(now, given.sender, order, None if obeyed else why, "(obeyed)" if obeyed else ""))

    def choose(
        self,
        now: MonoNs,
        guided: Command | None,
        belief: RelativeState | None = None,
        *,
        trusts_velocity: bool = True,
        error_m_s: float = 0.0,
        unseen_m: float = 0.0,
    ) -> Chosen:
        """Return the command of this cycle within the limits: a person's if one commands, else guidance's.

        Args:
            belief: the steering estimate of the pad.
            trusts_velocity: integrity guard and monitor do not refuse the measured velocity.
            error_m_s: rate at which a place by the velocity becomes uncertain.
            unseen_m: way that may have been flown unseen since the newest sight.
        """
        self._trusts_velocity, self._error_m_s = trusts_velocity, error_m_s
        chosen, manual = self._choose(now, guided), self._control.hand is not None
        hit: tuple[Limit, ...] = ()
        # A person's landing is reversed by no limit; a fence would tear it off the deck that it follows.
        if chosen.command is not None and not self._lands:
            place = self.place()
            command, hit = limited(chosen.command, self._limits, place, belief, now, manual=manual, unseen_m=unseen_m)
            if command is not chosen.command:
                chosen = replace(chosen, command=command)
        self._limited = self._limited.step(hit, now)
        fenced_s = seconds_between(self._limited.fenced_since or now, now)
        held_back = fenced_s >= self._limits.fence_ends_s and not self._lands
        if not manual and held_back and not self._guided.paused and self._guided.outcome is None:
            why = f"{Limit.FENCE.value} held guidance back for {self._limits.fence_ends_s:g} s"
            self._guided.hold(Reason(ReasonCause.SERVICE, detail=why))
            self._stops = self._stops.on_stop(Stop.HOLD, now, why)
            self.tell(HandledOrder(now, OrderSender(OrderSource.LIMITS), OperatorOrder.HOLD, None, f"({why})"))
            self._limited = replace(self._limited, ended=f"landing ended: {why}")
            chosen = replace(chosen, command=Hover())
        if not self._guided.paused or manual:
            self._limited = replace(self._limited, ended="")
        return replace(chosen, limit=self._limited.ended or self._limited.text())

    @property
    def cuts(self) -> bool:
        """True while a person's order to cut the motors is not obeyed yet."""
        return self._control.cut is not None

    @property
    def commands(self) -> bool:
        """True while a person's order decides: a cut or its end, a hold, an abort, a landing, or a hand."""
        control = self._control
        order = None if control.accepted is None else control.accepted[0]
        stopped = self._guided.paused or order in (OperatorOrder.HOLD, OperatorOrder.ABORT, OperatorOrder.EMERGENCY)
        return stopped or any((control.cut, control.reset, control.called_off, control.landing, control.hand))

    def without_guidance(self, now: MonoNs) -> Chosen:
        """Return the command of a person's order where guidance failed; who flies by hand hovers, as no limit is known."""
        chosen = self._choose(now, Hover())
        return replace(chosen, command=Hover()) if isinstance(chosen.command, Velocity) else chosen

    def _choose(self, now: MonoNs, guided: Command | None) -> Chosen:
        control = self._control
        if control.passed_at is None:
            control = self._control = replace(control, passed_at=now)
        if control.cut is not None:
            return Chosen(CutMotors(), CUTTING, f"ordered by {control.cut.sender}: {control.cut_failed}")
        if control.reset is not None and control.passed_s(now) <= _REPEAT_S:
            return Chosen(LeaveEmergency())
        if control.take_off is not None:
            self._control = replace(control, take_off=None)
            return Chosen(TakeOff(), reason=f"take-off for {control.take_off.sender}")
        if control.called_off is not None:
            return Chosen(Hover(calls_off=True), reason=f"{control.called_off.sender} called it off")
        if control.landing is not None:
            return Chosen(Land(here=True), State.LAND_HERE.value, f"ordered by {control.landing.sender}")
        if control.hand is not None:
            status = self._guided.vehicle
            flies = status is not None and status.flying is not False and not status.emergency
            return Chosen(self._manual() if flies else None, BY_HAND, f"by {control.hand}")
        return Chosen(guided)

    def undelivered(self, command: Command, now: MonoNs, why: str = "") -> None:
        """Note that the vehicle's link did not take a command, and why: a take-off is sent again in the next cycle."""
        accepted = self._control.accepted
        if isinstance(command, CutMotors) and why:
            self._control = replace(self._control, cut_failed=why)
        elif isinstance(command, TakeOff) and accepted is not None and accepted[0] is OperatorOrder.TAKE_OFF:
            order = accepted[1] if seconds_between(accepted[1].at, now) <= _REPEAT_S else None
            self._control = replace(self._control, take_off=order)

    def _manual(self) -> Command:
        sticks, o = self._control.sticks, self._o
        if sticks.centred:
            return Hover()
        v = np.array([sticks.forward * o.speed_max_m_s, sticks.right * o.speed_max_m_s, -sticks.climb * o.climb_max_m_s])
        return Velocity(v, sticks.turn * math.radians(o.turn_max_deg_s))

    def refusal(self, order: OperatorOrder, sender: OrderSender, now: MonoNs, given_at: MonoNs | None = None) -> str | None:
        """Return why an order would be refused at this instant; None if it would be carried out."""
        refused = self._refused(order, sender, now)
        return refused if refused is not None or given_at is None else self._all_stops().since(order, sender, given_at, now)

    def _refused(self, order: OperatorOrder, sender: OrderSender, now: MonoNs) -> str | None:
        """Return why an order that is given now would be refused."""
        rule, status = TABLE[order][self.situation(now)], self._guided.vehicle
        stood = self._stood_still(now)
        if stood is not None and order not in NEVER_OLD and seconds_between(stood[1], now) <= _WAITED_S:
            return f"it may be old, for this service stood still for {stood[0]:.1f} s: give it again"
        if order is OperatorOrder.CLEAR and not (bar := self._guided.barred())[1]:
            return f"{bar[0]}: what moves is not ignored" if bar[0] else "nothing is seen that bars a landing"
        own = rule in (Rule.HOLDER, Rule.IDLE) and sender == self._control.hand
        if order in _TO_PAD and (own or rule is Rule.YES) and not self._guided.may_begin:
            return REASONS[Rule.ON_GROUND]
        if own:
            flies = order is OperatorOrder.TAKE_OFF and status is not None and status.flying is not False
            return REASONS[Rule.FLYING] if flies else None
        return self._held_by_others(rule, now) or self._too_little_charge(order, status) or self._crossed(order, sender, now)

    def _held_by_others(self, rule: Rule, now: MonoNs) -> str | None:
        control = self._control
        idle = control.moved_at is None or seconds_between(control.moved_at, now) > IDLE_HAND_S
        if rule is Rule.YES or (rule is Rule.IDLE and idle):
            return None
        return REASONS[rule].format(holder=control.hand, way=_NOT_LEFT if control.warned else '"reset" first')

    def _too_little_charge(self, order: OperatorOrder, status: VehicleStatus | None) -> str | None:
        charge, least = (None if status is None else status.battery_fraction), self._limits.take_off_charge_min
        if order is OperatorOrder.TAKE_OFF and not self._lands and charge is not None and charge < least:
            return f"the battery is at {100 * charge:.0f} %, and a take-off needs {100 * least:.0f} %"
        return None

    def _crossed(self, order: OperatorOrder, sender: OrderSender, now: MonoNs) -> str | None:
        if self._control.accepted is None:
            return None
        earlier, given = self._control.accepted
        ago_s = seconds_between(given.at, now)
        if sender != given.sender and ago_s <= CROSSING_S and crossed(order, earlier):
            return f'{given.sender} ordered "{earlier.value}" {ago_s:.1f} s ago'
        return None

    def _all_stops(self) -> Stops:
        """Return the stops up to now, with what the vehicle reports of others."""
        status, stops = self._guided.vehicle, self._stops
        if status is not None and status.others_at is not None:
            return stops.on_stop(Stop.TAKEN, status.others_at, status.taken or "somebody else chose for the vehicle")
        return stops

    def _stood_still(self, now: MonoNs) -> tuple[float, MonoNs] | None:
        """Return how long this service stood still the last time, s, and when that ended; None if it never did."""
        away_s = 0.0 if self._ticked is None else seconds_between(self._ticked, now)
        return (away_s, now) if away_s > STOOD_S else self._stood

    def _carry_out(self, order: OperatorOrder, given: Given) -> None:
        control, guided = self._control, self._guided
        if order is OperatorOrder.CLEAR:
            guided.overrule()
        if order in (OperatorOrder.RECORD, OperatorOrder.CLEAR):
            return
        self._control = control = replace(control, accepted=(order, given), passed_at=None)
        self._stops = self._stops.on_order(order, given.sender, given.at)
        match order:
            case OperatorOrder.EMERGENCY:
                self._control = Control(cut=given, accepted=control.accepted)
                guided.abort()
            case OperatorOrder.MANUAL:
                ended = given if self._lands else None
                by_hand = replace(control, hand=given.sender, sticks=CENTRED, sticks_at=given.at, moved_at=given.at)
                self._control = replace(by_hand, landing=None, called_off=ended)
                guided.hold()
            case OperatorOrder.LAND:
                self._order_landing(control, given)
            case OperatorOrder.ABORT | OperatorOrder.HOLD:
                self._control = replace(control, hand=None, take_off=None, landing=None, called_off=given)
                watch = Reason(ReasonCause.SERVICE, detail=given.sender.name.strip("()"))
                why = watch if given.sender.source is OrderSource.LIMITS else ORDERED
                guided.abort() if order is OperatorOrder.ABORT else guided.hold(why)
            case OperatorOrder.TAKE_OFF:
                # During a landing it may only end that: the motors of a vehicle that has just touched down would start.
                begins, ends = (None, given) if self._lands else (given, None)
                if ends is not None:
                    guided.hold()
                self._control = replace(control, take_off=begins, called_off=ends, landing=None)
            case OperatorOrder.BEGIN | OperatorOrder.STAY:
                self._control = replace(control, hand=None)
                (guided.begin if order is OperatorOrder.BEGIN else guided.stay)(given.at)
            case OperatorOrder.RELEASE:
                self._control = replace(control, hand=None)
            case OperatorOrder.RESET:
                self._control = replace(control, cut=None, reset=given, warned=False)

    def _order_landing(self, control: Control, given: Given) -> None:
        guided = self._guided
        flying = None if guided.vehicle is None else guided.vehicle.flying
        aloft, unheard = guided.may_begin and flying is not False, flying is None
        kept = None if aloft else given
        self._control = replace(control, landing=kept, lands_unheard=unheard, hand=None, take_off=None, called_off=None)
        if aloft:
            guided.land(given.at)

    def _hold(self, sender: OrderSender, now: MonoNs, why: str) -> None:
        """Take the hand from a sender that is gone, and hover."""
        self._stops = self._stops.on_stop(Stop.HOLD, now, why)
        self._control = replace(self._control, hand=None, sticks=CENTRED)
        self.hand_taken = sender, f"{why}: it hovers"
        self._guided.hold(Reason(ReasonCause.SERVICE, detail=why))
        self.tell(HandledOrder(now, sender, OperatorOrder.HOLD, None, f"({why})"))
