"""Landings a minute at each level of perception, whether two levels agree, and every controller in every weather.

    python -m benches.landings fly --perception model --scenario sea_state_4 --first 501 --flights 12 --workers 2
    python -m benches.landings fly --perception pixels --scenario moderate --flights 12 --write pixels.jsonl
    python -m benches.landings compare pixels.jsonl model.jsonl
    python -m benches.landings controllers [--flights 12] [--first 5000] [--weathers 2,3,4,5,6] [--controllers pid,policy]

`fly` prints the rate by the wall clock and the CPU time of a flight, with one thread for algebra as in a campaign; `--write`
appends one JSON object for each flight. `compare` takes two such files and prints outcomes, touchdown errors and the NEES of the
estimate side by side, each with the probability that a two-sample Kolmogorov-Smirnov test gives to such a difference by chance.

`controllers` prints the table of docs/training.md. Each flight is a whole mission by modelled perception, with the wrong model of
its seed; every controller flies the same seeds. With `--write` flights that the file has are not flown again: remove a file of
other code or of another policy first.

NEES: normalized estimation error squared of position, velocity and heading (7 degrees of freedom), once a second in flight
(Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, 5.4.2).
"""

import argparse
import json
import os
import statistics
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from msgspec.structs import replace
from scipy.stats import ks_2samp

import examples.known_controllers  # noqa: F401 - offers lqr and mpc
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.settings.guidance import GuidanceOptions
from companion.settings.model import Settings
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import wrap_pi
from sitl.flight.one_flight import PERCEPTIONS, FlyOptions, fly, perception_level, settings_for
from sitl.scenario.scenario import Scenario, load
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.truth import Truth

_EACH_NS = 1_000_000_000
_ON_DECK_M = 0.25
"""Height below which a frame shows the pad from the deck or half a second from it, m."""
_IN_THE_AIR = (VehiclePhase.HOVERING, VehiclePhase.FLYING, VehiclePhase.LANDING)


class Consistency(NullObserver):
    """The NEES of the steering estimate, once a second in the air, and the frames there with and without a pad."""

    def __init__(self) -> None:
        self.nees: list[float] = []
        self.error_m: list[float] = []
        self.looks = 0
        self.missed = 0
        self._belief: RelativeState | None = None
        self._due = _EACH_NS
        self._counts = False

    def on_frame(self, processed: ProcessedFrame) -> None:
        """Count a frame in the air."""
        found = processed.detection is not None and processed.detection.selected is not None
        self.looks += self._counts
        self.missed += self._counts and not found

    def on_decision(self, decision: Decision) -> None:
        self._belief = decision.belief

    def on_truth(self, truth: Truth) -> None:
        """Compare the newest estimate with the truth of the same instant."""
        b = self._belief
        self._counts = truth.phase in _IN_THE_AIR and truth.d_body_pad_level[2] > _ON_DECK_M
        if b is None or b.at != truth.at or truth.at < self._due or truth.phase not in _IN_THE_AIR or b.yaw_rad is None:
            return
        self._due = truth.at + _EACH_NS
        d = b.d_body_pad_level - truth.d_body_pad_level
        error = np.array([*d, *(b.v_pad_level - truth.v_pad_level), wrap_pi(b.yaw_rad - truth.yaw_rad)])
        self.nees.append(float(error @ np.linalg.solve(b.cov, error)))
        self.error_m.append(float(np.linalg.norm(d)) / max(0.2, truth.d_body_pad_level[2]))


def one(scenario: str, level: str, method: str, model: str | None, seed: int) -> dict[str, Any]:
    """Fly once and return the ending as plain values, with the level, NEES and errors of the estimate."""
    loaded, settings = _loaded(scenario, method)
    watch = Consistency()
    ending = fly(
        scenario,
        loaded,
        seed,
        settings,
        perception_level(level),
        [watch],
        FlyOptions(model, on_truth=watch.on_truth),
    )
    return {
        **ending.as_json(), "perception": level, "method": method, "nees": watch.nees, "error_per_height": watch.error_m,
        "missed": watch.missed / max(1, watch.looks),
    }  # fmt: skip


