"""Why a flight failed, by rule: the first rule that fits names the cause."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable

from sitl.campaign.task import ERROR, Flight


def _unsafe(flight: Flight, begins: str) -> bool:
    return any(line.startswith(begins) for line in flight["unsafe"])


def _rest(flight: Flight) -> str:
    """Return why the pilot gave up, without the figures that differ from flight to flight."""
    return re.sub(r" (at|after|for) -?\d+(\.\d+)? \w+", "", str(flight["refused"] or "").partition(";")[0])


RULES: tuple[tuple[str, Callable[[Flight], bool]], ...] = (
    ("the flight raised an error", lambda f: f["outcome"] == ERROR),
    ("the service died in flight", lambda f: _unsafe(f, "the service died")),
    ("in the water", lambda f: bool(f["in_water"])),
    ("came down without sight of the pad", lambda f: _unsafe(f, "came down")),
    (
        "struck the deck beside the pad, then landed on the pad",
        lambda f: bool(f["landed_on_pad"]) and any(not contact["on_pad"] for contact in f["contacts"]),
    ),
    ("touched the pad outside commit", lambda f: bool(f["contacts_outside_commit"]) and all(c["on_pad"] for c in f["contacts"])),
    ("landed beside the pad", lambda f: f["outcome"] == "landed" and f["touchdown"] is not None and not f["touchdown"]["on_pad"]),
    ("struck the deck beside the pad and did not land", lambda f: any(not contact["on_pad"] for contact in f["contacts"])),
    ("gave up, though it should land", lambda f: f["outcome"] == "gave up"),
    ("time ran out", lambda f: f["outcome"] == "time ran out"),
)
"""Name of the cause, and whether it fits a failed flight; in order of severity."""


def _phases(flight: Flight) -> str:
    """Return the phases of guidance in which contacts happened that it did not intend."""
    return ", ".join(dict.fromkeys(re.findall(r"outside commit \(([^)]*)\)", " ".join(flight["unsafe"]))))


def cause_of(flight: Flight) -> str:
    """Return the cause of a failed flight."""
    for name, fits in RULES:
        if fits(flight):
            reason = _rest(flight) if name.startswith("gave up") else _phases(flight) if "outside commit" in name else ""
            return f"{name}: {reason}" if reason else name
    return f"ended otherwise: {flight['outcome']}"


def severity(flight: Flight) -> int:
    """Return how bad a flight's end is: 0 for none, else the more the earlier its rule."""
    if flight["grade"] != "failed":
        return 0
    for place, (_, fits) in enumerate(RULES):
        if fits(flight):
            return len(RULES) - place + 1
    return 1


def causes(flights: Iterable[Flight]) -> Counter[str]:
    """Return the number of failed flights by cause."""
    return Counter(cause_of(flight) for flight in flights if flight["grade"] == "failed")
