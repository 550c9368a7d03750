"""The referee of simulated flights: it counts what hurts, from the truth and from the wires alone, each count with a limit.

It takes the true motion of body, feet, deck and motors, the packets that were sent to the vehicle and the acts of a person with
their instants. It knows no state, phase or setting of guidance; what a flight calls for is given to it as figures (`Errand`).
"""

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import NamedTuple

from msgspec import Struct, field

from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs, after, seconds_between
from sitl.flight.hands import Decides, HandsWatch, descent_m, heights_m
from sitl.flight.limits import AWAY_M, ENDING, HELD_LOW_M, KNEE_M, LOW_M, ON_DECK_M, OURS, STOPS_S, CountLimit, Errand, limits_of
from sitl.vehicle.airframe import Airframe, ContactSettings, Feet
from sitl.vehicle.vehicle import MOTORS_TURN, VehiclePhase
from sitl.vessel.contact import DeckShape
from sitl.world.truth import Touchdown, Truth

BLIND_AFTER_S = 1.0
"""Time after the newest true sight that still counts as sight; the last 0.3 m of a landing, without the pad, take less."""
MET_AFTER_S = 0.5
"""Time after a command at which the vehicle has the speed that it requests, and meets the deck's."""
STAMP_ERROR_MAX_S = 0.5
"""Error of a frame's stamp beyond which the frame says nothing about the pad's present position."""


class BlindDescent(Struct, frozen=True):
    """The deepest descent without true sight of the pad."""

    descent_m: float
    """Descent from the height at which sight was lost: the smaller of those against the deck and over the ground."""
    lowest_m: float
    """Lowest height over the deck meanwhile."""
    blind_s: float
    """Time since the newest true sight, at that height."""


class SightWatch:
    """Watches how far the vehicle comes down without true sight of the pad.

    A descent while nothing reaches the vehicle is kept apart: no order ends it, whatever the service does.
    """

    def __init__(self, start: MonoNs) -> None:
        self.worst = BlindDescent(0.0, math.inf, 0.0)
        self.unreached_m = 0.0
        """Deepest descent during one time in which nothing reached the vehicle, metres."""
        self.deck_fell_m_s = 0.0
        """Fastest fall of the deck at the beginning of such a time, where the last command was meant to meet it."""
        self.since_sight: Counter[Verdict] = Counter()
        """Number of frames by verdict since the newest true sight."""
        self._seen_at = start
        self._lost_at_m: tuple[float, float] | None = None
        self._unreached_at_m: tuple[float, float] | None = None
        self._unreached_since = start

    def seen_s(self, at: MonoNs) -> float:
        """Return the time from the newest true sight of the pad to an instant; negative where the sight came later."""
        return seconds_between(self._seen_at, at)

    def frame(self, exposed_at: MonoNs, verdict: Verdict, *, true_view: bool, stamp_error_s: float) -> None:
        """Note a frame and the service's verdict on it."""
        if verdict is Verdict.FUSED and true_view and abs(stamp_error_s) <= STAMP_ERROR_MAX_S:
            self._seen_at = max(self._seen_at, exposed_at)
            self.since_sight.clear()
        else:
            self.since_sight[verdict] += 1

    def located(self, at: MonoNs) -> None:
        """Note that the service has received the true vector between the antennas of vehicle and ship, of an instant."""
        self._seen_at = max(self._seen_at, at)

    def step(self, truth: Truth, *, reached: bool, ours: bool) -> None:
        """Note the true state at an instant; call it in order of time.

        Args:
            reached: whether the service's commands reach the vehicle.
            ours: whether the service flies; a person who lands it where it is needs no sight of the pad.
        """
        at_m = heights_m(truth)
        if not reached:
            if self._unreached_at_m is None:
                self._unreached_at_m, self._unreached_since = at_m, truth.at
            if seconds_between(self._unreached_since, truth.at) <= MET_AFTER_S:
                self.deck_fell_m_s = max(self.deck_fell_m_s, float(truth.v_pad_ned[2]))
            if truth.phase in MOTORS_TURN:
                self.unreached_m = max(self.unreached_m, descent_m(self._unreached_at_m, at_m))
            return
        if self._unreached_at_m is not None:
            if self._lost_at_m is not None:
                height_m, altitude_m = (now - was for now, was in zip(at_m, self._unreached_at_m, strict=True))
                self._lost_at_m = self._lost_at_m[0] + height_m, self._lost_at_m[1] + altitude_m
            self._unreached_at_m = None
        blind_s = seconds_between(self._seen_at, truth.at)
        if not ours or blind_s <= BLIND_AFTER_S or truth.phase not in MOTORS_TURN:
            self._lost_at_m = None
            return
        if self._lost_at_m is None:
            self._lost_at_m = at_m
        came_down_m = descent_m(self._lost_at_m, at_m)
        if came_down_m > self.worst.descent_m:
            self.worst = BlindDescent(came_down_m, at_m[0], blind_s)


