"""Fly what once was unsafe or did not end: sensors that lie while they move, gusts, late commands, a deck that rolls.

    python -m benches.lies --seeds 20 --first 0              # all, 5 to 15 s of CPU a flight
    python -m benches.lies --base sea_state_4 --only gust    # those whose name has the word, over another sea

Printed for each fault: flights by what became of them, the time of the latest outcome, and the greatest height over the pad.

    python -m benches.lies --library --seeds 20              # half of the IMU frozen for 5 s, the estimator alone, own truth

Printed for each flight of the library: when the half was named, the largest error, NEES of position and velocity over their six
dimensions during the freeze, and the share of it inside the central 95 % of chi-square.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from sitl.campaign.random_faults import verdict_of
from sitl.flight.one_flight import fly, settings_for
from sitl.scenario.scenario import Scenario, from_mapping, load
from tests.support import lying_imu

LOW = {"below_height_m": 2.5}
FAULTS: dict[str, dict[str, Any]] = {
    "accelerometer frozen": {"kind": "accelerometer", **LOW, "frozen": True},
    "accelerometer x1.3": {"kind": "accelerometer", **LOW, "scale": 1.3},
    "accelerometer x0.7": {"kind": "accelerometer", **LOW, "scale": 0.7},
    "accelerometer spikes": {"kind": "accelerometer", "per_minute": 200.0, "for_s": 0.005, "offset_m_s2": 300.0, "axis": "z"},
    "gyro frozen": {"kind": "gyro", **LOW, "frozen": True},
    "gust of 15 m/s in commit": {"kind": "gust", "in_phase": "commit", "for_s": 3.0, "speed_m_s": 15.0, "from_deg": 70.0},
    "commands 0.4 s late": {"kind": "commands", "at_s": 0.0, "delay_s": 0.4},
    "deck rolls 12 deg at 3 s": {"kind": "deck_roll", "at_s": 2.0, "roll_deg": 12.0, "period_s": 3.0},
}
FROZEN_S, NAMED_S, ERROR_M = 5.0, 0.2, 0.5
"""Length of a freeze; the longest time until it is named and the largest error that are asked for."""
CHI2_6 = (1.237, 14.449)
"""The 2.5 % and 97.5 % quantiles of chi-square with 6 degrees of freedom."""
LIMIT_S = 180.0
"""Longest flight: longer than guidance takes for all its tries."""


def faulty(base: str, fault: dict[str, Any]) -> Scenario:
    """Return a scenario with one of the faults; it may land or refuse."""
    scenario, faults = load(base), from_mapping({"title": "a lie", "faults": [fault]}, "lies").faults
    return msgspec.structs.replace(scenario, faults=faults, expect="either", refusal="", duration_limit_s=LIMIT_S)


def row(name: str, base: str, first: int, seeds: int) -> tuple[str, int]:
    """Return a line of the table, and the number of flights that were unsafe or did not end."""
    scenario = faulty(base, FAULTS[name])
    settings = settings_for(load(base), None)
    counts: Counter[str] = Counter()
    wrong, latest_s, highest_m = [], 0.0, 0.0
    for seed in range(first, first + seeds):
        flight = fly(name, scenario, seed, settings, perception="model").as_json()
        verdict = verdict_of(flight)
        print(f"{name}, seed {seed}: {verdict} after {flight['duration_s']:.0f} s", file=sys.stderr)
        counts[verdict] += 1
        latest_s, highest_m = max(latest_s, flight["duration_s"]), max(highest_m, flight.get("highest_m") or 0.0)
        if verdict not in ("landed", "refused"):
            wrong.append(f"seed {seed}: {flight['because']}")
    cells = (name, *(str(counts[k]) for k in ("landed", "refused", "unsafe", "undecided")), f"{latest_s:.0f}", f"{highest_m:.1f}")
    return f"| {' | '.join((*cells, '; '.join(wrong)))} |", len(wrong)


def library(first: int, seeds: int) -> int:
    """Print the estimator's flights with half of an IMU frozen; return the number of those beyond what is asked."""
    print("| frozen | seed | named after s | worst error m | NEES/6 | inside 95 % |\n|---|---|---|---|---|---|")
    beyond, every = 0, list[float]()
    for half, word in (("f_body", "accelerometer"), ("w_body", "gyro")):
        for seed in range(first, first + seeds):
            out = lying_imu.fly(lying_imu.setting(seed), lying_imu.frozen(half), FROZEN_S)
            nees = np.array(out.nees[out.during(lying_imu.BEGIN_S, lying_imu.BEGIN_S + FROZEN_S)])
            every += nees.tolist()
            named_s, worst_m = out.named_after_s(f"the {word} repeats its readings"), max(out.error_m)
            beyond += not (named_s < NAMED_S and worst_m < ERROR_M)
            print(f"| {word} | {seed} | {named_s:.2f} | {worst_m:.2f} | {nees.mean():.2f} | {_inside(nees):.0f} |", flush=True)
    beyond_words = f"{beyond} of {2 * seeds} beyond {NAMED_S} s or {ERROR_M} m"
    print(f"{beyond_words}; NEES/6 {np.mean(every):.2f}, {_inside(every):.0f} % inside")
    return beyond


def _inside(nees: Sequence[float] | NDArray[np.float64]) -> float:
    """Return the percentage inside the central 95 %; `nees` is over its six dimensions."""
    return 100.0 * float(np.mean([CHI2_6[0] <= 6.0 * one <= CHI2_6[1] for one in nees]))


def main() -> int:
    """Print the table; return 1 if a flight was unsafe or did not end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="flights of each fault")
    parser.add_argument("--first", type=int, default=0, help="their first seed")
    parser.add_argument("--base", default="demo", help="the scenario to which the fault is added")
    parser.add_argument("--only", default="", help="faults whose name has this text")
    parser.add_argument("--library", action="store_true", help="half of an IMU frozen, the estimator alone")
    args = parser.parse_args()
    if args.library:
        return int(library(args.first, args.seeds) > 0)
    print("| fault | landed | refused | unsafe | did not end | latest s | highest m | wrong |\n|---|---|---|---|---|---|---|---|")
    failed = 0
    for name in (name for name in FAULTS if args.only in name):
        line, wrong = row(name, args.base, args.first, args.seeds)
        failed += wrong
        print(line, flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
