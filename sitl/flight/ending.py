"""The ending of a simulated flight, as text, as JSON and for its report, its grade, and the load of a machine too slow to fly it.

A flight is graded by what its scenario expects, and what the referee found.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from typing import Any, NamedTuple

from msgspec import Struct, field, structs

from companion.base.mission import CONTACT_INTENDED, REFUSALS, FlightOutcome
from companion.guidance.operator.arbiter import BY_HAND
from companion.tools.report.flight_log import FlightLog, LoggedContact
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs, seconds_between
from sitl.world.truth import Touchdown


class Standing(Struct, frozen=True):
    """The place of a vehicle on the deck some seconds after its contact."""

    after_s: float
    """Time since the contact."""
    on_pad: bool
    """True if all feet are over the pad's disc."""
    centre_on_pad: bool
    """True if the body's origin is."""
    lateral_m: float
    """Distance of the body's origin from the pad's centre, along the deck."""
    p_pad_m: tuple[float, float]
    """Position on the pad: along the arrow, and to starboard of it."""
    yaw_rad: float
    """Heading against the arrow, clockwise from above."""
    slid_m: float
    """Distance from the place of the contact."""

    def as_json(self) -> dict[str, Any]:
        """Return plain values: m, degrees, s."""
        return {
            "on_pad": self.on_pad,
            "centre_on_pad": self.centre_on_pad,
            "lateral_m": round(self.lateral_m, 4),
            "p_pad_m": [round(x, 4) for x in self.p_pad_m],
            "yaw_deg": round(math.degrees(self.yaw_rad), 2),
            "slid_m": round(self.slid_m, 4),
            "after_s": round(self.after_s, 2),
        }

    def in_words(self) -> str:
        """Return one line for people."""
        beside = "" if self.on_pad else ", a foot over the rim" if self.centre_on_pad else ", off the pad"
        return f"stands {100 * self.lateral_m:.1f} cm from the pad's centre, {100 * self.slid_m:.1f} cm from its contact{beside}"


class Aftermath(Struct, frozen=True):
    """Flight of a vehicle that was in the air at the outcome."""

    watched_s: float
    phase: str | None
    """Phase of guidance at the end; None without a service."""
    vehicle_phase: str
    lowest_m: float
    """Lowest height over the pad."""
    highest_m: float
    farthest_m: float
    """Largest horizontal distance from the pad's centre, and that at the end."""
    end_m: float
    contacts: int
    """Number of contacts, with deck or water."""
    in_water: bool
    unsafe: tuple[str, ...]
    """Unsafe events after the outcome, one line each."""

    def as_json(self) -> dict[str, Any]:
        """Return plain values: m and s."""
        lengths = {name: round(getattr(self, name), 2) for name in ("lowest_m", "highest_m", "farthest_m", "end_m")}
        return {
            "watched_s": round(self.watched_s, 2),
            "phase": self.phase,
            "vehicle_phase": self.vehicle_phase,
            **lengths,
            "contacts": self.contacts,
            "in_water": self.in_water,
            "unsafe": list(self.unsafe),
        }

    def in_words(self) -> str:
        """Return one line for people."""
        touched = "in the water" if self.in_water else f"{self.contacts} contacts" if self.contacts else "no contact"
        return (
            f"{self.watched_s:.0f} s later: {self.vehicle_phase}, {self.end_m:.1f} m from the pad "
            f"({self.farthest_m:.1f} m at most), {self.lowest_m:.1f} m over it at the lowest, {touched}"
        )


STOOD_STILL_MAX_S = 1.0
"""Time for which the simulator may not advance in a flight, all pauses together."""
FILMED_MIN, REPLACED_MAX, SKIPPED_MAX, NO_ATTITUDE_MAX = 0.5, 0.4, 0.7, 0.15
"""Limits on shares of a flight's frames: rendered in time, replaced before vision processed them, left out by vision to keep its
share of a core, without an attitude since the samples came late."""
GUIDANCE_LATE_MAX_S = 0.02
"""Limit on the median delay of guidance cycles: one period of the shipped settings, at which guidance runs at half its rate."""