_HOP_M = 0.05
"""Height of the lowest foot from which on the vehicle has left the deck."""
_BOUNCE_MAX_M = 0.5
"""Height beyond which leaving the deck is a go-around and no bounce."""
_CLIMB_OUT_S = 1.0
"""Time that a vehicle needs to climb out of a deck's reach when it is reached again, or given back."""
_STOPPED_M_S = 0.5
"""Speed against the deck or over the ground below which a vehicle has stopped."""
_CARRIED_OUT_S, _LANDS_M_S = 20.0, 0.2
"""Time to carry out a person's order to land, and the slowest way down."""
_SEEN_S = 3.0
"""Time after the newest true sight of the pad for which a landing that a person ordered can still be flown by it."""
_GONE_S = 10.0
"""Time without true sight from which on nobody can count on it with the last charge."""
_PLACE_M, _LOST_M_S = 0.5, 0.1
"""Distance from the pad's centre that is on it, and how fast a velocity loses an unseen pad."""


class Count(Struct):
    """One count of a flight."""

    limit: CountLimit
    value: float = 0.0
    most: float = math.inf
    """The limit under the one who decided when it had this value."""
    facts: dict[str, object] = field(default_factory=dict)

    def note(self, value: float, whose: Decides, **facts: object) -> None:
        """Keep a value where it is the worst so far against its limit; nothing where it is not counted under who decides."""
        most = self.limit.most.get(whose) if value > 0.0 else None
        if most is not None and value - most > self.value - self.most:
            self.value, self.most, self.facts = value, most, facts

    @property
    def over(self) -> bool:
        return self.value > self.most

    def in_words(self) -> str:
        """Return the line for people."""
        return self.limit.words.format(value=self.value, most=self.most, **self.facts)


class Moment(NamedTuple):
    """The true state at an instant as the counts need it."""

    clearance_m: float
    """Height of the lowest foot over the deck's plane."""
    lowest_m: float
    """Height of the lowest part, feet or hull."""
    at_m: tuple[float, float]
    """The body's origin from the pad's centre along the deck: forward along the arrow, and to starboard of it."""
    tilt_deg: float
    """Tilt against the deck."""
    leaned_deg: float
    """Tilt against the horizon."""
    motors: bool
    over_deck: bool = True
    """False beside the ship, where nothing is at the height of the deck's plane."""

    @property
    def aside_m(self) -> float:
        """Distance of the body's origin from the pad's centre along the deck."""
        return math.hypot(*self.at_m)

    @property
    def stands(self) -> bool:
        """True if the lowest foot is on the deck."""
        return self.over_deck and abs(self.clearance_m) < ON_DECK_M


