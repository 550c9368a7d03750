"""The service's vehicle if that is an autopilot: its links, the MAVLink component on them, and the pilot's operator."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from typing import Protocol

import numpy as np
from msgspec import structs

from companion.base.health import GIMBAL, Health
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.cycle.ports import Assembly, VehicleParts
from companion.guidance.flight_memory import KEPT_WAY_S
from companion.guidance.pilot_operator import PilotOperator
from companion.parts.mavlink.camera_component import showing, shown_camera
from companion.parts.mavlink.commands import PilotTower, link_counters
from companion.parts.mavlink.component import PARAMETERS, Component
from companion.parts.mavlink.handover import Handover
from companion.parts.mavlink.outputs import Lead, Outputs
from companion.parts.mavlink.parameters import tunables
from companion.parts.mavlink.rc_switch import RcSwitch
from companion.parts.mavlink.signed_links import signed_links
from companion.settings.guidance import GuidanceOptions
from companion.tools.doctor.finding import Finding, Severity
from companion.tools.doctor.listening import Notes, snapshot_of
from companion.tools.doctor.rules_watched import WATCHED
from companion.tools.doctor.snapshot import LinkSnapshot, Snapshot
from drivers.clock import SystemClock
from drivers.mavlink.autopilot import Autopilot, links_of, open_autopilot
from drivers.mavlink.custody import Authority
from drivers.mavlink.gimbal import Gimbal, tended
from drivers.mavlink.links import Link, Links
from drivers.mavlink.options import AutopilotOptions, autopilot_of
from drivers.mavlink.samples import LocalPosition
from drivers.mavlink.take_off import Rested
from drivers.reconnect import Repeated, running_beside
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import Clock, MonoNs, seconds_between

# Estimate the pad's velocity over the ground, so that a vehicle with ground-referenced velocities can fly relative to the pad.
#
# Guidance commands velocities as if the surface below were still. An AR.Drone measures its velocity and height against the
# surface that it sees, which is the deck; an autopilot measures them over the ground, so a ship under way would leave it
# behind, and a heaving deck would rise faster than guidance corrects for. The pad's velocity over the ground is the autopilot's
# velocity plus the pad's velocity relative to the body. The horizontal part is a mean over some seconds, which keeps the ship's
# way. Out of sight the mean over some waves is held, as long as she did not turn away from it, and after that the ship's own
# report of her velocity stands for it. Without a report it is kept for some minutes more, as is that of the deck from which the
# vehicle took off, and of where she has been since: a hover over the ground soon loses a ship that keeps her way. The vertical
# part is the current heave, zero while the pad is out of sight.

MEAN_S = 2.0
"""Time over which the horizontal velocity is averaged."""
WAVES_S = 6.0
"""Time over which it is averaged for a hold without sight, which follows what is left of a wave for minutes."""
HEAVE_S = 0.15
"""Time over which the vertical velocity is averaged."""
FORGET_S = 20.0
"""The time after which a pad that comes back into sight counts as another pad, s."""
_UNSEEN_S = 1.0  # time without sight from which the mean over waves is held
_FRESH_S = 0.3  # age up to which an estimate counts
_SIGMA_MAX_M_S = 0.6  # standard deviation of its velocity up to which it counts
_MOST_M_S = 15.0  # speed that is given to the autopilot at most
_CARRIED_S = 10.0  # time since the take-off from which the way since then counts
_SAME_WAY_M_S = 0.6  # its largest difference from the deck's velocity: waves and an operator some metres beside the pad make it

_EACH_S = 1.0  # interval at which the links are examined
_WINDOW_S = 8.0  # time over which their counters are compared
_FIRST_S = 6.0
"""Time for which is listened before anything is judged: a link and its first requests need some seconds."""
_AGAIN_S = 60.0
"""The shortest time between two log lines about the same."""


class Moving(Protocol):
    """The part of the autopilot's state that `DeckVelocity` reads."""

    @property
    def attitude(self) -> Attitude | None: ...

    @property
    def positions(self) -> tuple[LocalPosition, ...]: ...

    @property
    def rested(self) -> Rested | None: ...

    @property
    def steered(self) -> bool: ...


