"""Fly ways of landing side by side: every controller in every weather, or with and without each of a ship's sensors.

python -m benches.landings [--runs 2] [--seed FIRST] [--only NAME ...] [--scenarios NAME ...] [--hidden SECONDS] [--write FILE]
python -m benches.ship_sensors, with the same options

A flight is that of `decklander campaign --perception model` with the keys of its way. A row has, of all flights of a way in a
scenario: those on the pad, refused and unsafe; of those on the pad the standing error (median, 95 %) and the median time from the
begin to the contact; by the truth, the rms error of the deck's vertical speed that guidance was forecast 1 and 2 s ahead, from
the first sight of the pad to the end, and in the first 3 s of sight; and, at the contact, the distance along the deck between the
estimated and the true place of the pad, and the distance from the centre that the estimate claims, which is what control left
(medians). `--hidden` covers the lens for the first seconds, so that a ship speaks before the pad is seen. Flights that the file
of `--write` has are not flown again: remove a file of other code first.
"""

import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from msgspec.structs import replace

import examples.known_controllers  # noqa: F401 - offers lqr and mpc
from benches.options import described, failed, parsed
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.guidance.pilot import Pilot
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import NS_PER_S, MonoNs
from sitl.faults.kinds import LensCovered
from sitl.flight.one_flight import FlyOptions, fly
from sitl.scenario.overrides import Overridable
from sitl.scenario.scenario import load
from sitl.scenario.settings import settings_for
from sitl.world.truth import Truth

Ways = Mapping[str, Sequence[str]]
"""The keys that each way of landing sets, by its name."""
_OWN = ("vessel.motion_hz=5", "vessel.turn_hz=10", "vessel.reports_hz=5", "vessel.wind_hz=1")
_RTK = ("rtk.rate_hz=10", "rtk.heading_hz=5")
CONTROLLERS: Ways = {
    "thesis": ("guidance.controller=pid", "guidance.mission=thesis"),
    **{name: (f"guidance.controller={name}",) for name in ("pid", "lqr", "mpc", "policy", "follow_deck")},
}
SHIP_SENSORS: Ways = {
    "camera": (), "her sensors": _OWN, "RTK": _RTK, "both": (*_OWN, *_RTK), "RTK, lens covered from 3 m": _RTK
}  # fmt: skip
WEATHERS = tuple(f"weather_{n}" for n in range(2, 7))
HORIZONS_S, FIRST_S = (1.0, 2.0), 3.0
HEAD = (
    "scenario", "way", "on the pad", "refused", "unsafe", "standing, cm", "to contact, s", "forecast 1, 2 s, m/s", "first 3 s",
    "estimate off, left by control, cm",
)  # fmt: skip
Row = dict[str, Any]


class Watch(NullObserver):
    """Sets what the estimator says in a flight beside the truth."""

    def __init__(self) -> None:
        self._pilots, self._seen = list[Pilot](), list[MonoNs]()
        self._ahead, self._claimed, self._truth = list[list[float]](), list[list[float]](), list[list[float]]()

    def on_pilot(self, pilot: Pilot) -> None:
        self._pilots.append(pilot)

    def on_frame(self, processed: ProcessedFrame) -> None:
        if processed.verdict is Verdict.FUSED:
            self._seen.append(processed.frame.stamp.measured_at)

    def on_decision(self, decision: Decision) -> None:
        if (made := self._pilots[0].landing.forecast_made(decision.at)) is not None:
            self._ahead.append([decision.at, *np.interp(HORIZONS_S, made.horizons_s, made.rise_m_s)])
        if decision.belief is not None:
            self._claimed.append([decision.at, *decision.belief.d_body_pad_level])

    def on_truth(self, truth: Truth) -> None:
        self._truth.append([truth.at, *truth.d_body_pad_level, -truth.v_pad_ned[2]])

    def forecasts(self) -> list[list[float]]:
        """Return number and sum of squares of the errors at each horizon since the pad was seen, and in the first seconds."""
        at, *claimed = np.reshape(self._ahead, (-1, 1 + len(HORIZONS_S))).T
        t, _, _, _, rise = np.array(self._truth).T
        seen = self._seen[0] if self._seen else math.inf
        out = []
        for until in (math.inf, seen + FIRST_S * NS_PER_S):
            for h, each in zip(HORIZONS_S, claimed, strict=True):
                then = at + h * NS_PER_S
                off = (each - np.interp(then, t, rise))[(seen <= at) & (at <= until) & (then <= t[-1])]
                out.append([float(off.size), float(off @ off)])
        return out

    def at_contact(self, at: MonoNs) -> tuple[float, float]:
        """Return how far the newest estimate before a contact was off along the deck, and from the centre by itself, metres."""
        then, *claimed = next(claim for claim in reversed(self._claimed) if claim[0] < at)
        t, x, y, *_ = np.array(self._truth).T
        return math.hypot(claimed[0] - np.interp(then, t, x), claimed[1] - np.interp(then, t, y)), math.hypot(*claimed[:2])


