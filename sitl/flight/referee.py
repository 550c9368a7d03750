"""The referee of simulated flights: it counts what hurts, from the truth and from the wires alone, each count with a limit.

It takes the true motion of body, feet, deck and motors, the packets that were sent to the vehicle and the acts of a person with
their instants. It knows no state, phase or setting of guidance; what a flight calls for is given to it as figures (`Errand`).
"""

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from msgspec import Struct, field

from estimator.contracts.estimates import Verdict
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import MonoNs, after, seconds_between
from sitl.flight.hands import MOTORS_TURN, OBEYED_S, STAYS_UP, STOPS, HandsWatch, descent_m
from sitl.vehicle.airframe import Airframe, ContactSettings, Feet
from sitl.vehicle.vehicle import VehiclePhase
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
        at_m = float(truth.d_body_pad_level[2]), -float(truth.p_body_ned[2])
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


ON_DECK_M = 0.03
"""Height of the lowest foot over the deck up to which the vehicle stands on it: uneven feet, and springs that give."""
LOW_M = 1.0
"""Height of the lowest foot under which a rotor reaches a person who kneels or an object that stands there."""
LOW_WITHIN_M = 10.0
"""Distance from the pad within which there is deck under a low vehicle; beyond it is water, and `away` counts."""
ENDING = 0.1
"""Charge of a battery that ends."""
_HOP_M = 0.05
"""Height of the lowest foot from which on the vehicle has left the deck."""
_BOUNCE_MAX_M = 0.5
"""Height beyond which leaving the deck is a go-around and no bounce."""
_CLIMB_OUT_S = 1.0
"""Time that a vehicle needs to climb out of a deck's reach when it is reached again."""


class Errand(NamedTuple):
    """Figures that a flight calls for, by its scenario and the ordered way; the margins are those of the limits."""

    highest_m: float
    """Highest height over the pad at its highest."""
    farthest_m: float
    """Largest horizontal distance from the pad."""
    fastest_m_s: float
    """Largest horizontal speed against the ship."""
    unreached_m: tuple[float, float] = (0.3, 2.0)
    """Way down while nothing reaches the vehicle, and for how long a deck that falls at its beginning adds to it, s."""
    takes_off: bool = False
    unreached_contacts: bool = False
    """Contacts are excused that no order could prevent, because nothing reached the vehicle."""
    battery_life_s: float = 1200.0
    """Flight time of a full battery."""


class CountLimit(NamedTuple):
    """The most that a count may be."""

    most: float
    words: str
    """The line for people: {value}, {most}, and what the count notes beside its value."""
    source: str