@cache
def _loaded(name: str, method: str) -> tuple[Scenario, Settings]:
    """Return a scenario and the settings to fly it with, read once in a process as in a campaign."""
    scenario = load(name)
    settings = settings_for(scenario, None)
    return scenario, replace(settings, vision=replace(settings.vision, method=method))


def fly_all(args: argparse.Namespace) -> int:
    """Fly the seeds, print the rate, and append the flights to a file if requested."""
    seeds = range(args.first, args.first + args.flights)
    call = partial(one, args.scenario, args.perception, args.method, args.perception_model)
    began = time.monotonic()
    done: list[dict[str, Any]] = []
    with ProcessPoolExecutor(args.workers) as pool:
        for flight in pool.map(call, seeds):
            done.append(flight)
            if args.write is not None:
                with args.write.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(flight) + "\n")
            sys.stderr.write(f"\r{len(done)} of {args.flights}")
    wall_s = time.monotonic() - began
    sys.stderr.write("\n")
    cpu_s = [flight["cpu_s"] for flight in done]
    flown_s = sum(flight["duration_s"] for flight in done)
    load_1, _, _ = os.getloadavg()
    sys.stdout.write(
        f"{args.scenario}, {args.perception}, vision.method {args.method}, seeds {seeds[0]} to {seeds[-1]}, "
        f"{args.workers} processes, load {load_1:.0f}\n"
        f"{60 * len(done) / wall_s:.1f} flights a minute by the wall clock; {statistics.mean(cpu_s):.2f} s of CPU a flight "
        f"({60 / statistics.mean(cpu_s):.1f} a minute of CPU), {flown_s / sum(cpu_s):.1f} flown seconds a second of CPU\n"
        f"outcomes: {_outcomes(done)}\n"
    )
    return 0


def _outcomes(flights: Sequence[dict[str, Any]]) -> str:
    return ", ".join(f"{n} {word}" for word, n in Counter(flight["grade"] for flight in flights).most_common())


def compare(args: argparse.Namespace) -> int:
    """Print two files of flights side by side."""
    files = [[json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] for path in args.files]
    for scenario in sorted({flight["scenario"] for flights in files for flight in flights}):
        a, b = ([flight for flight in flights if flight["scenario"] == scenario] for flights in files)
        sys.stdout.write(f"{scenario}: {args.files[0]} ({len(a)} flights) against {args.files[1]} ({len(b)} flights)\n")
        sys.stdout.write(f"  outcomes: {_outcomes(a)} | {_outcomes(b)}\n")
        for name, values in (
            ("touchdown error, cm", _touchdowns),
            ("duration, s", lambda flights: [flight["duration_s"] for flight in flights]),
            ("NEES, 7 degrees of freedom", lambda flights: [x for flight in flights for x in flight["nees"]]),
            ("estimate's error over height", lambda flights: [x for flight in flights for x in flight["error_per_height"]]),
            ("share of frames in the air with no pad", lambda flights: [flight["missed"] for flight in flights]),
        ):
            _side_by_side(name, values(a), values(b))
    return 0


def _touchdowns(flights: Sequence[dict[str, Any]]) -> list[float]:
    return [100 * flight["touchdown"]["lateral_m"] for flight in flights if flight["landed_on_pad"]]


def _side_by_side(name: str, a: Sequence[float], b: Sequence[float]) -> None:
    if not a or not b:
        sys.stdout.write(f"  {name}: none\n")
        return
    p = float(ks_2samp(a, b).pvalue)
    figures = " | ".join(f"median {np.median(x):.3g}, 95 % {np.percentile(x, 95):.3g} (n {len(x)})" for x in (a, b))
    sys.stdout.write(f"  {name}: {figures}; p {p:.2f}\n")


CONTROLLERS = {
    "thesis": "PID and way points of the thesis", "pid": "PID of the thesis, mission `cone`", "lqr": "LQR with an integral",
    "mpc": "MPC with an integral", "policy": "the policy", "follow_deck": "the law",
}  # fmt: skip
Row = dict[str, Any]


def guidance_by(name: str, given: GuidanceOptions) -> GuidanceOptions:
    if name == "thesis":
        return replace(given, controller="pid", mission="thesis")
    return replace(given, controller=name)


