"""How a simulated flight ended, for people, for machines and for its report."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

from companion.pilot import Outcome
from companion.report.flight_log import FlightLog
from companion.report.flight_log import Touchdown as LoggedTouchdown
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs


@dataclass(frozen=True, slots=True)
class Contact:
    """The first contact after flight, as only the simulator knows it."""

    at: MonoNs
    surface: str
    on_pad: bool
    lateral_m: float
    yaw_rad: float
    vertical_speed_m_s: float
    lateral_speed_m_s: float


@dataclass(frozen=True, slots=True)
class Ending:
    """How it ended."""

    scenario: str
    seed: int
    outcome: Outcome | None
    """As the pilot saw it; None when the time ran out."""
    contact: Contact | None
    duration_s: float
    frames: Counter[Verdict]

    @property
    def on_pad(self) -> bool:
        """The goal: the pilot says landed, and the simulator says on the pad."""
        return self.outcome is Outcome.LANDED and self.contact is not None and self.contact.on_pad

    @property
    def word(self) -> str:
        """The outcome, or that time ran out."""
        return "time ran out" if self.outcome is None else self.outcome.value

    def as_json(self) -> dict[str, Any]:
        """Plain values; lengths in m, speeds in m/s, angles in degrees."""
        contact = None
        if self.contact is not None:
            c = self.contact
            contact = {
                "surface": c.surface,
                "on_pad": c.on_pad,
                "lateral_m": round(c.lateral_m, 4),
                "yaw_deg": round(math.degrees(c.yaw_rad), 2),
                "vertical_speed_m_s": round(c.vertical_speed_m_s, 4),
                "lateral_speed_m_s": round(c.lateral_speed_m_s, 4),
            }
        return {
            "scenario": self.scenario,
            "seed": self.seed,
            "landed_on_pad": self.on_pad,
            "outcome": self.word,
            "duration_s": round(self.duration_s, 3),
            "touchdown": contact,
            "frames": {verdict.value: n for verdict, n in sorted(self.frames.items(), key=lambda item: item[0].value)},
        }

    def in_words(self) -> str:
        """One or two lines."""
        if self.contact is None:
            return f"{self.word} after {self.duration_s:.1f} s, without touching anything"
        c = self.contact
        where = "on the pad" if c.on_pad else ("on deck, off the pad" if c.surface == "deck" else "in the water")
        return (
            f"{self.word} after {self.duration_s:.1f} s, {where}: {100 * c.lateral_m:.1f} cm from its centre, "
            f"sinking at {c.vertical_speed_m_s:.2f} m/s, sliding at {c.lateral_speed_m_s:.2f} m/s"
        )

    def write_into(self, log: FlightLog) -> None:
        """Outcome, touchdown and verdicts for the report."""
        log.outcome = self.word
        log.verdicts = Counter(self.frames)
        if self.contact is not None:
            c = self.contact
            log.touchdown = LoggedTouchdown(c.at, c.lateral_m, c.vertical_speed_m_s, c.lateral_speed_m_s, c.on_pad)