def limits_of(errand: Errand, contact: ContactSettings, frame: Airframe) -> dict[str, CountLimit]:
    """Return the limit of each count."""
    c = contact
    tilt_deg = frame.contact_tilt_deg(c.into_deck_max_m_s) if c.tilt_max_deg is None else c.tilt_max_deg
    drop_m = c.into_deck_max_m_s**2 / (2.0 * G_M_S2)
    return {
        "died": CountLimit(0, "the service died in flight: {why}", "nobody flies then"),
        "blind_m": CountLimit(
            0.5, "came down {value:.2f} m, to {lowest:.2f} m over the deck, without true sight of the pad for {blind:.1f} s",
            "what wind and the vehicle's own landing cause",
        ),
        "unreached_m": CountLimit(
            errand.unreached_m[0], "came down {value:.2f} m while nothing reached it",
            "the fastest way down until the vehicle's own timeout, and 0.3 m to stop",
        ),
        "in_water": CountLimit(0, "in the water, {lateral:.2f} m from the pad's centre", "it is lost"),
        "off_pad": CountLimit(
            0, "touched the deck {lateral:.2f} m from the pad's centre, a foot {over:.2f} m over the rim, {value:.0f} times so",
            "people and things stand beside a pad",
        ),
        "into_deck_m_s": CountLimit(
            c.into_deck_max_m_s, "a foot struck the {surface} at {value:.2f} m/s, where {most:g} m/s is the most",
            "the vehicle's file",
        ),
        "along_deck_m_s": CountLimit(
            c.along_deck_max_m_s, "touched the {surface} at {value:.2f} m/s along it", "the vehicle's file"
        ),
        "contact_tilt_deg": CountLimit(
            tilt_deg, "touched the {surface} tilted by {value:.0f} degrees, where {most:.0f} are the most",
            "the vehicle's file: beyond it a rotor touches while the feet give, or it falls over",
        ),
        "tipped_deg": CountLimit(
            frame.falls_deg, "tipped over on the deck: {value:.0f} degrees", "static, from feet, height and rotors"
        ),
        "bounces": CountLimit(2, "bounced {value:.0f} times", "FAA-H-8083-3C, chapter 9: one who bounces twice goes around"),
        "motors_off_m": CountLimit(
            drop_m, "the motors stopped {value:.2f} m over the deck, where {most:.2f} m are the most",
            "the drop to the most speed into the deck",
        ),
        "on_deck_s": CountLimit(
            3.0, "stood on the deck for {value:.1f} s with turning motors", "several times what pressing on and a landing take"
        ),
        "low_outside_s": CountLimit(
            5.0, "flew lower than 1 m beside the pad for {value:.1f} s", "twice a climb of 1 m at 0.5 m/s, and as much to decide"
        ),
        "away_m": CountLimit(
            errand.farthest_m + 20.0, "flew {value:.0f} m away from the pad, where {most:.0f} m are the most",
            "the length of a small ship, within which a person sees and reaches it",
        ),
        "fast_m_s": CountLimit(
            errand.fastest_m_s + 3.0, "flew at {value:.1f} m/s, where {most:.1f} m/s are the most",
            "a gust of three standard deviations of a Beaufort 6",
        ),
        "high_m": CountLimit(
            errand.highest_m + 3.0, "flew {value:.1f} m high, where {called:.1f} m are the most that is called for",
            "gusts do not carry a vehicle there",
        ),
        "ending_battery": CountLimit(
            0.5, "flew for {flown:.0f} s with a battery that gives {gives:.0f} s", "half of what is left, as a reserve"
        ),
        "disobeyed_s": CountLimit(
            OBEYED_S, "a person ordered {what}, still {value:.1f} s later", "a person's own time of reaction"
        ),
        "held_sank_m": CountLimit(
            0.5, "a person kept it up, and it came down {value:.2f} m", "twice the way to a stop from 0.7 m/s"
        ),
        "unordered": CountLimit(0, "nobody ordered it: {what}", "the person's hand wins"),
        "flew_into": CountLimit(0, "{what}", "the thing is hit"),
    }  # fmt: skip


class Count(Struct):
    """One count of a flight."""

    limit: CountLimit
    value: float = 0.0
    facts: dict[str, object] = field(default_factory=dict)

    def note(self, value: float, **facts: object) -> None:
        """Keep a value where it is the worst so far."""
        if value > self.value:
            self.value, self.facts = value, facts

    @property
    def over(self) -> bool:
        return self.value > self.limit.most

    def in_words(self) -> str:
        """Return the line for people."""
        return self.limit.words.format(value=self.value, most=self.limit.most, **self.facts)


class Moment(NamedTuple):
    """The true state at an instant as the counts need it."""

    clearance_m: float
    """Height of the lowest foot over the deck's plane."""
    lowest_m: float
    """Height of the lowest part, feet or hull."""
    aside_m: float
    """Distance of the body's origin from the pad's centre along the deck."""
    tilt_deg: float
    """Tilt against the deck."""
    motors: bool