def flown(name: str, weather: str, seed: int) -> Row:
    scenario = load(weather)
    settings = settings_for(scenario, None)
    settings = replace(settings, guidance=guidance_by(name, settings.guidance))
    ending = fly(weather, scenario, seed, settings, "model").as_json()
    stands = ending.get("standing") or ending["touchdown"] or {}
    return {
        "controller": name, "weather": weather, "seed": seed, "grade": ending["grade"], "outcome": ending["outcome"],
        "on_pad": ending["landed_on_pad"], "refused": ending["refused"], "unsafe": ending["unsafe"],
        "standing_m": stands.get("lateral_m") if ending["landed_on_pad"] else None,
    }  # fmt: skip


def kept(path: Path | None) -> Iterator[Row]:
    if path is not None and path.exists():
        yield from map(json.loads, path.read_text().splitlines())


def cell(rows: list[Row]) -> str:
    """Return landed of flown, the standing error, and what else came of them."""
    landed = [row for row in rows if row["on_pad"]]
    refused, unsafe = sum(row["refused"] is not None for row in rows), sum(bool(row["unsafe"]) for row in rows)
    errors_cm = sorted(100.0 * row["standing_m"] for row in landed if row["standing_m"] is not None)
    words = [f"{len(landed)} of {len(rows)}"]
    if errors_cm:
        words.append(f"{statistics.median(errors_cm):.1f} / {errors_cm[-1]:.1f} cm")
    if refused:
        words.append(f"{refused} refused")
    if unsafe:
        words.append(f"**{unsafe} unsafe**")
    return ", ".join(words)


def fly_controllers(args: argparse.Namespace) -> int:
    """Fly what is left and print the table."""
    weathers, names = [f"weather_{n}" for n in args.weathers.split(",")], args.controllers.split(",")
    rows = {(row["controller"], row["weather"], row["seed"]): row for row in kept(args.write)}
    for seed in range(args.first, args.first + args.flights):
        for weather in weathers:
            for name in names:
                if (name, weather, seed) in rows:
                    continue
                row = rows[name, weather, seed] = flown(name, weather, seed)
                sys.stderr.write(f"{name} {weather} {seed}: {row['outcome']}\n")
                if args.write is not None:
                    with args.write.open("a") as file:
                        file.write(json.dumps(row) + "\n")
    sys.stdout.write(f"| | {' | '.join(weathers)} |\n|{'---|' * (len(weathers) + 1)}\n")
    for name in names:
        of = {weather: [row for key, row in rows.items() if key[:2] == (name, weather)] for weather in weathers}
        sys.stdout.write(f"| {CONTROLLERS[name]} | {' | '.join(cell(of[weather]) for weather in weathers)} |\n")
    unsafe = [(row["controller"], row["weather"], row["seed"], row["unsafe"]) for row in rows.values() if row["unsafe"]]
    sys.stdout.write(f"unsafe: {unsafe}\n")
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    actions = parser.add_subparsers(dest="action", required=True)
    flying = actions.add_parser("fly")
    flying.add_argument("--scenario", default="moderate")
    flying.add_argument("--perception", default="model", choices=PERCEPTIONS)
    flying.add_argument("--perception-model")
    flying.add_argument("--method", default="registration", choices=("fused", "registration", "thesis"))
    flying.add_argument("--first", type=int, default=501, help="first seed; the models were fitted on 301 to 312")
    flying.add_argument("--flights", type=int, default=4)
    flying.add_argument("--workers", type=int, default=1)
    flying.add_argument("--write", type=Path)
    comparing = actions.add_parser("compare")
    comparing.add_argument("files", nargs=2, type=Path)
    controllers = actions.add_parser("controllers")
    controllers.add_argument("--flights", type=int, default=12)
    controllers.add_argument("--first", type=int, default=5000)
    controllers.add_argument("--weathers", default="2,3,4,5,6")
    controllers.add_argument("--controllers", default=",".join(CONTROLLERS))
    controllers.add_argument("--write", type=Path)
    args = parser.parse_args()
    return {"fly": fly_all, "compare": compare, "controllers": fly_controllers}[args.action](args)


if __name__ == "__main__":
    sys.exit(main())
