"""The ending of a simulated flight, as text, as JSON and for its report, and the load of a machine too slow to fly it."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from companion.base.mission import FlightOutcome
from companion.tools.report.flight_log import FlightLog, LoggedContact
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs, seconds_between
from sitl.flight.afterwards import Aftermath, Standing

STOOD_STILL_MAX_S = 1.0
FILMED_MIN, REPLACED_MAX, SKIPPED_MAX, NO_ATTITUDE_MAX = 0.5, 0.4, 0.7, 0.15
"""Limits on shares of a flight's frames: rendered in time, replaced before vision processed them, left out by vision to keep its
share of a core, without an attitude since the samples came late."""
GUIDANCE_LATE_MAX_S = 0.02
"""Limit on the median delay of guidance cycles: one period of the shipped settings, at which guidance runs at half its rate."""
_FRAMES_HZ = 30.0


@dataclass(frozen=True, slots=True)
class Load:
    """The load of the machine during a flight in real time."""

    duration_s: float
    frames_sent: int
    """Number of frames that the simulated drone rendered and sent."""
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
        filmed = self.frames_sent / max(1.0, _FRAMES_HZ * self.duration_s)
        if filmed < FILMED_MIN:
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


_ZERO = MonoNs(0)
_WHERE = {"pad": "on the pad", "deck": "on deck, off the pad", "water": "in the water"}
_OVER_RIM = "over the pad's rim"


@dataclass(frozen=True, slots=True)
class Contact:
    """A contact with a surface after flight, from the simulator's truth."""

    at: MonoNs
    surface: str
    """Surface that was touched: pad, deck or water."""
    lateral_m: float
    yaw_rad: float
    vertical_speed_m_s: float
    lateral_speed_m_s: float
    vehicle_phase: str | None = None
    """The vehicle's phase just before the contact."""
    motors: bool | None = None
    """True if its motors were turning."""
    phase: str | None = None
    """Phase of guidance just before the contact."""
    p_pad_m: tuple[float, float] | None = None
    """Position on the pad: along the arrow, and to starboard of it; None if it is not known."""
    centre_on_pad: bool = False
    """True if the body's origin is over the pad, whatever its feet are."""
    tilt_rad: float = 0.0
    over_rim_m: float = 0.0
    foot_speed_m_s: float = 0.0
    """Tilt, farthest foot beyond the rim and closing speed of the fastest foot, as of `sitl.world.truth.Touchdown`."""

    @property
    def on_pad(self) -> bool:
        """True if all feet were over the pad."""
        return self.surface == "pad"


@dataclass(frozen=True, slots=True)
class FlightGrade:
    """The simulator's grade of a whole flight."""

    grade: str
    """Grade: on pad, refused rightly or failed."""
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