def moment_of(truth: Truth, feet: Feet) -> Moment:
    """Return the moment of a true state."""
    R_ned_pad = truth.R_ned_pad.matrix
    R = R_ned_pad.T @ truth.R_ned_body.matrix
    d = R_ned_pad.T @ (truth.p_body_ned - truth.p_pad_ned)
    clearance_m = -float((d + feet.corners_m @ R.T)[:, 2].max())
    top_m = -float(d[2] - feet.top_m * R[2, 2])
    tilt_deg = math.degrees(math.atan2(math.hypot(R[0, 2], R[1, 2]), R[2, 2]))
    return Moment(clearance_m, min(clearance_m, top_m), math.hypot(d[0], d[1]), tilt_deg, truth.phase in MOTORS_TURN)


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
    """

    def __init__(self, start: MonoNs, errand: Errand, contact: ContactSettings, frame: Airframe, disc_radius_m: float) -> None:
        self.counts = {name: Count(limit) for name, limit in limits_of(errand, contact, frame).items()}
        self.sight = SightWatch(start)
        self.hands = HandsWatch(takes_off=errand.takes_off)
        self.unreached = UnreachedContacts()
        self.highest_m = -math.inf
        """Highest height over the highest level of the pad so far, while the flight was ours."""
        self._errand, self._feet, self._disc_radius_m = errand, frame.feet, disc_radius_m
        self._contacts = self._bounced = 0
        self._crest_m = -math.inf
        self._left_ned: tuple[float, float] | None = None
        """Place in which it was last as near to the pad as the flight calls for, m north and east."""
        self._at, self._before = start, Moment(math.inf, math.inf, 0.0, 0.0, motors=False)
        self._was_standing = self._was_low = self._was_ending = False
        self._stood_s = self._low_s = self._flown_s = 0.0
        self._charge: float | None = None
        self._hop_m: float | None = None
        """Height that it has reached since it left the deck; None before it touches it, and while a person flies it."""

    @property
    def unsafe(self) -> tuple[str, ...]:
        """One line for each count that is over its limit."""
        return tuple(count.in_words() for count in self.counts.values() if count.over)

    def as_json(self) -> dict[str, list[float]]:
        """Return each count that is not zero, beside its limit."""
        return {n: [round(c.value, 3), round(c.limit.most, 3)] for n, c in self.counts.items() if c.value != 0.0}

    def died(self, why: str) -> None:
        """Note that the service died."""
        self.counts["died"].note(1, why=why)

    def hit(self, what: str) -> None:
        """Note that the vehicle met a thing that stood, lay or flew there."""
        count = self.counts["flew_into"]
        before = f"{count.facts['what']}; " if count.facts else ""
        count.note(count.value + 1, what=before + what)

    def frame(self, exposed_at: MonoNs, verdict: Verdict, *, true_view: bool, stamp_error_s: float) -> None:
        """Note a frame and whether it was used."""
        self.sight.frame(exposed_at, verdict, true_view=true_view, stamp_error_s=stamp_error_s)

    def step(self, truth: Truth, *, reached: bool, served: bool) -> None:
        """Note the true state at an instant.

        Args:
            reached: whether commands reach the vehicle.
            served: whether a service runs; without one nobody decides, and the vehicle hovers by itself.
        """
        moment, dt_s = moment_of(truth, self._feet), max(0.0, seconds_between(self._at, truth.at))
        self.hands.step(truth, reached=reached, served=served)
        self.sight.step(truth, reached=reached, ours=not self.hands.hands_on)
        self.unreached.step(truth, reached=reached and served)
        for contact in truth.contacts[self._contacts :]:
            self._touch(contact)
        self._contacts = len(truth.contacts)
        # What held at the step before held until now.
        self._deck(moment, dt_s)
        self._low_s += dt_s if self._was_low else 0.0
        self.counts["low_outside_s"].note(self._low_s)
        ours = reached and served and not self.hands.hands_on and moment.motors
        if ours:
            self._way(truth, dt_s)
        self._battery(truth, dt_s, hovers=ours and self.hands.act not in STAYS_UP and moment.clearance_m > ON_DECK_M)
        self._wires()
        self._was_standing = ours and abs(moment.clearance_m) < ON_DECK_M
        self._stood_s = self._stood_s if self._was_standing else 0.0
        self._was_low = ours and moment.clearance_m < LOW_M and self._disc_radius_m < moment.aside_m < LOW_WITHIN_M
        self._at, self._before = truth.at, moment

    def _touch(self, t: Touchdown) -> None:
        """Judge a contact."""
        if self.hands.hands_on:
            return
        if t.surface == "water":
            self.counts["in_water"].note(1, lateral=t.lateral_m)
            return
        if self._errand.unreached_contacts and t.at in self.unreached.at:
            return
        if t.surface == "deck":
            self.counts["off_pad"].note(self.counts["off_pad"].value + 1, lateral=t.lateral_m, over=t.over_rim_m)
        self.counts["into_deck_m_s"].note(max(t.foot_speed_m_s, t.vertical_speed_m_s), surface=t.surface)
        self.counts["along_deck_m_s"].note(t.lateral_speed_m_s if t.motors else 0.0, surface=t.surface)
        self.counts["contact_tilt_deg"].note(math.degrees(t.tilt_rad), surface=t.surface)

    def _deck(self, m: Moment, dt_s: float) -> None:
        """Count what happens on the deck: standing, bounces, motors that stop over it, tipping over."""
        self._stood_s += dt_s if self._was_standing else 0.0
        self.counts["on_deck_s"].note(self._stood_s)
        stands, person_cut = abs(m.clearance_m) < ON_DECK_M, self.hands.act in STOPS
        if self._before.motors and not m.motors and not person_cut:
            self.counts["motors_off_m"].note(m.clearance_m)
        if abs(m.lowest_m) < 2 * ON_DECK_M and not person_cut:
            self.counts["tipped_deg"].note(m.tilt_deg)
        if self.hands.hands_on:
            self._hop_m = None
        elif m.motors and stands:
            if self._hop_m is not None and _HOP_M < self._hop_m <= _BOUNCE_MAX_M:
                self._bounced += 1
                self.counts["bounces"].note(self._bounced)
            self._hop_m = 0.0
        elif self._hop_m is not None:
            self._hop_m = max(self._hop_m, m.clearance_m)

    def _way(self, truth: Truth, dt_s: float) -> None:
        """Count where and how fast the vehicle flies."""
        d, v, p = truth.p_pad_ned - truth.p_body_ned, truth.v_pad_ned - truth.v_body_ned, truth.p_body_ned
        away_m, farthest_m = math.hypot(d[0], d[1]), self._errand.farthest_m
        against_ship_m_s, over_ground_m_s = math.hypot(v[0], v[1]), math.hypot(*truth.v_body_ned[:2].tolist())
        if away_m <= farthest_m or self._left_ned is None:
            self._left_ned = float(p[0]), float(p[1])
        elif against_ship_m_s < over_ground_m_s:
            # It stays with the ship, and so does that place.
            north, east = truth.v_pad_ned[:2].tolist()
            self._left_ned = self._left_ned[0] + dt_s * north, self._left_ned[1] + dt_s * east
        # A ship that goes on leaves a vehicle behind that hovers over the ground: that is neither a flight away nor a speed.
        # In its own hover it drifts with the wind, and no order of ours flies it there.
        if truth.phase is not VehiclePhase.HOVERING:
            left_m = math.hypot(p[0] - self._left_ned[0], p[1] - self._left_ned[1])
            self.counts["away_m"].note(min(away_m, farthest_m + left_m))
            self.counts["fast_m_s"].note(min(against_ship_m_s, over_ground_m_s))
        # Over the highest deck so far: a vehicle keeps clear of the crests, and over a trough it does not climb.
        self._crest_m = max(self._crest_m, -float(truth.p_pad_ned[2]))
        self.highest_m = max(self.highest_m, -float(truth.p_body_ned[2]) - self._crest_m)
        self.counts["high_m"].note(self.highest_m, called=self._errand.highest_m)

    def _battery(self, truth: Truth, dt_s: float, *, hovers: bool) -> None:
        """Count the time in the air with a battery that ends."""
        self._flown_s += dt_s if self._was_ending else 0.0
        self._was_ending = hovers and truth.battery <= ENDING
        if self._was_ending and self._charge is None:
            self._charge = truth.battery
        gives_s = max(1.0, (self._charge or 0.0) * self._errand.battery_life_s)
        self.counts["ending_battery"].note(self._flown_s / gives_s, flown=self._flown_s, gives=gives_s)

    def _wires(self) -> None:
        """Take over what the watches of sight and hands have found."""
        worst, hands = self.sight.worst, self.hands
        self.counts["blind_m"].note(worst.descent_m, lowest=worst.lowest_m, blind=worst.blind_s)
        falls_m = self._errand.unreached_m[1] * self.sight.deck_fell_m_s
        self.counts["unreached_m"].note(self.sight.unreached_m - falls_m)
        self.counts["disobeyed_s"].note(hands.late_s, what=hands.disobeyed)
        self.counts["held_sank_m"].note(hands.sank_m)
        self.counts["unordered"].note(len(hands.unordered), what="; ".join(hands.unordered))


def unsafe_contacts(contacts: Sequence[Touchdown], contact: ContactSettings, frame: Airframe) -> tuple[str, ...]:
    """Return what was unsafe about the contacts of a flight that was not watched, one line each."""
    referee = Referee(MonoNs(0), Errand(math.inf, math.inf, math.inf), contact, frame, math.inf)
    for one in contacts:
        referee._touch(one)
    return referee.unsafe