def moment_of(truth: Truth, feet: Feet) -> Moment:
    """Return the moment of a true state."""
    R_ned_pad, R_ned_body = truth.R_ned_pad.matrix, truth.R_ned_body.matrix
    R = R_ned_pad.T @ R_ned_body
    d = R_ned_pad.T @ (truth.p_body_ned - truth.p_pad_ned)
    clearance_m = -float((d[2] + feet.corners_m @ R[2]).max())
    top_m = -float(d[2] - feet.top_m * R[2, 2])
    tilt_deg, leaned_deg = (math.degrees(math.atan2(math.hypot(M[0, 2], M[1, 2]), M[2, 2])) for M in (R, R_ned_body))
    motors = truth.phase in MOTORS_TURN
    return Moment(clearance_m, min(clearance_m, top_m), (float(d[0]), float(d[1])), tilt_deg, leaned_deg, motors)


class Ordered(NamedTuple):
    """The true state when a person took over: what came of his order is measured from there."""

    at: MonoNs
    place_m: tuple[float, float]
    """On the deck, as `Moment.at_m`."""
    over_ned_m: tuple[float, float]
    """Place over the ground, m north and east."""
    height_m: tuple[float, float]
    """Height over the pad, and over the still water."""
    over_deck: bool
    stopped: bool = False
    """True once it has stopped; until then the places are the newest ones."""
    low: bool = False
    """True where he has held it low: for how long it stays there is his."""


class UnreachedContacts:
    """Notes the contacts that no order could prevent, because nothing reached the vehicle when it came down.

    A contact is one of them while nothing reaches the vehicle, for `_CLIMB_OUT_S` after that, and until a landing that the
    vehicle began meanwhile has ended.
    """

    def __init__(self) -> None:
        self.at: list[MonoNs] = []
        """Instants of these contacts."""
        self._count = 0
        self._until: MonoNs | None = None
        self._lands = False

    def step(self, truth: Truth, *, reached: bool) -> None:
        """Note the true state at an instant; call it in order of time."""
        if not reached:
            self._until = after(truth.at, _CLIMB_OUT_S)
        until = self._until
        self._lands |= truth.phase is VehiclePhase.LANDING and until is not None and truth.at <= until
        for contact in truth.contacts[self._count :]:
            lands = self._lands and contact.phase is VehiclePhase.LANDING
            if lands or (until is not None and contact.at <= until):
                self.at.append(contact.at)
        self._count = len(truth.contacts)
        self._lands &= truth.phase in (VehiclePhase.LANDING, VehiclePhase.LANDED)