class DeckVelocity:
    """Returns the pad's velocity over the ground; call it for each command.

    Args:
        believe: returns the belief about the pad at an instant.
        reported: returns the ship's own report of her velocity, (2,) m/s north and east; None if there is no fresh one.
        trusted: returns whether the vehicle's velocity is trusted. While it is not, nothing that was measured by it counts.
    """

    def __init__(
        self,
        believe: Callable[[MonoNs], RelativeState | None],
        autopilot: Moving,
        reported: Callable[[MonoNs], F64 | None] = lambda now: None,
        trusted: Callable[[], bool] = lambda: True,
    ) -> None:
        self._believe, self._autopilot, self._reported, self._trusted = believe, autopilot, reported, trusted
        self._velocity = self._over_waves = np.zeros(3)
        self._known_s = 0.0
        self._at: MonoNs | None = None
        self._kept: tuple[MonoNs, F64] | None = None
        """Time when the pad was last seen or the vehicle stood on the deck, and its horizontal velocity then."""

    def __call__(self, now: MonoNs) -> F64:
        """Return the pad's velocity, (3,) m/s in ned; it is zero while nothing is known of pad and ship."""
        measured, rested = self._measured(now) if self._trusted() else None, self._autopilot.rested
        if not self._trusted():
            self._kept = None
            self._forget()
        if rested is not None and (self._kept is None or rested.at > self._kept[0]):
            self._kept = rested.at, rested.v_ned
        elif rested is not None and self._kept is not None and rested.at == self._kept[0] and not self._autopilot.steered:
            self._kept = rested.at, self._carried(now, rested)
        if self._at is not None and seconds_between(self._at, now) > FORGET_S:
            self._kept = self._at, self._steady * (1.0, 1.0, 0.0)
            self._forget()
        if measured is not None:
            since_s = 0.0 if self._at is None else min(seconds_between(self._at, now), 0.2)
            if self._at is None and (kept := self._kept_way(now)) is not None:
                # Half a second of a sight that is wrong must not stand for what is kept for minutes.
                self._known_s, self._at = MEAN_S, now
                self._velocity = self._over_waves = np.array([*kept[:2], measured[2]])
            self._known_s += since_s
            spans_s = np.minimum(self._known_s, [[MEAN_S, MEAN_S, HEAVE_S], [WAVES_S] * 3])
            weights = np.ones((2, 3)) if self._at is None else since_s / np.maximum(spans_s, max(since_s, 1e-9))
            self._velocity = self._velocity + weights[0] * (measured - self._velocity)
            self._over_waves = self._over_waves + weights[1] * (measured - self._over_waves)
            self._at = now
        elif self._at is not None and seconds_between(self._at, now) > HEAVE_S:
            self._velocity = self._velocity * (1.0, 1.0, 0.0)
            if seconds_between(self._at, now) > _UNSEEN_S:
                self._velocity = self._steady * (1.0, 1.0, 0.0)
        velocity = self._velocity
        if self._at is None:
            v_ship = self._reported(now)
            if v_ship is not None:
                velocity = np.array([*v_ship, 0.0])
            elif (kept := self._kept_way(now)) is not None:
                velocity = kept
        speed = math.hypot(velocity[0], velocity[1])
        return velocity * min(1.0, _MOST_M_S / max(speed, 1e-9))

    def way(self, now: MonoNs) -> tuple[float, float] | None:
        """Return the ship's way, m/s north and east, for a service that takes over in the air, or None."""
        if not self._trusted():
            return None
        kept = self._steady if self._at is not None else self._kept_way(now)
        return None if kept is None else (round(kept.item(0), 3), round(kept.item(1), 3))

    def _forget(self) -> None:
        """Forget what sights of the pad showed."""
        self._known_s, self._at = 0.0, None
        self._velocity = self._over_waves = np.zeros(3)

    @property
    def _steady(self) -> F64:
        """The ship's way without the waves, (3,) m/s; that of the last seconds where she does not keep it."""
        return self._over_waves if math.dist(self._over_waves[:2], self._velocity[:2]) <= _SAME_WAY_M_S else self._velocity

    def _kept_way(self, now: MonoNs) -> F64 | None:
        """Return the ship's way from before the pad came into sight, (3,) m/s; None if it is not known any more."""
        return None if self._kept is None or seconds_between(self._kept[0], now) > KEPT_WAY_S else self._kept[1]

    def _carried(self, now: MonoNs, left: Rested) -> F64:
        """Return the way of the ship that carried the deck from under a vehicle to under it again, (3,) m/s, level.

        A landing is ordered over the pad. The mean since the take-off has none of the waves that are in a deck's velocity
        over some seconds; from elsewhere than over the pad it contradicts that velocity, which then stands.
        """
        positions, since_s = self._autopilot.positions, seconds_between(left.at, now)
        if not positions or since_s < _CARRIED_S:
            return left.v_ned
        way = (positions[-1].p_body_ned - left.p_ned) * (1.0, 1.0, 0.0) / since_s
        return way if math.dist(way, left.v_ned) <= _SAME_WAY_M_S else left.v_ned

    def _measured(self, now: MonoNs) -> F64 | None:
        """Return the pad's velocity over the ground at this instant, or None if it cannot be determined."""
        belief, attitude, positions = self._believe(now), self._autopilot.attitude, self._autopilot.positions
        if belief is None or attitude is None or not positions or not belief.consistent:
            return None
        newest = positions[-1]
        late = max(
            belief.age_s(now), seconds_between(newest.stamp.measured_at, now), seconds_between(attitude.stamp.measured_at, now)
        )
        sigma_m_s = math.sqrt(max(float(belief.cov[3, 3] + belief.cov[4, 4]), 0.0))
        if late > _FRESH_S or sigma_m_s > _SIGMA_MAX_M_S:
            return None
        level = Rotation.from_rpy(0.0, 0.0, attitude.R_ned_body.rpy_rad[2])
        return newest.v_body_ned + level @ belief.v_pad_level


