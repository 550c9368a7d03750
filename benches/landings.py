"""Fly every controller in every weather: `python -m benches.landings [--flights 2] [--weathers 2,3] [--controllers pid,policy]`.

Prints the table of docs/training.md. Each flight is a whole mission by modelled perception, with the wrong model of its seed;
every controller flies the same seeds. With `--write` flights that the file has are not flown again: remove a file of other code
or of another policy first.
"""

import argparse
import json
import os
import statistics
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from msgspec.structs import replace

import examples.known_controllers  # noqa: F401 - offers lqr and mpc
from sitl.flight.one_flight import fly, settings_for
from sitl.scenario.scenario import load

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
    parser.add_argument("--flights", type=int, default=2)
    parser.add_argument("--first", type=int, default=5000)
    parser.add_argument("--weathers", default="2,3,4,5,6")
    parser.add_argument("--controllers", default=",".join(CONTROLLERS))
    parser.add_argument("--write", type=Path)
    return fly_controllers(parser.parse_args())


if __name__ == "__main__":
    sys.exit(main())
