"""Encode the service's state as the messages that it publishes, and find the changes that are worth an event. No I/O."""

from collections.abc import Sequence

from msgspec import Struct, field

from companion.base.health import FusionState, HealthSnapshot
from companion.base.mission import StateChange
from companion.base.observer import Decision, ProcessedFrame
from companion.base.orders import HandledOrder
from companion.facts import encode as facts
from companion.parts.mqtt.messages import (
    EventData,
    EventKind,
    FusionMessage,
    HealthMessage,
    SightingMessage,
    SourceReport,
    StateMessage,
)
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import MonoNs, seconds_between

LOST_AFTER_S = 1.0
"""The time without a sighting after which the pad counts as lost, s."""
BATTERY_LOW = 0.2
"""Charge below which a low battery is an event."""


class PendingEvent(Struct, frozen=True):
    """An event that has no number yet."""

    at: MonoNs
    kind: EventKind
    text: str
    data: EventData = field(default_factory=dict)


def _changed(change: StateChange, place: EventData) -> PendingEvent:
    why = change.reason
    data: EventData = {
        "from": change.source.value,
        "to": change.target.value,
        "event": change.event.name.lower(),
        "cause": why.cause.name.lower(),
        "measured": why.measured,
        "limit": why.limit,
        "detail": why.detail if why.detail is None or isinstance(why.detail, str) else why.detail.name.lower(),
    }
    return PendingEvent(change.at, "phase", f"{change.target.value}: {why.text}", data | place)


def order_event(handled: HandledOrder) -> PendingEvent:
    """Return the event of a person's order and its answer."""
    data: EventData = {
        "command": handled.order.value,
        "source": handled.sender.source.value,
        "sender": handled.sender.name,
        "accepted": handled.accepted,
        "reason": handled.refusal,
    }
    return PendingEvent(handled.at, "command", str(handled), data)


class Changes(Struct):
    """Keeps just enough of the previous state to detect a change."""

    _phase: str | None = None
    _limit: str = ""
    _mode: str | None = None
    _emergency: bool = False
    _battery_low: bool = False
    _sighted: MonoNs | None = None
    _in_sight: bool = False
    _parts: dict[str, tuple[bool, int]] = field(default_factory=dict)

    def decision(self, decision: Decision) -> list[PendingEvent]:
        """Return events for changes of the mission's state, for limits that begin or end, and for a response found in flight."""
        at, belief, found = decision.at, decision.belief, []
        before, self._phase = self._phase, decision.phase
        place: EventData = {} if belief is None else {"height_m": belief.height_m, "lateral_m": belief.lateral_m}
        if decision.transitions:
            found = [_changed(change, place) for change in decision.transitions]
        elif before != decision.phase:  # of a pilot that has no table of states
            found = [PendingEvent(at, "phase", decision.phase, {"from": before, "to": decision.phase, **place})]
        if decision.limit != self._limit:
            self._limit = decision.limit
            found.append(PendingEvent(at, "limit", decision.limit or "no limit any more", {"limit": decision.limit or None}))
        if (response := decision.response) is not None:
            data: EventData = {name: getattr(response, name) for name in ("delay_s", "sigma_s", "longer_s")}
            data |= {"response": response.state.value, "frequency": response.shape.frequency, "damping": response.shape.damping}
            found.append(PendingEvent(at, "vehicle", response.text, data))
        return found

    def vehicle(self, status: VehicleStatus) -> list[PendingEvent]:
        """Return events for a new mode of the vehicle, an emergency or a low battery."""
        at, found = status.stamp.received_at, []
        if status.mode != self._mode:
            found.append(PendingEvent(at, "vehicle", f"vehicle is {status.mode}", {"from": self._mode, "to": status.mode}))
            self._mode = status.mode
        if status.emergency != self._emergency:
            words = "emergency: motors cut" if status.emergency else "emergency is over"
            found.append(PendingEvent(at, "vehicle", words, {"emergency": status.emergency}))
            self._emergency = status.emergency
        battery = status.battery_fraction
        if battery is not None and battery < BATTERY_LOW and not self._battery_low:
            self._battery_low = True
            found.append(PendingEvent(at, "vehicle", f"battery at {100 * battery:.0f} %", {"battery_fraction": battery}))
        return found

    def frame(self, processed: ProcessedFrame) -> list[PendingEvent]:
        """Return an event if the pad comes into sight, or was out of sight for `LOST_AFTER_S`."""
        seen = processed.detection
        if seen is not None and (seen.selected is not None or seen.elsewhere is not None):
            self._sighted = processed.done
            if not self._in_sight:
                self._in_sight = True
                return [PendingEvent(processed.done, "pad", "pad in sight", {"in_sight": True, "method": seen.chosen})]
        elif self._in_sight and self._sighted is not None and seconds_between(self._sighted, processed.done) > LOST_AFTER_S:
            self._in_sight = False
            return [PendingEvent(processed.done, "pad", "pad out of sight", {"in_sight": False})]
        return []

    def health(self, health: HealthSnapshot) -> list[PendingEvent]:
        """Return an event for each part that failed or recovered; its restarts show a failure between two calls."""
        found = []
        for name, part in health.parts.items():
            up, restarts = self._parts.get(name, (True, 0))
            self._parts[name] = (part.up, part.restarts)
            data: EventData = {"part": name, "up": part.up, "restarts": part.restarts}
            if part.restarts > restarts:
                data["error"] = part.last_error
                found.append(PendingEvent(health.at, "part", f"{name} failed: {part.last_error}", data))
            elif part.up and not up:
                found.append(PendingEvent(health.at, "part", f"{name} is up again", data))
        return found


def state(session: str, decision: Decision, vehicle: VehicleStatus | None) -> StateMessage:
    """Return the message for one guidance cycle and the vehicle's newest status."""
    return StateMessage(
        session=session,
        at_ns=decision.at,
        decision=facts.decision(decision),
        belief=None if decision.belief is None else facts.belief(decision.belief),
        shadows=tuple(map(facts.belief, decision.shadows)),
        vehicle=None if vehicle is None else facts.status(vehicle),
    )


def sighting(session: str, processed: ProcessedFrame) -> SightingMessage:
    """Return the message for a frame and what each method detected in it."""
    return SightingMessage(session=session, at_ns=processed.done, detection=facts.detection(processed))


def fusion(session: str, at: MonoNs, states: Sequence[FusionState]) -> FusionMessage:
    """Return the message with the newest result of each source on each path."""
    sources = (
        SourceReport(newest=facts.fusion(at, of.newest), nis_mean=of.nis_mean, verdicts=dict(of.verdicts)) for of in states
    )
    return FusionMessage(session=session, at_ns=at, sources=tuple(sources))


def health(session: str, of: HealthSnapshot) -> HealthMessage:
    """Return the message of a whole health snapshot."""
    return HealthMessage(session=session, at_ns=of.at, health=facts.health(of.at, of))