def authority_of(guidance: GuidanceOptions) -> Authority:
    """Return what the settings let leave to move the vehicle."""
    if guidance.mission != "targets":
        return Authority.SETPOINTS
    return Authority.MODES if guidance.mode_changes else Authority.NOTHING


class AutopilotPart:
    """Opens the autopilot with our component on its links. The component is an observer of the service.

    Raises:
        BadInput: a signing key that cannot be read.
    """

    def __init__(self, service: Assembly, vehicle: AutopilotOptions) -> None:
        settings, pilot, health, clock = service.settings, service.pilot, service.health, service.clock
        self._pilot, self._health, self._clock = pilot, health, clock
        self._tap, self._show = service.tap, shown_camera(service)
        self._open: Autopilot | None = None
        self._links: Links | None = None
        self._options = vehicle
        self._authority = authority_of(settings.guidance)
        self._endpoints = signed_links(vehicle)
        self.component = Component(
            Outputs(
                settings.landing_target, pilot.pad.disc_radius_m, settings.guidance.stale_after_s, self._lead(settings.guidance)
            ),
            PilotTower(pilot, lambda: self.component.belief, clock, service.recording),
            tunables(settings, pilot),
            believe=pilot.belief,
            clock=clock,
            health=health,
        )
        pilot.engage = self._engage
        health.counters("mavlink", self._counted)
        self._gimbal = Gimbal(settings.camera.gimbal, clock) if settings.camera.gimbal.given else None

        def by(source: OrderSource, name: str) -> PilotOperator:
            return PilotOperator(pilot, OrderSender(source, name), clock)

        switch, after = settings.operator.switch, settings.operator.handover
        self._watchers: list[RcSwitch | Handover] = []
        if switch.channel:
            self._watchers.append(rc := RcSwitch(switch, by(OrderSource.SWITCH, f"channel {switch.channel}").order))
            health.counters("switch", rc.counted)
        if after.mission or after.returns:
            self._watchers.append(
                Handover(after, pilot, lambda name, at: by(OrderSource.HANDOVER, name).order(OperatorOrder.BEGIN, at))
            )
        if self._gimbal is not None:
            health.awaited |= {GIMBAL}
            health.counters("gimbal", self._gimbal.counted)

    @property
    def autopilot(self) -> Autopilot | None:
        """The autopilot whose links are open; None while they are not."""
        return self._open

    @asynccontextmanager
    async def open(self) -> AsyncIterator[Autopilot]:
        """Open the autopilot as the daemon's link."""
        opening = open_autopilot(
            self._options,
            self._clock,
            self._endpoints,
            parameters=PARAMETERS,
            waits=isinstance(self._clock, SystemClock),  # in virtual time the kernel's instants would be another clock's
            authority=self._authority,
        )
        async with opening as autopilot:
            work = [(one.name, one.run(self._clock)) for one in self._join(autopilot)]
            async with showing(self._show, autopilot, self._clock), running_beside(work):
                try:
                    yield autopilot
                finally:
                    self._open = None
                    self.component.detach()
                    self._watch.close()

    def joined(self, made_of: type[Link]) -> tuple[Autopilot, tuple[Repeated, ...]]:
        """Return the autopilot at links that carry messages in a simulation, and all the work that is left to do there."""
        links = links_of(self._options, self._clock, self._endpoints, waits=True, made_of=made_of)
        autopilot = Autopilot(self._options, links, self._clock, PARAMETERS, self._authority)
        return autopilot, (*autopilot.work, *self._join(autopilot))

    def _join(self, autopilot: Autopilot) -> tuple[Repeated, ...]:
        """Join everything to an autopilot's links; return the work that is left to do beside the autopilot's own."""
        self._open, self._links, autopilot.links.tap = autopilot, autopilot.links, self._tap
        for watcher in self._watchers:
            autopilot.add_listener(partial(watcher.on_message, autopilot))
        by = self._pilot.landing
        autopilot.deck_velocity = deck = DeckVelocity(
            self._pilot.belief, autopilot, by.reported_way, lambda: not self._pilot.velocity_refused
        )
        by.ship_way = deck.way
        self.component.attach(autopilot)
        gimbal = () if self._gimbal is None else (tended(self._gimbal, autopilot, self._clock),)
        self._watch = LinkWatch(autopilot, self._options.system_id, self._health, self._clock)
        return self.component.work, *gimbal, self._watch.work

    def _lead(self, guidance: GuidanceOptions) -> Lead | None:
        if guidance.mission != "targets":
            return None
        return Lead(lambda now: self._pilot.estimator.motion(now)[1], guidance.limits.commit_sighting_age_s)

    def _engage(self) -> None:
        if self._open is not None:
            self._open.engage()

    def _counted(self) -> Mapping[str, float]:
        """Return the counters of the links since they were opened last, and of targets that were due but not sent."""
        component = self.component
        out: dict[str, float] = {f"withheld_{why.replace(' ', '_')}": n for why, n in component.outputs.withheld.items()}
        out |= {"targets_sent": component.outputs.sent, "sends_ranges": component.sends_ranges}
        out["leads"] = component.outputs.lead is not None
        out["files_refused"] = component.files.refused.total()
        if self._links is not None:
            out |= link_counters(self._links, component.refusals)
        if self._open is not None:
            out["implausible"] = self._open.refused
            out["out_of_order"] = self._open.out_of_order
        return out


