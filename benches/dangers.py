"""Fly the faults of configs/scenarios/faults and report the outcomes and the unsafe events.

    python -m benches.dangers --seeds 3                        # all, some 30 to 60 s of CPU a flight
    python -m benches.dangers --first 211 --only camera_freezes gust_8_m_s
    python -m benches.dangers --out dangers.jsonl              # continues an earlier run with the same file

Flights are in virtual time with rendered frames. `--fused` also runs the thesis' methods of vision.
SIGTERM and Ctrl-C end it early; the table then has the finished flights, and a line says how many are missing.
"""

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec

from companion.base.signals import Stopped, install
from companion.settings.load import load, shipped
from companion.settings.model import CameraSettings, PadSettings, Settings
from estimator.contracts.errors import BadInput
from sitl.flight.one_flight import fly as fly_once
from sitl.scenario.scenario import FAULTS
from sitl.scenario.scenario import load as load_scenario

SURFACES = ("pad", "deck", "water")
"""Surfaces, from the best to the worst to touch."""


def fly(name: str, seed: int, settings: Settings) -> dict[str, Any]:
    """Fly one fault once; return the record of `decklander simulate --json` with `vision`, the method that was used."""
    scenario = load_scenario(f"{FAULTS}/{name}")
    own = {"camera": CameraSettings(scenario.camera.file), "pad": PadSettings(scenario.pad.file)}
    settings = msgspec.structs.replace(settings, **own)
    return fly_once(name, scenario, seed, settings).as_json() | {"vision": settings.vision.method}


def worst_touch(flights: list[dict[str, Any]]) -> str:
    """Return the worst surface touched, the contact on it farthest from the pad's centre, and the hardest contact of all."""
    touched = [(contact, flight["seed"]) for flight in flights for contact in flight["contacts"]]
    if not touched:
        return "none"
    worst, seed = max(touched, key=lambda one: (SURFACES.index(one[0]["surface"]), one[0]["lateral_m"]))
    hardest = max(contact["vertical_speed_m_s"] for contact, _ in touched)
    return f"{worst['surface']}, {100 * worst['lateral_m']:.0f} cm off (seed {seed}); hardest {hardest:.2f} m/s"


def table(flights: list[dict[str, Any]]) -> str:
    """Return Markdown with one row for each fault and a line for all flights."""
    lines = ["| fault | seeds | expected | outcomes | unsafe | worst touch | why |", "|---|---|---|---|---|---|---|"]
    for name in sorted({flight["scenario"] for flight in flights}):
        its = [flight for flight in flights if flight["scenario"] == name]
        outcomes = Counter(f"{flight['grade']} ({flight['outcome']})" for flight in its)
        unsafe = [flight for flight in its if flight["unsafe"]]
        failed = [flight for flight in its if flight["grade"] == "failed"]
        why = "; ".join(dict.fromkeys(f"seed {flight['seed']}: {flight['because']}" for flight in failed))
        output = ", ".join(f"{n} {outcome}" for outcome, n in outcomes.most_common())
        verdict = f"yes, {len(unsafe)} of {len(its)}" if unsafe else "no"
        lines.append(f"| {name} | {len(its)} | {its[0]['expect']} | {output} | {verdict} | {worst_touch(its)} | {why} |")
    every = len(flights)
    bad = sum(bool(flight["unsafe"]) for flight in flights)
    wrong = sum(flight["grade"] == "failed" for flight in flights)
    lines.append(
        f"\n{every} flights: {bad} unsafe, {wrong} failed; {sum(f['cpu_s'] for f in flights) / max(1, every):.0f} s of CPU each"
    )
    return "\n".join(lines)


def arguments() -> argparse.Namespace:
    """Return the command line's arguments."""
    names = shipped(f"scenarios/{FAULTS}")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="seeds to fly of each fault (default 1)")
    parser.add_argument("--first", type=int, default=1, metavar="SEED", help="the first of them (default 1)")
    parser.add_argument("--only", nargs="+", choices=names, metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--fused", action="store_true", help="all methods of vision")
    parser.add_argument("--config", default="sim", metavar="FILE", help="settings to fly with (default sim)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="keep each flight there, and skip those it has")
    args = parser.parse_args()
    if args.seeds < 1 or args.first < 0:
        parser.error("--seeds is 1 or more and --first 0 or more")
    return args


def main() -> int:
    args = arguments()
    settings = load(args.config)
    if args.fused:
        settings = msgspec.structs.replace(settings, vision=msgspec.structs.replace(settings.vision, method="fused"))
    method = settings.vision.method
    flights: list[dict[str, Any]] = []
    if args.out is not None and args.out.exists():
        flights = [json.loads(line) for line in args.out.read_text().splitlines() if line.endswith("}")]
    names = args.only or shipped(f"scenarios/{FAULTS}")
    wanted = dict.fromkeys((name, seed) for seed in range(args.first, args.first + args.seeds) for name in names)
    done = {(f["scenario"], f["seed"]): f for f in flights if f.get("vision") == method}
    done = {flight: done[flight] for flight in wanted if flight in done}
    interrupted: Stopped | None = None
    try:
        for name, seed in wanted:
            if (name, seed) in done:
                continue
            flight = done[name, seed] = fly(name, seed, settings)
            if args.out is not None:
                with args.out.open("a") as file:
                    file.write(json.dumps(flight) + "\n")
            sys.stderr.write(f"{name} {seed}: {flight['grade']}, {flight['because']} ({flight['cpu_s']:.0f} s of CPU)\n")
    except Stopped as why:
        interrupted = why
    shown = list(done.values())
    seeds = f"{args.first}" if args.seeds == 1 else f"{args.first} to {args.first + args.seeds - 1}"
    sys.stdout.write(f"{table(shown)}\nvision: {method}; settings: {args.config}; seeds: {seeds}\n")
    if interrupted is not None:
        sys.stdout.write(f"INTERRUPTED by {interrupted}: {len(wanted) - len(shown)} of {len(wanted)} flights were not flown\n")
        return interrupted.exit_code
    return 1 if any(flight["unsafe"] for flight in shown) else 0


if __name__ == "__main__":
    install()
    try:
        sys.exit(main())
    except BadInput as why:
        sys.exit(f"{why}")
