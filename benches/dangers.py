"""The faults of configs/scenarios/faults, flown: outcome, and what was unsafe.

    python -m benches.dangers --seeds 3                        # all, some 30 to 60 s of CPU a flight
    python -m benches.dangers --only camera_freezes --seeds 1
    python -m benches.dangers --out dangers.jsonl              # goes on where an earlier run with the same file ended

Flights are in virtual time with rendered frames. Vision is `registration` unless `--fused`, which also runs the thesis' methods.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec

from companion.cli.simulate import ending_of
from companion.cli.soak_parts import without_thesis_methods
from companion.service import make_pilot
from companion.settings import load, shipped
from companion.settings_model import CameraSettings, PadSettings, Settings
from estimator.contracts.errors import BadInput
from sitl.flight import Flight
from sitl.scenario import FAULTS
from sitl.scenario import load as load_scenario


def fly(name: str, seed: int, settings: Settings) -> dict[str, Any]:
    """One flight of one fault, as `decklander simulate --json` says it."""
    scenario = load_scenario(f"{FAULTS}/{name}")
    own = {"camera": CameraSettings(scenario.camera.file), "pad": PadSettings(scenario.pad.file)}
    settings = msgspec.structs.replace(settings, **own)
    began = time.process_time()
    flight = Flight(scenario, seed, settings, make_pilot(settings), renew=lambda: make_pilot(settings), contain=True)
    return ending_of(name, seed, scenario, flight.run(), time.process_time() - began).as_json()


def table(flights: list[dict[str, Any]]) -> str:
    """Markdown: one row a fault."""
    lines = ["| fault | seeds | expected | outcomes | unsafe | why |", "|---|---|---|---|---|---|"]
    for name in sorted({flight["scenario"] for flight in flights}):
        its = [flight for flight in flights if flight["scenario"] == name]
        outcomes = Counter(f"{flight['grade']} ({flight['outcome']})" for flight in its)
        unsafe = [flight for flight in its if flight["unsafe"]]
        failed = [flight for flight in its if flight["grade"] == "failed"]
        why = "; ".join(dict.fromkeys(f"seed {flight['seed']}: {flight['because']}" for flight in failed))
        said = ", ".join(f"{n} {outcome}" for outcome, n in outcomes.most_common())
        verdict = f"yes, {len(unsafe)} of {len(its)}" if unsafe else "no"
        lines.append(f"| {name} | {len(its)} | {its[0]['expect']} | {said} | {verdict} | {why} |")
    every = len(flights)
    bad = sum(bool(flight["unsafe"]) for flight in flights)
    wrong = sum(flight["grade"] == "failed" for flight in flights)
    lines.append(
        f"\n{every} flights: {bad} unsafe, {wrong} failed; {sum(f['cpu_s'] for f in flights) / max(1, every):.0f} s of CPU each"
    )
    return "\n".join(lines)


def main() -> int:
    names = shipped(f"scenarios/{FAULTS}")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="fly seeds 1 to N of each (default 1)")
    parser.add_argument("--only", action="append", choices=names, metavar="NAME", help=f"may be given again: {', '.join(names)}")
    parser.add_argument("--fused", action="store_true", help="all methods of vision")
    parser.add_argument("--config", default="sim", metavar="FILE", help="settings to fly with (default sim)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="keep each flight there, and skip those it has")
    args = parser.parse_args()
    settings = load(args.config) if args.fused else without_thesis_methods(load(args.config))
    flights = []
    if args.out is not None and args.out.exists():
        flights = [json.loads(line) for line in args.out.read_text().splitlines() if line.endswith("}")]
    have = {(flight["scenario"], flight["seed"]) for flight in flights}
    wanted = [(name, seed) for seed in range(1, args.seeds + 1) for name in args.only or names]
    for name, seed in wanted:
        if (name, seed) in have:
            continue
        flight = fly(name, seed, settings)
        flights.append(flight)
        if args.out is not None:
            with args.out.open("a") as file:
                file.write(json.dumps(flight) + "\n")
        sys.stderr.write(f"{name} {seed}: {flight['grade']}, {flight['because']} ({flight['cpu_s']:.0f} s of CPU)\n")
    shown = [flight for flight in flights if (flight["scenario"], flight["seed"]) in set(wanted)]
    sys.stdout.write(table(shown) + "\n")
    return 1 if any(flight["unsafe"] for flight in shown) else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except BadInput as why:
        sys.exit(f"{why}")