_log = logging.getLogger(__name__)

PART = "MAVLink links"
"""The watch's own name in health: it is down while something is wrong, and the flight does not need it."""
_COUNTED = tuple(name for name in LinkSnapshot.__struct_fields__ if name not in ("url", "down", "signed", "behind_s"))


class LinkWatch:
    """Judges the links of an open autopilot once a second, until it is closed.

    Args:
        wanted: the system id that the settings request; 0 for any.
    """

    def __init__(self, autopilot: Autopilot, wanted: int, health: Health, clock: Clock) -> None:
        self._autopilot, self._wanted, self._health, self._clock = autopilot, wanted, health, clock
        self._notes = Notes()
        self._began = clock.now()
        self._before: deque[tuple[MonoNs, tuple[LinkSnapshot, ...]]] = deque()
        self._found: dict[str, Finding] = {}
        self._logged: dict[str, MonoNs] = {}
        autopilot.add_listener(self._notes.on_message)

    @property
    def work(self) -> Repeated:
        """Its work while the links are open."""
        return Repeated("link-watch", self._step, _EACH_S)

    def close(self) -> None:
        """Listen no more, and leave nothing in health that only an open link could clear."""
        self._autopilot.remove_listener(self._notes.on_message)
        if self._found:
            self._health.up(PART)

    def _step(self) -> float:
        """Look at the links; return the time until the next look, s."""
        self._autopilot.links.contained.run("the watch of the links", "us", self._look)
        return _EACH_S

    def _look(self) -> None:
        now = self._clock.now()
        snapshot = snapshot_of(self._autopilot, self._notes, {}, self._wanted, seconds_between(self._began, now))
        self._before.append((now, snapshot.links))
        while len(self._before) > 2 and seconds_between(self._before[1][0], now) >= _WINDOW_S:
            self._before.popleft()
        if snapshot.seconds < _FIRST_S:
            return
        lately = structs.replace(snapshot, links=tuple(map(_since, self._before[0][1], snapshot.links)))
        self._tell({one.rule: one for rule in WATCHED if (one := rule(lately)) is not None and _matters(one, lately)}, now)

    def _tell(self, found: dict[str, Finding], now: MonoNs) -> None:
        before, self._found = self._found, found
        for rule, one in found.items():
            last = self._logged.get(rule)
            # The driver has logged a conflict already.
            if (
                rule not in before
                and rule not in (d.name for d in self._autopilot.id_conflicts)
                and (last is None or seconds_between(last, now) >= _AGAIN_S)
            ):
                self._logged[rule] = now
                _log.log(_LEVELS[one.severity], "MAVLink: %s; %s", one.what, one.fix)
        if found and found.keys() != before.keys():
            first = next(iter(found.values()))
            self._health.down(PART, Recoverable(f"{first.what}; {first.fix}"))
        elif before and not found:
            self._health.up(PART)
            _log.info("MAVLink: nothing is wrong with the links any more")


_LEVELS = {Severity.ERROR: logging.WARNING, Severity.WARNING: logging.WARNING, Severity.ADVICE: logging.INFO}


def _since(before: LinkSnapshot, now: LinkSnapshot) -> LinkSnapshot:
    """Return a link's counters since an earlier snapshot."""
    return structs.replace(now, **{name: getattr(now, name) - getattr(before, name) for name in _COUNTED})


def _matters(finding: Finding, snapshot: Snapshot) -> bool:
    """Return whether a finding is worth saying in flight: a spare link may be silent, and a conflict may block nothing."""
    if any(one.name == finding.rule for one in snapshot.id_conflicts):
        return True
    return finding.rule != "link-silent" or snapshot.autopilot is None


def make_vehicle(service: Assembly) -> VehicleParts:
    """Return the autopilot of the settings, with our component on its links."""
    options = autopilot_of(service.settings.vehicle)
    assert options is not None
    part = AutopilotPart(service, options)
    return VehicleParts(part.open, (part.component,), lambda: part.autopilot)
