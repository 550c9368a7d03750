"""Measure persons' landings: each contact against the place that was announced.

python -m benches.by_person [--runs 3] [--seed 891000] [--vehicles NAME ...] [--speeds M_S ...] [--heights M ...] [--blind]
                            [--write FILE]

A cell is a vehicle, a ship's speed and the height of the order, in the sea and wind of `weather_3`; a flight is that of
`decklander simulate --perception model`, of an AR.Drone, or of ArduCopter or PX4 in miniature with their own camera. The
announced place is read where a person reads it: in the reason of the first decision of the landing ("on the pad, within 15 cm of
its centre"); one beside the pad lies that far off on the side on which the drone is by its estimate. `--blind` covers the lens at
that height, and the order comes up to 3 s later; the text is then that of the first decision without sight. A row has the
contacts by the truth: those on the pad, the distance from its centre (median, 95 %), those within the announced distance of the
announced place, that distance (median), the highest speed along the deck, and the longest time for which the motors turned after
the last contact. The worst of several contacts counts. Exit code 0 where 95 % are as announced, and in sight 95 % within 15 cm.
Flights that the file of `--write` has are not flown again: remove a file of other code first.
"""

import json
import math
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from msgspec.structs import replace

from benches.options import described, parsed
from companion.base.mission import State
from companion.base.observer import Decision, NullObserver
from sitl.emulators.autopilots.stand_in.flight import StackName, StandInFlight
from sitl.faults.kinds import AnyFault, LensCovered, OperatorActs
from sitl.flight.one_flight import FlyOptions, fly
from sitl.perception.levels import perceive
from sitl.scenario.scenario import Scenario, load
from sitl.scenario.settings import settings_for

VEHICLES = ("ardrone", "arducopter", "px4")
SPEEDS_M_S, HEIGHTS_M = (0.0, 1.5, 5.0), (1.0, 3.0, 5.0)
WITHIN_M, SHARE = 0.15, 0.95
_BLIND_S = 3.0
"""Longest time from the covered lens to the order, s."""
HEAD = (
    "vehicle", "ship, m/s", "at, m", "on the pad", "off centre, cm", "as announced", "within, cm", "along, m/s", "motors, s",
)  # fmt: skip
_PLACE = re.compile(
    r"(?:(?P<pad>on the pad, within|toward the pad, up to)|(?P<beside>[\d.]+) m beside the pad, \+-) ?"
    r"(?P<within>[\d.]+) (?P<unit>cm|m)"
)
_UNSURE = re.compile("not sure|no pad is known")
Row = dict[str, Any]


class Announced(NullObserver):
    """The text that the person reads when the landing begins, and the place on the deck below the drone by its estimate.

    Args:
        blind: whether the first text without sight counts.
    """

    def __init__(self, *, blind: bool = False) -> None:
        self.text, self.blind = "", blind
        self.below_m: tuple[float, float] | None = None
        """Forward along the arrow and starboard of the pad's centre, m; None if it was not known."""

    def on_decision(self, decision: Decision) -> None:
        if decision.phase != State.LAND_HERE.value or self.text or (self.blind and not _UNSURE.search(decision.reason)):
            return
        self.text, known = decision.reason, decision.belief
        if known is not None and known.yaw_rad is not None:
            c, s = math.cos(known.yaw_rad), math.sin(known.yaw_rad)
            x, y, _ = known.d_body_pad_level.tolist()
            self.below_m = s * y - c * x, -s * x - c * y


def announced(text: str) -> tuple[float, float]:
    """Return the distance from the pad's centre that a text announces, and the one within which the contact is to be, m."""
    found = _PLACE.search(text)
    if found is None:
        return math.nan, math.inf
    within_m = float(found["within"]) * (0.01 if found["unit"] == "cm" else 1.0)
    return 0.0 if found["pad"] else float(found["beside"]), within_m


def scenario_of(speed_m_s: float, height_m: float, *, blind: bool) -> Scenario:
    """Return the scenario of a cell."""
    given = load("weather_3")
    ordered = OperatorActs(order="land", below_height_m=height_m)
    acts: tuple[AnyFault, ...] = (ordered,)
    if blind:
        acts = (LensCovered(below_height_m=height_m), replace(ordered, drawn_within_s=_BLIND_S))
    vessel, start = replace(given.vessel, speed_m_s=speed_m_s), replace(given.start, height_m=max(4.0, height_m + 1.5))
    return replace(given, vessel=vessel, start=start, faults=acts, expect="either", duration_limit_s=90.0)