@dataclass(frozen=True, slots=True)
class Ending:
    """The ending of a flight."""

    scenario: str
    seed: int
    outcome: FlightOutcome | None
    """Outcome in the pilot's eyes; None if the flight ended without one, as `without_outcome` says."""
    contacts: tuple[Contact, ...]
    duration_s: float
    frames: Counter[Verdict]
    started: MonoNs = _ZERO
    judged: FlightGrade | None = None
    load: Load | None = None
    """The load of the machine; None for a flight in virtual time."""
    without_outcome: str = "time ran out"
    wrong_model: Mapping[str, float] = field(default_factory=dict)
    """Differences of the vehicle from its model."""
    standing: Standing | None = None
    """Place of the vehicle 5 s after the contact; None if it does not stand, or if nobody looked."""
    aftermath: Aftermath | None = None
    """Flight after the outcome; None if it was not in the air then, or if nobody looked."""

    @property
    def contact(self) -> Contact | None:
        """The newest contact, with which it landed; None without one."""
        return self.contacts[-1] if self.contacts else None

    @property
    def on_pad(self) -> bool:
        """True if the pilot reports a landing and the simulator's contact is on the pad."""
        return self.outcome is FlightOutcome.LANDED and self.contact is not None and self.contact.on_pad

    @property
    def good(self) -> bool:
        """True if it landed on the pad safely, or refused as its scenario expects."""
        return self.on_pad if self.judged is None else self.judged.grade != "failed"

    def followed(self, standing: Standing | None, aftermath: Aftermath | None, cpu_s: float) -> "Ending":
        """Return the ending with what came after the outcome, and the CPU time of both; a graded flight may fail by it."""
        judged = None if self.judged is None else replace(self.judged, cpu_s=cpu_s)
        unsafe = () if aftermath is None else aftermath.unsafe
        if judged is not None and aftermath is not None and math.isfinite(aftermath.at_most_m):
            judged = replace(judged, highest_m=round(aftermath.at_most_m, 3), counts=aftermath.counts)
        if judged is not None and unsafe:
            judged = replace(
                judged, grade="failed", because="; ".join((*judged.unsafe, *unsafe)), unsafe=(*judged.unsafe, *unsafe)
            )
        elif judged is not None and standing is not None and not standing.on_pad and judged.grade == "on pad":
            judged = replace(judged, grade="failed", because=standing.in_words())
        elif judged is not None and standing is None and judged.grade == "on pad":
            why = "it left the deck" if aftermath is None else f"it does not stand: {aftermath.in_words()}"
            judged = replace(judged, grade="failed", because=why)
        return replace(self, standing=standing, aftermath=aftermath, judged=judged)

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
            "refused": None,
            "duration_s": round(self.duration_s, 3),
            "touchdown": None if self.contact is None else _plain(self.contact),
            "standing": None if self.standing is None else self.standing.as_json(),
            "afterwards": None if self.aftermath is None else self.aftermath.as_json(),
            "contacts": [self._whole(contact) for contact in self.contacts],
            "contacts_outside_commit": None,
            "in_water": any(contact.surface == "water" for contact in self.contacts),
            **({} if self.load is None else {"machine_too_slow": self.load.starved()}),
            "frames": {verdict.value: n for verdict, n in sorted(self.frames.items(), key=lambda item: item[0].value)},
            "cpu_s": None,
            **({"wrong_model": dict(self.wrong_model)} if self.wrong_model else {}),
        }
        if self.judged is not None:
            j = self.judged
            out |= {
                "grade": j.grade,
                "because": j.because,
                "expect": j.expect,
                "refused": j.refused,
                "unsafe": list(j.unsafe),
                "lowest_blind_m": j.lowest_blind_m,
                "highest_m": j.highest_m,
                "contacts_outside_commit": j.contacts_outside_commit,
                "go_arounds": j.go_arounds,
                "faults": [{"kind": kind, "at_s": round(at_s, 3)} for kind, at_s in j.faults],
                "named": [{"text": said, "at_s": round(at_s, 3)} for said, at_s in j.named],
                "referee": dict(j.counts),
                "cpu_s": round(j.cpu_s, 2),
            }
        return out

    def in_words(self) -> str:
        """Return lines that say how it ended, name each further contact and unsafe act, and say if the machine was too slow."""
        lines = [f"{self.word} after {self.duration_s:.1f} s, without touching anything"]
        if self.contact is not None:
            lines = [f"{self.word} after {self.duration_s:.1f} s, {_in_words(self.contact)}"]
            lines += [
                f"before that, at {seconds_between(self.started, c.at):.1f} s, {_in_words(c)}"
                + ("" if c.phase is None else f" (guidance: {c.phase})")
                for c in self.contacts[:-1]
            ]
        lines += [part.in_words() for part in (self.standing, self.aftermath) if part is not None]
        if self.judged is not None:
            j = self.judged
            lines += [f"fault: {kind} from {at_s:.1f} s on" for kind, at_s in j.faults]
            lines += [f"named at {at_s:.1f} s: {said}" for said, at_s in j.named]
            lines += [f"refused: {j.refused}"] if j.refused else []
            lines += [f"UNSAFE: {line}" for line in j.unsafe]
            if j.grade == "failed" and not j.unsafe:
                lines.append(f"failed: {j.because}")
        if self.load is not None and not self.good and (slow := self.load.starved()) is not None:
            lines.append(f"this machine was too slow to fly in real time; the result means nothing: {slow}")
        return "\n".join(lines)

    def facts(self) -> list[tuple[str, str]]:
        """Return the simulator's facts for the report."""
        out = [(f"contact at {seconds_between(self.started, c.at):.1f} s", _in_words(c)) for c in self.contacts]
        if self.standing is not None:
            out.append(("standing", self.standing.in_words()))
        if self.aftermath is not None:
            out.append(("afterwards", self.aftermath.in_words()))
        if self.judged is not None:
            out += [("fault", f"{kind} from {at_s:.1f} s on") for kind, at_s in self.judged.faults]
            out += [("judged", f"{self.judged.grade}: {self.judged.because}")]
        return out

    def write_into(self, log: FlightLog) -> None:
        """Write outcome, contacts and verdicts into the log of the report."""
        log.outcome = self.word
        log.verdicts = Counter(self.frames)
        log.contacts = [
            LoggedContact(
                c.at,
                c.lateral_m,
                c.vertical_speed_m_s,
                c.lateral_speed_m_s,
                c.on_pad,
                c.surface,
                (math.nan, math.nan) if c.p_pad_m is None else c.p_pad_m,
                c.yaw_rad,
                c.phase,
            )
            for c in self.contacts
        ]

    def _whole(self, contact: Contact) -> dict[str, Any]:
        return {
            **_plain(contact),
            "at_s": round(seconds_between(self.started, contact.at), 3),
            "phase": contact.phase,
            "vehicle_phase": contact.vehicle_phase,
            "motors": contact.motors,
        }


def _plain(c: Contact) -> dict[str, Any]:
    return {
        "surface": c.surface,
        "on_pad": c.on_pad,
        "centre_on_pad": c.centre_on_pad,
        "lateral_m": round(c.lateral_m, 4),
        "p_pad_m": None if c.p_pad_m is None else [round(x, 4) for x in c.p_pad_m],
        "yaw_deg": round(math.degrees(c.yaw_rad), 2),
        "vertical_speed_m_s": round(c.vertical_speed_m_s, 4),
        "lateral_speed_m_s": round(c.lateral_speed_m_s, 4),
        "foot_speed_m_s": round(c.foot_speed_m_s, 4),
        "tilt_deg": round(math.degrees(c.tilt_rad), 2),
        "over_rim_m": round(c.over_rim_m, 4),
    }


def _in_words(c: Contact) -> str:
    return (
        f"{_OVER_RIM if c.centre_on_pad and not c.on_pad else _WHERE[c.surface]}: {100 * c.lateral_m:.1f} cm from its centre, "
        f"descending at {c.vertical_speed_m_s:.2f} m/s, sliding at {c.lateral_speed_m_s:.2f} m/s"
    )