class Load(Struct, frozen=True):
    """The load of the machine during a flight in real time."""

    frames_due: int
    """Number of frames that the simulated drone had to render, as somebody took its video."""
    frames_sent: int
    """Number of frames that it rendered and sent."""
    stood_still_s: float
    """Time in which the simulator did not advance, seconds."""
    frames: Counter[Verdict]
    """Number of received frames by verdict."""
    guidance_late_s: float | None = None
    """Median lateness of the guidance cycles, seconds; None if it was not measured."""

    def starved(self) -> str | None:
        """Return what shows that the machine was too slow, or None if it kept up."""
        output = []
        if self.stood_still_s > STOOD_STILL_MAX_S:
            output.append(f"the simulated drone stood still for {self.stood_still_s:.1f} s")
        if (filmed := self.frames_sent / max(1, self.frames_due)) < FILMED_MIN and self.frames_due:
            output.append(f"{filmed:.0%} of the frames were rendered in time")
        every = max(1, self.frames.total())
        if (share := self.frames[Verdict.REPLACED] / every) > REPLACED_MAX:
            output.append(f"{share:.0%} of the frames were overtaken by newer ones")
        if (share := self.frames[Verdict.SKIPPED] / every) > SKIPPED_MAX:
            output.append(f"{share:.0%} of the frames were skipped")
        if (share := self.frames[Verdict.NO_ATTITUDE] / every) > NO_ATTITUDE_MAX:
            output.append(f"{share:.0%} of the frames had no attitude")
        if self.guidance_late_s is not None and self.guidance_late_s > GUIDANCE_LATE_MAX_S:
            output.append(f"half of the guidance cycles came {1e3 * self.guidance_late_s:.0f} ms late or later")
        return "; ".join(output) or None


_INTENDED = frozenset({*(state.value for state in CONTACT_INTENDED), BY_HAND})


def outside_commit(contacts: Sequence[Touchdown]) -> int:
    """Return the number of contacts with turning motors in a phase of guidance that intends none, while no person commands."""
    return sum(bool(contact.motors) and contact.guidance_phase not in _INTENDED for contact in contacts)


class Grade(StrEnum):
    """The grade of a flight."""

    ON_PAD = "on pad"
    REFUSED_RIGHTLY = "refused rightly"
    FAILED = "failed"
    STARVED = "not judged: the machine was too slow"
    """Grade of a flight in real time that failed on a machine which was too slow for it."""


def on_pad_m(contacts: Sequence[Touchdown]) -> float | None:
    """Return the distance of the newest contact from the pad's centre, or None if it was not on the pad."""
    return contacts[-1].lateral_m if contacts and contacts[-1].on_pad else None


class AtEnd(NamedTuple):
    """The situation in which a flight ended."""

    left_alone: bool = False
    """There was no service or no link, so that nothing could be decided."""
    asks: bool = False
    """It hovered and waited for a person's decision about another pad, or to begin, which nobody makes in a simulation."""
    held: bool = False
    """A person held it, flew it, or had ended the landing."""
    theirs: str = ""
    """The newest act of a person that stands; empty without one."""
    go_arounds: int = 0
    """Number of go-arounds."""
    refusal: tuple[str, str] = ("", "")
    """Words that the reason of a refusal must hold, and the reason that it gave."""
    put_down: bool = False
    """It stands because it landed by itself while nothing reached it, and the scenario allows that."""


