"""The limits of the referee: one table of what is watched, and the most that it may be under each who decides."""

from collections.abc import Mapping
from typing import NamedTuple

from estimator.contracts.motion import G_M_S2
from sitl.flight.hands import OBEYED_S, Decides
from sitl.vehicle.airframe import Airframe, ContactSettings

ON_DECK_M = 0.03
"""Height of the lowest foot over the deck up to which the vehicle stands on it: uneven feet, and springs that give."""
LOW_M, KNEE_M = 1.0, 0.5
"""Heights of the lowest foot under which a rotor reaches a person who kneels or an object that stands there, and his feet."""
HELD_LOW_M = LOW_M + 0.5
"""Height of the lowest foot at a hold up to which the stop may bring the vehicle below `LOW_M`."""
AWAY_M = 20.0
"""The length of a small ship, within which a person sees and reaches a vehicle."""
ENDING = 0.1
"""Charge of a battery that ends."""
STOPS_S = 4.0
"""Time in which a vehicle stops that a person holds, or takes into his hand, out of its fastest flight."""

_G, _HOLD, _HAND, _LANDING, _NOBODY = Decides.GUIDANCE, Decides.HOLD, Decides.HAND, Decides.LANDING, Decides.NOBODY
_CHARGE = Decides.CHARGE
OURS = (_G, _HOLD, _HAND, _LANDING, _CHARGE)
"""Deciders whose wishes the service carries out."""
_AIR = (*OURS, _NOBODY, Decides.AUTOPILOT, Decides.AUTOPILOT_LANDS)
_DECK = (*OURS, _NOBODY, Decides.AUTOPILOT)
"""An autopilot that lands by itself meets a deck that goes on: where and how is nobody's fault here."""
EVERYBODY = tuple(Decides)


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
    """Contacts, sliding and low flight are excused that no order could prevent, because nothing reached the vehicle."""
    battery_life_s: float = 1200.0
    """Flight time of a full battery."""
    safe_m: float = 3.0
    """Height over the pad to which a held vehicle climbs by itself."""
    by_hand_m_s: float = 1.0
    """Horizontal speed of a full stick."""
    held_to: float = 0.0
    """Charge up to which a held drone stays held: then the end begins that the person has chosen beforehand. 0: there is none."""
    last_charge: float = 0.0
    """Charge with which it comes down without sight rather than fall. 0: there is none."""


class CountLimit(NamedTuple):
    """The most that a count may be."""

    most: Mapping[Decides, float]
    """The limit under each who decides; under others it is not counted."""
    words: str
    """The line for people: {value}, {most}, and what the count notes beside its value."""
    source: str


def _each(most: float, *whose: Decides) -> dict[Decides, float]:
    return dict.fromkeys(whose, most)