def flown(way: str, keys: Sequence[str], name: str, seed: int, hidden_s: float) -> Row:
    """Fly one flight, and return what the table needs of it."""
    scenario = load("faults/rtk_camera_covered", name) if "covered" in way else load(name)
    given = Overridable(scenario, settings_for(scenario, None))
    scenario, settings = given.with_values([given.parse(key, way) for key in keys], way)
    if hidden_s:
        scenario = replace(scenario, faults=(*scenario.faults, LensCovered(at_s=0.0, for_s=hidden_s)))
    watch = Watch()
    ending = fly(name, scenario, seed, settings, "model", [watch], FlyOptions(on_pilot=watch.on_pilot, on_truth=watch.on_truth))
    row, said = {"way": way, "name": name, "seed": seed, "hidden_s": hidden_s, "forecasts": watch.forecasts()}, ending.as_json()
    row |= {key: said[key] for key in ("landed_on_pad", "outcome", "refused", "unsafe")}
    if said["landed_on_pad"]:
        off_m = watch.at_contact(ending.contacts[-1].at)
        row["landing"] = [said["standing"]["lateral_m"], said["contacts"][-1]["at_s"], *off_m]
    return row


def cells(rows: Sequence[Row]) -> list[str]:
    """Return the cells of the flights of one way in one scenario."""
    landed = np.array([row["landing"] for row in rows if row["landed_on_pad"]]).reshape(-1, 4)
    refused, unsafe = sum(row["refused"] is not None for row in rows), sum(bool(row["unsafe"]) for row in rows)
    standing, at_s, estimate, left = np.median(landed * (100, 1, 100, 100), axis=0) if len(landed) else [math.nan] * 4
    p95 = 100.0 * np.quantile(landed[:, 0], 0.95) if len(landed) else math.nan
    rms = [f"{math.sqrt(squares / n):.2f}" if n else "-" for n, squares in np.sum([row["forecasts"] for row in rows], axis=0)]
    return [
        f"{len(landed)} of {len(rows)}", str(refused), f"**{unsafe}**" if unsafe else "0", f"{standing:.1f}, {p95:.1f}",
        f"{at_s:.1f}", ", ".join(rms[:2]), ", ".join(rms[2:]), f"{estimate:.1f}, {left:.1f}",
    ]  # fmt: skip


def main(ways: Ways = CONTROLLERS, scenarios: Sequence[str] = WEATHERS) -> None:
    """Fly what is left and print the table."""
    parser = described(__doc__)
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=5000)
    parser.add_argument("--only", choices=list(ways), nargs="+", default=list(ways))
    parser.add_argument("--scenarios", nargs="+", default=list(scenarios))
    parser.add_argument("--hidden", type=float, default=0.0)
    parser.add_argument("--write", type=Path, default=Path(os.devnull))
    args = parsed(parser, f"--runs 1 --scenarios {scenarios[0]} --only {next(iter(ways))}")
    kept = [json.loads(line) for line in (args.write.read_text() if args.write.exists() else "").splitlines()]
    known = {(row["way"], row["name"], row["seed"], row["hidden_s"]): row for row in kept}
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}", flush=True)
    for name in args.scenarios:
        for way in args.only:
            rows = list[Row]()
            for seed in range(args.seed, args.seed + args.runs):
                if (row := known.get((way, name, seed, args.hidden))) is None:
                    try:
                        row = flown(way, ways[way], name, seed, args.hidden)
                    except BadInput as why:
                        failed(f"{name}, {way}: {why}")
                    with args.write.open("a") as file:
                        file.write(json.dumps(row) + "\n")
                sys.stderr.write(f"{name}, {way}, {seed}: {'; '.join(row['unsafe']) or row['outcome']}\n")
                rows.append(row)
            print(f"| {name} | {way} | {' | '.join(cells(rows))} |", flush=True)


if __name__ == "__main__":
    main()