def grade(
    outcome: FlightOutcome | None, landed_m: float | None, unsafe: Sequence[str], expect: str, at_end: AtEnd | None = None
) -> tuple[Grade, str]:
    """Return the grade of a flight and the reason for it.

    Args:
        outcome: the pilot's outcome; None if the time ran out.
        landed_m: the result of `on_pad_m`.
        unsafe: the lines of the referee.
        expect: the outcome that the scenario expects, as its file says it.
        at_end: the situation in which it ended.
    """
    end = at_end or AtEnd()
    if unsafe:
        return Grade.FAILED, "; ".join(unsafe)
    # A service that was killed since knows of no act any more, but its outcome stands.
    if expect == "either" and (theirs := end.theirs or ("abort" if outcome is FlightOutcome.ABORTED else "")):
        return Grade.REFUSED_RIGHTLY, f"left to the person who ordered {theirs}"
    if expect == "hold":
        if end.held:
            return Grade.REFUSED_RIGHTLY, "held for the operator"
        return Grade.FAILED, f"did not hold for the operator: {'time ran out' if outcome is None else outcome.value}"
    if outcome is FlightOutcome.LANDED and landed_m is not None:
        if expect == "go_around" and not end.go_arounds:
            return Grade.FAILED, f"landed {100 * landed_m:.1f} cm from the centre without going around first"
        return Grade.ON_PAD, f"{100 * landed_m:.1f} cm from the centre"
    if end.put_down and outcome is FlightOutcome.LANDED_BY_OTHERS:
        return Grade.REFUSED_RIGHTLY, "landed by itself while nothing reached it"
    if outcome in REFUSALS or (outcome is None and (end.left_alone or end.asks)):
        output = "hovered without a service" if end.left_alone else "hovered and waited for the operator"
        if outcome is not None:
            output = outcome.value
        if expect in ("land", "go_around"):
            return Grade.FAILED, f"{output}, though nothing was wrong enough for that"
        if outcome in REFUSALS and end.refusal[0].lower() not in end.refusal[1].lower():
            return Grade.FAILED, f"{output} for another reason than {end.refusal[0]!r}: {end.refusal[1]}"
        return Grade.REFUSED_RIGHTLY, output
    return Grade.FAILED, "time ran out: it neither landed nor gave up" if outcome is None else outcome.value


_ZERO = MonoNs(0)
_WHERE = {"pad": "on the pad", "deck": "on deck, off the pad", "water": "in the water"}
_OVER_RIM = "over the pad's rim"


class FlightGrade(Struct, frozen=True):
    """The simulator's grade of a whole flight."""

    grade: Grade
    because: str
    unsafe: tuple[str, ...]
    refused: str | None
    """Reason why the pilot gave up; None if it did not."""
    contacts_outside_commit: int
    lowest_blind_m: float | None
    """Lowest height over the deck in its deepest descent without true sight of the pad; None where there was none."""
    go_arounds: int
    """Number of go-arounds."""
    faults: tuple[tuple[str, float], ...]
    """Faults that began: kind, and seconds after the start."""
    expect: str
    cpu_s: float
    highest_m: float | None = None
    """Highest height over the pad while guidance commanded, also after the outcome; None if it never did."""
    named: tuple[tuple[str, float], ...] = ()
    """The estimator's words on each sensor that it did not trust, and when they came first, in s after the start."""
    counts: Mapping[str, list[float]] = field(default_factory=dict)
    """Counts of the referee, each beside its limit."""

    def as_json(self) -> tuple[object, ...]:
        """Return plain values in the order of `_JUDGED`."""
        return (
            self.grade.value,
            self.because,
            self.expect,
            self.refused,
            list(self.unsafe),
            self.lowest_blind_m,
            self.highest_m,
            self.contacts_outside_commit,
            self.go_arounds,
            [{"kind": kind, "at_s": round(at_s, 3)} for kind, at_s in self.faults],
            [{"text": said, "at_s": round(at_s, 3)} for said, at_s in self.named],
            dict(self.counts),
            round(self.cpu_s, 2),
        )


_JUDGED = (
    "grade", "because", "expect", "refused", "unsafe", "lowest_blind_m", "highest_m", "contacts_outside_commit", "go_arounds",
    "faults", "named", "referee", "cpu_s",
)  # fmt: skip
"""Keys that are null where nobody judged the flight."""