class Referee:
    """Counts what hurts in one flight. Call `step` in order of time.

    Args:
        start: the first instant.
        errand: what the flight calls for.
        contact: what the vehicle bears.
        frame: the vehicle.
        disc_radius_m: of the pad.
        deck: the ship's deck about the pad; without one there is deck below every place near the pad.
    """

    def __init__(
        self,
        start: MonoNs,
        errand: Errand,
        contact: ContactSettings,
        frame: Airframe,
        disc_radius_m: float,
        deck: DeckShape | None = None,
    ) -> None:
        self.counts = {name: Count(limit) for name, limit in limits_of(errand, contact, frame).items()}
        self.sight = SightWatch(start)
        self.hands = HandsWatch(takes_off=errand.takes_off, held_to=errand.held_to)
        self.unreached = UnreachedContacts()
        self.highest_m = -math.inf
        """Highest height over the highest level of the pad so far, while the service flew."""
        self._errand, self._feet, self._disc_radius_m, self._deck = errand, frame.feet, disc_radius_m, deck
        self._contacts = self._bounced = self._touched = 0
        self._crest_m = -math.inf
        self._left_ned: tuple[float, float] | None = None
        """Place in which it was last as near to the pad as the flight calls for, m north and east."""
        self._farthest_m, self._called_m = errand.farthest_m, errand.highest_m
        """Farthest and highest place that the flight calls for, or to which a person has flown it by hand."""
        self._at, self._before = start, Moment(math.inf, math.inf, (0.0, 0.0), 0.0, 0.0, motors=False)
        self._was: tuple[Decides, tuple[str, ...]] = Decides.GUIDANCE, ()
        """The decider at the step before, and the conditions that held then."""
        self._lasted_s: dict[str, dict[Decides, float]] = defaultdict(lambda: defaultdict(float))
        self._charge: float | None = None
        self._hop_m: float | None = None
        """Height that it has reached since it left the deck; None before it touches it, and while that is not counted."""
        self._stood_m: tuple[tuple[float, float], tuple[float, float]] | None = None
        """Place where it came to stand: on the deck, as `Moment.at_m`, and over the ground, north and east."""
        self._ordered: Ordered | None = None
        self._given_back: MonoNs | None = None
        """Instant at which a person last gave it back within a deck's reach."""

    @property
    def unsafe(self) -> tuple[str, ...]:
        """One line for each count that is over its limit."""
        return tuple(count.in_words() for count in self.counts.values() if count.over)

    def as_json(self) -> dict[str, list[float]]:
        """Return each count that is not zero, beside its limit."""
        return {n: [round(c.value, 3), round(c.most, 3)] for n, c in self.counts.items() if c.value != 0.0}

    def died(self, why: str) -> None:
        """Note that the service died."""
        self.counts["died"].note(1, Decides.GUIDANCE, why=why)

    def hit(self, what: str) -> None:
        """Note that the vehicle met a thing that stood, lay or flew there."""
        count = self.counts["flew_into"]
        before = f"{count.facts['what']}; " if count.facts else ""
        count.note(count.value + 1, Decides.GUIDANCE, what=before + what)

    def frame(self, exposed_at: MonoNs, verdict: Verdict, *, true_view: bool, stamp_error_s: float) -> None:
        """Note a frame and whether it was used."""
        self.sight.frame(exposed_at, verdict, true_view=true_view, stamp_error_s=stamp_error_s)

    def step(self, truth: Truth, *, reached: bool, served: bool) -> None:
        """Note the true state at an instant.

        Args:
            reached: whether commands reach the vehicle.
            served: whether a service runs; without one nobody decides, and the vehicle hovers by itself.
        """
        m, dt_s = moment_of(truth, self._feet), max(0.0, seconds_between(self._at, truth.at))
        m = m._replace(over_deck=self._over_deck(m.at_m))
        self.hands.step(truth, reached=reached, served=served, on_deck=m.over_deck and m.clearance_m < 2 * ON_DECK_M)
        self.unreached.step(truth, reached=reached and served)
        whose = self._decides(truth, reached=reached and served)
        self.sight.step(truth, reached=reached, ours=whose is not Decides.CHARGE and not self.hands.hands_on)
        self._order(truth, m, whose)
        if self._was[0] is Decides.HAND and whose is Decides.GUIDANCE and m.clearance_m < KNEE_M:
            self._given_back = truth.at
        for contact in truth.contacts[self._contacts :]:
            self._touch(contact, self._touches_by(contact, whose))
        self._contacts = len(truth.contacts)
        self._time(truth, m, dt_s, whose)
        self._on_deck(truth, m, whose)
        if m.motors:
            self._note("turned_deg_s", abs(math.degrees(truth.w_body[2])), whose)
            if not m.stands:
                self._note("leaned_deg", m.leaned_deg, whose)
            if reached and served:
                self._way(truth, m, dt_s, whose)
            if self._ordered is not None:
                self._late(truth, self._ordered, whose)
        self._wires(whose)
        self._at, self._before = truth.at, m

    def _decides(self, truth: Truth, *, reached: bool) -> Decides:
        """Return who decides; with its last charge and long without sight, a vehicle of guidance can only come down."""
        whose = self.hands.decides(reached=reached)
        ends = truth.battery <= self._errand.last_charge and self.sight.seen_s(truth.at) > _GONE_S
        return Decides.CHARGE if whose is Decides.GUIDANCE and ends else whose

    def _note(self, name: str, value: float, whose: Decides, **facts: object) -> None:
        self.counts[name].note(value, whose, **facts)

    def _over_deck(self, at_m: tuple[float, float]) -> bool:
        """Return whether people may be below a place, as `Moment.at_m`."""
        if self._deck is not None:
            return self._deck.holds(*at_m)
        return math.hypot(*at_m) < self._errand.farthest_m + AWAY_M

    def _order(self, truth: Truth, m: Moment, whose: Decides) -> None:
        """Note where the vehicle was when a person took over; one that is to hold stops first."""
        if whose not in (Decides.HOLD, Decides.LANDING):
            self._ordered = None
            return
        since = self.hands.since
        was = self._ordered if self._ordered is not None and self._ordered.at == since else None
        if was is not None and was.stopped:
            return
        north, east, _ = truth.p_body_ned.tolist()
        v, w = truth.v_body_ned, truth.v_body_ned - truth.v_pad_ned
        stops = whose is Decides.HOLD and min(math.hypot(v[0], v[1]), math.hypot(w[0], w[1])) > _STOPPED_M_S
        stopped = not stops or seconds_between(since, truth.at) >= STOPS_S
        held_low = whose is Decides.HOLD and m.clearance_m < HELD_LOW_M
        heights, low = (heights_m(truth), held_low) if was is None else (was.height_m, was.low)
        self._ordered = Ordered(since, m.at_m, (north, east), heights, m.over_deck, stopped, low)

    def _touches_by(self, t: Touchdown, whose: Decides) -> Decides:
        """Return who brought it to a contact: who flew it by hand within a deck's reach, until it can have climbed from there."""
        given_at = self._given_back
        his = given_at is not None and seconds_between(given_at, t.at) <= _CLIMB_OUT_S
        return Decides.HAND if his and whose is Decides.GUIDANCE else whose

    def _touch(self, t: Touchdown, whose: Decides) -> None:
        """Judge a contact."""
        ordered = self._ordered if whose is Decides.LANDING else None
        if t.surface == "water":
            if ordered is None or ordered.over_deck:  # else he ordered it over the water
                self._note("in_water", 1, whose, lateral=t.lateral_m)
            return
        if self._errand.unreached_contacts and t.at in self.unreached.at:
            return
        if t.surface == "deck" and whose in self.counts["off_pad"].limit.most:
            self._note("off_pad", self.counts["off_pad"].value + 1, whose, lateral=t.lateral_m, over=t.over_rim_m)
        if ordered is not None and self.sight.seen_s(ordered.at) <= BLIND_AFTER_S and self.sight.seen_s(t.at) <= _SEEN_S:
            from_there_m = math.hypot(t.p_body_pad[0] - ordered.place_m[0], t.p_body_pad[1] - ordered.place_m[1])
            self._note("landed_aside_m", min(from_there_m, t.lateral_m), whose)
        unseen_s = self.sight.seen_s(t.at)
        within_m = _PLACE_M + _LOST_M_S * unseen_s
        self._note("landed_unseen", t.lateral_m / within_m, whose, lateral=t.lateral_m, unseen=unseen_s, within=within_m)
        if t.motors:
            self._touched += 1
            self._note("touches", self._touched, whose)
        self._note("into_deck_m_s", max(t.foot_speed_m_s, t.vertical_speed_m_s), whose, surface=t.surface)
        self._note("along_deck_m_s", t.lateral_speed_m_s if t.motors else 0.0, whose, surface=t.surface)
        self._note("contact_tilt_deg", math.degrees(t.tilt_rad), whose, surface=t.surface)

    def _time(self, truth: Truth, m: Moment, dt_s: float, whose: Decides) -> None:
        """Count for how long what must not last holds; what held at the step before held until now."""
        who, held = self._was
        if truth.battery <= ENDING and self._charge is None:
            self._charge = truth.battery
        gives_s = max(1.0, (self._charge or 0.0) * self._errand.battery_life_s)
        for name in held:
            self._lasted_s[name][who] += dt_s
            lasted_s = self._lasted_s[name][who]
            self._note(name, lasted_s / (gives_s if name == "ending_battery" else 1.0), who, flown=lasted_s, gives=gives_s)
        low = ON_DECK_M <= m.clearance_m < LOW_M and not (self._ordered is not None and self._ordered.low)
        holds = {
            "on_deck_s": m.stands,
            "low_outside_s": low and self._beside(m),
            "knee_outside_s": low and m.clearance_m < KNEE_M and self._beside(m),
            "low_over_pad_s": low and m.aside_m <= self._disc_radius_m,
            "ending_battery": 0.0 < truth.battery <= ENDING and m.clearance_m > ON_DECK_M,
            "empty_s": truth.battery <= 0.0 and not m.stands,
        }
        self._was = whose, tuple(name for name, on in holds.items() if on and m.motors)
        if not m.motors or m.clearance_m > _BOUNCE_MAX_M:
            self._lasted_s["on_deck_s"].clear()

    def _beside(self, m: Moment) -> bool:
        return m.aside_m > self._disc_radius_m and m.over_deck

    def _on_deck(self, truth: Truth, m: Moment, whose: Decides) -> None:
        """Count what happens on the deck: bounces, motors that stop over it, tipping over, sliding."""
        if self._before.motors and not m.motors:
            self._note("motors_off_m", m.clearance_m, whose)
        if m.over_deck and abs(m.lowest_m) < 2 * ON_DECK_M:
            self._note("tipped_deg", m.tilt_deg, whose)
        self._slides(truth, m, whose)
        if whose not in self.counts["bounces"].limit.most:
            self._hop_m = None
        elif m.motors and m.stands:
            if self._hop_m is not None and _HOP_M < self._hop_m <= _BOUNCE_MAX_M:
                self._bounced += 1
                self._note("bounces", self._bounced, whose)
            self._hop_m = 0.0
        elif self._hop_m is not None:
            self._hop_m = max(self._hop_m, m.clearance_m)

    def _slides(self, truth: Truth, m: Moment, whose: Decides) -> None:
        """Count how far it slides; an autopilot that holds over the ground leaves a deck under way to go on under it."""
        if m.clearance_m > _BOUNCE_MAX_M or whose not in self.counts["slid_m"].limit.most:
            self._stood_m = None
        elif m.stands:
            north, east, _ = truth.p_body_ned.tolist()
            on_deck_m, over_ned_m = self._stood_m = self._stood_m or (m.at_m, (north, east))
            slid_m = math.dist(m.at_m, on_deck_m)
            if whose is Decides.AUTOPILOT and m.motors:
                slid_m = min(slid_m, math.dist((north, east), over_ned_m))
            self._note("slid_m", slid_m, whose)

    def _way(self, truth: Truth, m: Moment, dt_s: float, whose: Decides) -> None:
        """Count where and how fast the vehicle flies."""
        d, v, p = truth.p_pad_ned - truth.p_body_ned, truth.v_pad_ned - truth.v_body_ned, truth.p_body_ned
        away_m = math.hypot(d[0], d[1])
        # Over the highest deck so far: a vehicle keeps clear of the crests, and over a trough it does not climb.
        self._crest_m = max(self._crest_m, -float(truth.p_pad_ned[2]))
        height_m = -float(p[2]) - self._crest_m
        if whose is Decides.HAND:
            self._farthest_m, self._called_m = max(self._farthest_m, away_m), max(self._called_m, height_m)
        elif whose in OURS:
            self.highest_m = max(self.highest_m, height_m)
        against_ship_m_s, over_ground_m_s = math.hypot(v[0], v[1]), math.hypot(*truth.v_body_ned[:2].tolist())
        if away_m <= self._farthest_m or self._left_ned is None:
            self._left_ned = float(p[0]), float(p[1])
        elif against_ship_m_s < over_ground_m_s:
            # It stays with the ship, and so does that place.
            north, east = truth.v_pad_ned[:2].tolist()
            self._left_ned = self._left_ned[0] + dt_s * north, self._left_ned[1] + dt_s * east
        self._note("high_m", height_m - (self._called_m - self._errand.highest_m), whose, called=self._errand.highest_m)
        takes_over = whose in (Decides.HOLD, Decides.HAND) and seconds_between(self.hands.since, truth.at) < STOPS_S
        # A ship that goes on leaves a vehicle behind that hovers over the ground: that is neither a flight away nor a speed.
        # In its own hover it drifts with the wind, and no order of ours flies it there.
        if truth.phase is VehiclePhase.HOVERING or takes_over:
            return
        left_m = math.hypot(p[0] - self._left_ned[0], p[1] - self._left_ned[1])
        self._note("away_m", min(away_m, self._farthest_m + left_m) - (self._farthest_m - self._errand.farthest_m), whose)
        self._note("fast_m_s", min(against_ship_m_s, over_ground_m_s), whose)
        if (was := self._ordered) is not None and was.stopped:
            self._stays(truth, m, was, whose)

    def _stays(self, truth: Truth, m: Moment, was: Ordered, whose: Decides) -> None:
        """Count how far a vehicle goes that a person holds, or that is to land where he ordered it or on the pad."""
        north, east, _ = truth.p_body_ned.tolist()
        what = self.hands.act
        from_deck_m = math.hypot(m.at_m[0] - was.place_m[0], m.at_m[1] - was.place_m[1])
        from_ground_m = math.hypot(north - was.over_ned_m[0], east - was.over_ned_m[1])
        strayed_m = min(from_deck_m, from_ground_m)
        self._note("strayed_m", min(strayed_m, m.aside_m) if whose is Decides.LANDING else strayed_m, whose, what=what)
        rose_m = -descent_m(was.height_m, heights_m(truth))
        clear_m = 0.0 if whose is Decides.LANDING else max(0.0, self._errand.safe_m - was.height_m[0])
        self._note("rose_m", rose_m - clear_m, whose, what=what)

    def _late(self, truth: Truth, was: Ordered, whose: Decides) -> None:
        """Count how long a vehicle flies that a person has ordered to land, as a share of the time that it may take."""
        over_pad_m, over_water_m = was.height_m
        flown_s = seconds_between(was.at, truth.at)
        allowed_s = _CARRIED_OUT_S + max(over_pad_m, 0.0 if was.over_deck else over_water_m) / _LANDS_M_S
        self._note("lands_late", flown_s / allowed_s, whose, flown=flown_s)

    def _wires(self, whose: Decides) -> None:
        """Take over what the watches of sight and hands have found."""
        worst, hands = self.sight.worst, self.hands
        self._note("blind_m", worst.descent_m, Decides.GUIDANCE, lowest=worst.lowest_m, blind=worst.blind_s)
        falls_m = self._errand.unreached_m[1] * self.sight.deck_fell_m_s
        self._note("unreached_m", self.sight.unreached_m - falls_m, whose)
        self._note("disobeyed_s", hands.late_s, whose, what=hands.disobeyed)
        self._note("held_sank_m", hands.sank_m, Decides.HOLD)
        self._note("unordered", len(hands.unordered), whose, what="; ".join(hands.unordered))


def unsafe_contacts(contacts: Sequence[Touchdown], contact: ContactSettings, frame: Airframe) -> tuple[str, ...]:
    """Return what was unsafe about the contacts of a flight that was not watched, one line each."""
    referee = Referee(MonoNs(0), Errand(math.inf, math.inf, math.inf), contact, frame, math.inf)
    for one in contacts:
        referee._touch(one, Decides.GUIDANCE)
    return referee.unsafe
