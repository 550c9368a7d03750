"""Landings a minute at each level of perception, and every controller in every weather.

    python -m benches.landings fly --perception model --scenario sea_state_4 --first 501 --flights 12 --workers 2
    python -m benches.landings controllers [--flights 12] [--first 5000] [--weathers 2,3,4,5,6] [--controllers pid,policy]

`fly` prints the rate by the wall clock and the CPU time of a flight, with one thread for algebra as in a campaign.

`controllers` prints the table of docs/training.md. Each flight is a whole mission by modelled perception, with the wrong model of
its seed; every controller flies the same seeds. With `--write` flights that the file has are not flown again: remove a file of
other code or of another policy first.
"""

import argparse
import json
import os
import statistics
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from msgspec.structs import replace

import examples.known_controllers  # noqa: F401 - offers lqr and mpc
from companion.settings.model import Settings
from sitl.flight.one_flight import PERCEPTIONS, FlyOptions, fly, perception_level, settings_for
from sitl.scenario.scenario import Scenario, load


def one(scenario: str, level: str, method: str, model: str | None, seed: int) -> dict[str, Any]:
    """Fly once and return the ending as plain values."""
    loaded, settings = _loaded(scenario, method)
    return fly(scenario, loaded, seed, settings, perception_level(level), options=FlyOptions(model)).as_json()


@cache
def _loaded(name: str, method: str) -> tuple[Scenario, Settings]:
    """Return a scenario and the settings to fly it with, read once in a process as in a campaign."""
    scenario = load(name)
    settings = settings_for(scenario, None)
    return scenario, replace(settings, vision=replace(settings.vision, method=method))


def fly_all(args: argparse.Namespace) -> int:
    """Fly the seeds and print the rate."""
    seeds = range(args.first, args.first + args.flights)
    call = partial(one, args.scenario, args.perception, args.method, args.perception_model)
    began = time.monotonic()
    done: list[dict[str, Any]] = []
    with ProcessPoolExecutor(args.workers) as pool:
        for flight in pool.map(call, seeds):
            done.append(flight)
            sys.stderr.write(f"\r{len(done)} of {args.flights}")
    wall_s = time.monotonic() - began
    sys.stderr.write("\n")
    cpu_s = [flight["cpu_s"] for flight in done]
    flown_s = sum(flight["duration_s"] for flight in done)
    load_1, _, _ = os.getloadavg()
    grades = Counter(flight["grade"] for flight in done).most_common()
    sys.stdout.write(
        f"{args.scenario}, {args.perception}, vision.method {args.method}, seeds {seeds[0]} to {seeds[-1]}, "
        f"{args.workers} processes, load {load_1:.0f}\n"
        f"{60 * len(done) / wall_s:.1f} flights a minute by the wall clock; {statistics.mean(cpu_s):.2f} s of CPU a flight "
        f"({60 / statistics.mean(cpu_s):.1f} a minute of CPU), {flown_s / sum(cpu_s):.1f} flown seconds a second of CPU\n"
        f"outcomes: {', '.join(f'{n} {word}' for word, n in grades)}\n"
    )
    return 0


CONTROLLERS = {
    "thesis": "PID and way points of the thesis", "pid": "PID of the thesis, mission `cone`", "lqr": "LQR with an integral",
    "mpc": "MPC with an integral", "policy": "the policy", "follow_deck": "the law",
}  # fmt: skip
Row = dict[str, Any]


def flown(name: str, weather: str, seed: int) -> Row:
    scenario = load(weather)
    settings = settings_for(scenario, None)
    changed = {"controller": "pid", "mission": "thesis"} if name == "thesis" else {"controller": name}
    settings = replace(settings, guidance=replace(settings.guidance, **changed))
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
    controllers = actions.add_parser("controllers")
    controllers.add_argument("--flights", type=int, default=12)
    controllers.add_argument("--first", type=int, default=5000)
    controllers.add_argument("--weathers", default="2,3,4,5,6")
    controllers.add_argument("--controllers", default=",".join(CONTROLLERS))
    controllers.add_argument("--write", type=Path)
    args = parser.parse_args(sys.argv[1:] or ["fly"])
    return {"fly": fly_all, "controllers": fly_controllers}[args.action](args)


if __name__ == "__main__":
    sys.exit(main())