class Ending(Struct, frozen=True):
    """The ending of a flight."""

    scenario: str
    seed: int
    outcome: FlightOutcome | None
    """Outcome in the pilot's eyes; None if the flight ended without one, as `without_outcome` says."""
    contacts: tuple[Touchdown, ...]
    duration_s: float
    frames: Counter[Verdict]
    started: MonoNs = _ZERO
    judged: FlightGrade | None = None
    load: Load | None = None
    """The load of the machine; None for a flight in virtual time."""
    troubles: tuple[str, ...] = ()
    """Failures between the service and its vehicle, one line each; empty for a flight without sockets."""
    without_outcome: str = "time ran out"
    wrong_model: Mapping[str, float] = field(default_factory=dict)
    """Differences of the vehicle from its model."""
    standing: Standing | None = None
    """Place of the vehicle 5 s after the contact; None if it does not stand, or if nobody looked."""
    aftermath: Aftermath | None = None
    """Flight after the outcome; None if it was not in the air then, or if nobody looked."""

    @property
    def contact(self) -> Touchdown | None:
        """The newest contact, with which it landed; None without one."""
        return self.contacts[-1] if self.contacts else None

    @property
    def on_pad(self) -> bool:
        """True if the pilot reports a landing and the simulator's contact is on the pad."""
        return self.outcome is FlightOutcome.LANDED and self.contact is not None and self.contact.on_pad

    @property
    def good(self) -> bool:
        """True if it landed on the pad safely, or refused as its scenario expects."""
        return self.on_pad if self.judged is None else self.judged.grade is not Grade.FAILED

    def followed(self, standing: Standing | None, aftermath: Aftermath | None, judged: FlightGrade | None) -> "Ending":
        """Return the ending with what came after the outcome, and the grade of both; one on the pad fails where it left it."""
        if judged is not None and judged.grade is Grade.ON_PAD and (standing is None or not standing.on_pad):
            why = "it left the deck" if aftermath is None else f"it does not stand: {aftermath.in_words()}"
            because = why if standing is None else standing.in_words()
            judged = structs.replace(judged, grade=Grade.FAILED, because=because)
        return structs.replace(self, standing=standing, aftermath=aftermath, judged=judged)

    @property
    def word(self) -> str:
        """The outcome in words, or why there is none."""
        return self.without_outcome if self.outcome is None else self.outcome.value

    def as_json(self) -> dict[str, Any]:
        """Return plain values; lengths in m, speeds in m/s, angles in degrees, times in s; None for what nobody judged."""
        out: dict[str, Any] = {
            "scenario": self.scenario,
            "seed": self.seed,
            "landed_on_pad": self.on_pad,
            "outcome": self.word,
            "duration_s": round(self.duration_s, 3),
            "touchdown": None if self.contact is None else _plain(self.contact),
            "standing": None if self.standing is None else self.standing.as_json(),
            "afterwards": None if self.aftermath is None else self.aftermath.as_json(),
            "contacts": [self._whole(contact) for contact in self.contacts],
            "in_water": any(contact.surface == "water" for contact in self.contacts),
            **({} if self.load is None else {"machine_too_slow": self.load.starved(), "troubles": list(self.troubles)}),
            "frames": {verdict.value: n for verdict, n in sorted(self.frames.items(), key=lambda item: item[0].value)},
            "wrong_model": dict(self.wrong_model),
            **dict.fromkeys(_JUDGED),
        }
        if self.judged is not None:
            out |= zip(_JUDGED, self.judged.as_json(), strict=True)
        return out

    def in_words(self) -> str:
        """Return lines that say how it ended, name each further contact and unsafe act, and say what kept it from flying."""
        lines = [f"{self.word} after {self.duration_s:.1f} s, without touching anything"]
        if self.contact is not None:
            # The vehicle reports its landing some time after the contact, from which the report's time counts too.
            landed = self.outcome is FlightOutcome.LANDED
            after_s = seconds_between(self.started, self.contact.at) if landed else self.duration_s
            lines = [f"{self.word} after {after_s:.1f} s, {_in_words(self.contact)}"]
            lines += [
                f"before that, at {seconds_between(self.started, c.at):.1f} s, {_in_words(c)}"
                + ("" if c.guidance_phase is None else f" (guidance: {c.guidance_phase})")
                for c in self.contacts[:-1]
            ]
        lines += [part.in_words() for part in (self.standing, self.aftermath) if part is not None]
        if self.judged is not None:
            j = self.judged
            lines += [f"fault: {kind} from {at_s:.1f} s on" for kind, at_s in j.faults]
            lines += [f"named at {at_s:.1f} s: {said}" for said, at_s in j.named]
            lines += [f"refused: {j.refused}"] if j.refused else []
            lines += [f"UNSAFE: {line}" for line in j.unsafe]
            if j.grade is Grade.FAILED and not j.unsafe:
                lines.append(f"failed: {j.because}")
        return "\n".join([*lines, *self._too_slow(), *self._troubles()])

    def _troubles(self) -> tuple[str, ...]:
        """Return what kept the service from its vehicle; nothing if it landed all the same."""
        return () if self.good else self.troubles

    def _too_slow(self) -> Iterator[str]:
        """Yield that the machine was too slow, and what the flight is worth; nothing if it kept up."""
        if self.load is not None and (slow := self.load.starved()) is not None:
            worth = "go-arounds and a wide landing may come of that" if self.good else "the result means nothing"
            yield f"this machine was too slow to fly in real time ({slow}): {worth}; decklander simulate needs no speed"

    def facts(self) -> list[tuple[str, str]]:
        """Return the simulator's facts for the report, what they are worth first."""
        out = [("warning", text) for text in (*self._troubles(), *self._too_slow())]
        out += [(f"contact at {seconds_between(self.started, c.at):.1f} s", _in_words(c)) for c in self.contacts]
        later = (("standing", self.standing), ("afterwards", self.aftermath))
        out += [(name, part.in_words()) for name, part in later if part is not None]
        if self.judged is not None:
            out += [("fault", f"{kind} from {at_s:.1f} s on") for kind, at_s in self.judged.faults]
            out += [("judged", f"{self.judged.grade.value}: {self.judged.because}")]
        return out

    def write_into(self, log: FlightLog) -> None:
        """Write outcome, start, contacts and verdicts into the log of the report."""
        log.outcome, log.started, log.verdicts = self.word, self.started, Counter(self.frames)
        log.contacts = [
            LoggedContact(
                c.at,
                c.lateral_m,
                c.vertical_speed_m_s,
                c.lateral_speed_m_s,
                c.on_pad,
                c.surface,
                (float(c.p_body_pad[0]), float(c.p_body_pad[1])),
                c.yaw_rad,
                c.guidance_phase,
            )
            for c in self.contacts
        ]

    def _whole(self, contact: Touchdown) -> dict[str, Any]:
        return {
            **_plain(contact),
            "at_s": round(seconds_between(self.started, contact.at), 3),
            "phase": contact.guidance_phase,
            "vehicle_phase": None if contact.phase is None else contact.phase.name.lower(),
            "motors": contact.motors,
        }


def _plain(c: Touchdown) -> dict[str, Any]:
    return {
        "surface": c.surface,
        "on_pad": c.on_pad,
        "centre_on_pad": c.centre_on_pad,
        "lateral_m": round(c.lateral_m, 4),
        "p_pad_m": [round(x, 4) for x in c.p_body_pad[:2].tolist()],
        "yaw_deg": round(math.degrees(c.yaw_rad), 2),
        "vertical_speed_m_s": round(c.vertical_speed_m_s, 4),
        "lateral_speed_m_s": round(c.lateral_speed_m_s, 4),
        "foot_speed_m_s": round(c.foot_speed_m_s, 4),
        "tilt_deg": round(math.degrees(c.tilt_rad), 2),
        "over_rim_m": round(c.over_rim_m, 4),
    }


def _in_words(c: Touchdown) -> str:
    return (
        f"{_OVER_RIM if c.centre_on_pad and not c.on_pad else _WHERE[c.surface]}: {100 * c.lateral_m:.1f} cm from its centre, "
        f"descending at {c.vertical_speed_m_s:.2f} m/s, sliding at {c.lateral_speed_m_s:.2f} m/s"
    )