def flown(vehicle: str, speed_m_s: float, height_m: float, seed: int, *, blind: bool) -> Row:
    """Fly one flight, and return what the table needs of it."""
    scenario, seen = scenario_of(speed_m_s, height_m, blind=blind), Announced(blind=blind)
    if vehicle == "ardrone":
        ending = fly("weather_3", scenario, seed, settings_for(scenario, None), "model", [seen], FlyOptions())
        armed_s = 0.0
    else:
        name: StackName = "px4" if vehicle == "px4" else "arducopter"
        settings = settings_for(scenario, None, by_autopilot=True)
        end = StandInFlight(scenario, seed, settings, name, observers=[seen], perception=perceive("model")).fly()
        ending = end.ending
        armed_s = math.inf if ending.contacts and end.armed_after_contact_s is None else end.armed_after_contact_s or 0.0
    contacts = ending.contacts
    row: Row = {"vehicle": vehicle, "speed_m_s": speed_m_s, "height_m": height_m, "seed": seed, "blind": blind}
    row |= {"announced": seen.text, "below_m": seen.below_m, "armed_s": armed_s, "unsafe": list(ending.as_json()["unsafe"])}
    row |= {"touched_m": [c.p_body_pad.tolist()[:2] for c in contacts], "on_pad": bool(contacts) and contacts[-1].on_pad}
    return row | {
        "lateral_m": max((c.lateral_m for c in contacts), default=None),
        "along_m_s": max((c.lateral_speed_m_s for c in contacts), default=0.0),
    }


def missed_m(row: Row) -> float:
    """Return the distance of the farthest contact from the announced place, m; infinite without a contact, nan without a place.

    Where the side was not known, only the distance from the pad's centre is compared.
    """
    at_m, below_m = announced(row["announced"])[0], row["below_m"]
    if below_m is None:
        return max((abs(math.hypot(*touched) - at_m) for touched in row["touched_m"]), default=math.inf)
    share = at_m / math.hypot(*below_m)
    place = share * below_m[0], share * below_m[1]
    return max((math.dist(touched, place) for touched in row["touched_m"]), default=math.inf)


def as_announced(row: Row) -> bool:
    """Return True for contacts within the announced distance of the announced place, or where none was announced."""
    missed = missed_m(row)
    return missed < math.inf and not missed > announced(row["announced"])[1]


def cells(rows: Sequence[Row]) -> list[str]:
    """Return the cells of the flights of one row."""
    off = np.array([row["lateral_m"] for row in rows if row["lateral_m"] is not None]) * 100.0
    place = f"{np.median(off):.1f}, {np.quantile(off, 0.95):.1f}" if len(off) else "-"
    within = 100.0 * np.median([announced(row["announced"])[1] for row in rows])
    return [
        f"{sum(row['on_pad'] for row in rows)} of {len(rows)}", place, f"{sum(map(as_announced, rows))} of {len(rows)}",
        f"{within:.0f}", f"{max(row['along_m_s'] for row in rows):.2f}", f"{max(row['armed_s'] for row in rows):.1f}",
    ]  # fmt: skip


def main() -> int:
    """Fly what is left and print the table."""
    parser = described(__doc__)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seed", type=int, default=891000)
    parser.add_argument("--vehicles", choices=VEHICLES, nargs="+", default=VEHICLES)
    parser.add_argument("--speeds", type=float, nargs="+", default=SPEEDS_M_S)
    parser.add_argument("--heights", type=float, nargs="+", default=HEIGHTS_M)
    parser.add_argument("--blind", action="store_true")
    parser.add_argument("--write", type=Path, default=Path(os.devnull))
    args = parsed(parser, "--runs 1 --vehicles ardrone --speeds 0 --heights 1")
    kept = [json.loads(line) for line in (args.write.read_text() if args.write.exists() else "").splitlines()]
    known = {tuple(row[key] for key in ("vehicle", "speed_m_s", "height_m", "seed", "blind")): row for row in kept}
    every = list[Row]()
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}", flush=True)
    for vehicle in args.vehicles:
        for speed_m_s in args.speeds:
            for height_m in args.heights:
                rows = list[Row]()
                for seed in range(args.seed, args.seed + args.runs):
                    key = vehicle, speed_m_s, height_m, seed, args.blind
                    row = known.get(key) or flown(vehicle, speed_m_s, height_m, seed, blind=args.blind)
                    rows.append(row)
                    if key not in known:
                        with args.write.open("a") as file:
                            file.write(json.dumps(row) + "\n")
                print(f"| {' | '.join([vehicle, f'{speed_m_s:g}', f'{height_m:g}', *cells(rows)])} |", flush=True)
                every += rows
    near = sum(row["lateral_m"] is not None and row["lateral_m"] <= WITHIN_M for row in every) / len(every)
    right, unsafe = sum(map(as_announced, every)) / len(every), sum(bool(row["unsafe"]) for row in every)
    print(f"as announced: {right:.1%}; within {100 * WITHIN_M:.0f} cm: {near:.1%}; unsafe: {unsafe} of {len(every)}")
    return 0 if right >= SHARE and (args.blind or near >= SHARE) else 1


if __name__ == "__main__":
    sys.exit(main())