def limits_of(errand: Errand, contact: ContactSettings, frame: Airframe) -> dict[str, CountLimit]:
    """Return the limit of each count.

    A person with the sticks answers for place and speed, and one who holds it low for the time that it stays so. Hard, tilted or
    wet contacts, turning over and motors that stop in the air count whoever has it, but for one who stopped them himself. The
    last charge without sight excuses the blind descent and the place beside the pad, as far as a velocity loses the pad.
    """
    c = contact
    tilt_deg = frame.contact_tilt_deg(c.into_deck_max_m_s) if c.tilt_max_deg is None else c.tilt_max_deg
    drop_m = c.into_deck_max_m_s**2 / (2.0 * G_M_S2)
    excused = errand.unreached_contacts
    low_alone = {} if excused else _each(5.0, _NOBODY)
    fast_m_s, afar_m = errand.fastest_m_s + 3.0, errand.farthest_m + AWAY_M
    return {
        "died": CountLimit(_each(0, *EVERYBODY), "the service died in flight: {why}", "nobody flies then"),
        "blind_m": CountLimit(
            _each(0.5, _G),
            "came down {value:.2f} m, to {lowest:.2f} m over the deck, without true sight of the pad for {blind:.1f} s",
            "what wind and the vehicle's own landing cause",
        ),
        "unreached_m": CountLimit(
            _each(errand.unreached_m[0], *EVERYBODY), "came down {value:.2f} m while nothing reached it",
            "the fastest way down until the vehicle's own timeout, and 0.3 m to stop",
        ),
        "in_water": CountLimit(_each(0, *_DECK), "in the water, {lateral:.2f} m from the pad's centre", "it is lost"),
        "off_pad": CountLimit(
            _each(0, _G, _HOLD, _NOBODY),
            "touched the deck {lateral:.2f} m from the pad's centre, a foot {over:.2f} m over the rim, {value:.0f} times so",
            "people and things stand beside a pad",
        ),
        "landed_aside_m": CountLimit(
            _each(0.5, _LANDING), "ordered to land in sight of the pad, it touched {value:.2f} m from there and from the pad",
            "the pad's own size",
        ),
        "landed_unseen": CountLimit(
            _each(1.0, _CHARGE),
            "touched {lateral:.1f} m from the pad, unseen for {unseen:.0f} s, where {within:.1f} m are the most",
            "the pad's own size, and a velocity that is 0.1 m/s off",
        ),
        "into_deck_m_s": CountLimit(
            _each(c.into_deck_max_m_s, *_DECK), "a foot struck the {surface} at {value:.2f} m/s, where {most:g} m/s is the most",
            "the vehicle's file",
        ),
        "along_deck_m_s": CountLimit(
            _each(c.along_deck_max_m_s, _G, _HOLD, _LANDING, _CHARGE, _NOBODY),
            "touched the {surface} at {value:.2f} m/s along it", "the vehicle's file",
        ),
        "contact_tilt_deg": CountLimit(
            _each(tilt_deg, *_DECK), "touched the {surface} tilted by {value:.0f} degrees, where {most:.0f} are the most",
            "the vehicle's file: beyond it a rotor touches while the feet give, or it falls over",
        ),
        "tipped_deg": CountLimit(
            _each(frame.falls_deg, *_DECK), "tipped over on the deck: {value:.0f} degrees", "static, from feet, height and rotors"
        ),
        "bounces": CountLimit(
            _each(2, _G, _HOLD, _LANDING, _CHARGE, _NOBODY), "bounced {value:.0f} times",
            "FAA-H-8083-3C, chapter 9: one who bounces twice goes around",
        ),
        "touches": CountLimit(
            _each(5, _G, _HOLD, _LANDING, _CHARGE), "touched the deck {value:.0f} times", "three attempts, and two bounces"
        ),
        "slid_m": CountLimit(
            _each(1.0, _G, _HOLD, _LANDING, _CHARGE, Decides.AUTOPILOT) | ({} if excused else _each(1.0, _NOBODY)),
            "slid {value:.1f} m over the deck", "a pad's width, and more than any pad has around it",
        ),
        "motors_off_m": CountLimit(
            _each(drop_m, *_AIR), "the motors stopped {value:.2f} m over the deck, where {most:.2f} m are the most",
            "the drop to the most speed into the deck",
        ),
        "on_deck_s": CountLimit(
            _each(3.0, _G, _LANDING, _CHARGE) | _each(10.0, _HOLD, _HAND),
            "stood on the deck for {value:.1f} s with turning motors",
            "several times what pressing on and a landing take; a person needs the time to decide",
        ),
        "low_outside_s": CountLimit(
            _each(5.0, _G) | _each(10.0, _LANDING, _CHARGE) | _each(60.0, _HOLD) | low_alone,
            "flew lower than 1 m beside the pad for {value:.1f} s",
            "twice a climb of 1 m at 0.5 m/s, and as much to decide; who holds it there sees who stands there",
        ),
        "knee_outside_s": CountLimit(
            _each(3.0, _G) | _each(6.0, _LANDING, _CHARGE) | _each(30.0, _HOLD) | low_alone,
            "flew lower than 0.5 m beside the pad for {value:.1f} s", "half of that",
        ),
        "low_over_pad_s": CountLimit(
            _each(120.0, _G, _HOLD, _LANDING, _CHARGE), "flew lower than 1 m over the pad for {value:.0f} s",
            "clean flights waited up to 109 s at the gate for a quiet deck (weather_4, seed 896010)",
        ),
        "turned_deg_s": CountLimit(
            _each(180.0, *_AIR), "turned at {value:.0f} degrees/s with its motors", "beyond any turn that is commanded"
        ),
        "leaned_deg": CountLimit(
            _each(75.0, *_AIR), "leaned {value:.0f} degrees in the air", "beyond the most that any law commands, 60, and a gust"
        ),
        "away_m": CountLimit(
            _each(afar_m, _G, _CHARGE), "flew {value:.0f} m away from the pad, where {most:.0f} m are the most",
            "the length of a small ship",
        ),
        "fast_m_s": CountLimit(
            _each(fast_m_s, _G, _LANDING, _CHARGE) | _each(3.0, _HOLD) | _each(errand.by_hand_m_s + 3.0, _HAND),
            "flew at {value:.1f} m/s, where {most:.1f} m/s are the most", "a gust of three standard deviations of a Beaufort 6",
        ),
        "high_m": CountLimit(
            _each(errand.highest_m + 3.0, _G, _HOLD, _LANDING, _CHARGE),
            "flew {value:.1f} m high, where {called:.1f} m are the most that is called for", "gusts do not carry a vehicle there",
        ),
        "strayed_m": CountLimit(
            _each(5.0, _HOLD, _LANDING), "a person ordered {what}, and it flew {value:.1f} m away from there",
            "twice the way to a stop out of the fastest flight",
        ),
        "rose_m": CountLimit(
            _each(3.0, _HOLD, _LANDING), "a person ordered {what}, and it climbed {value:.1f} m beyond what keeps it clear",
            "a swell that it keeps clear of",
        ),
        "held_sank_m": CountLimit(
            _each(0.5, _HOLD, _HAND), "a person kept it up, and it came down {value:.2f} m",
            "twice the way to a stop from 0.7 m/s",
        ),
        "lands_late": CountLimit(
            _each(1.0, _LANDING), "a person ordered land, and {flown:.0f} s later it still flew",
            "the way down at 0.2 m/s, and 20 s for whoever carries it out",
        ),
        "ending_battery": CountLimit(
            _each(0.5, _G, _CHARGE), "flew for {flown:.0f} s with a battery that gives {gives:.0f} s",
            "half of what is left, as a reserve",
        ),
        "empty_s": CountLimit(_each(1.0, *EVERYBODY), "flew for {value:.0f} s with an empty battery", "nothing flies with it"),
        "disobeyed_s": CountLimit(
            _each(OBEYED_S, *EVERYBODY), "a person ordered {what}, still {value:.1f} s later", "a person's own time of reaction"
        ),
        "unordered": CountLimit(_each(0, *EVERYBODY), "nobody ordered it: {what}", "the person's hand wins"),
        "flew_into": CountLimit(_each(0, *EVERYBODY), "{what}", "the thing is hit"),
    }  # fmt: skip
