"""Kill the daemon beside an autopilot at each of five phases, and see what the autopilot does and whether a new daemon lands it.

python -m benches.killed [--autopilot {px4,arducopter}] [--binary PATH] [--scenario NAME] [--phase NAME ...] [--first SEED]
    [--seeds N] [--perception truth|model|pixels] [--for SECONDS]

Every flight is one of `decklander simulate --autopilot` with the fault `service_killed`, one after the other, and
has a line on standard error.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import msgspec

from benches.options import described, parsed
from sitl.emulators.autopilots.conduct import FlightEnd
from sitl.emulators.autopilots.flight import AutopilotFlight, AutopilotProgram
from sitl.emulators.autopilots.programs.program import executable
from sitl.emulators.autopilots.stand_in.flight import StandInFlight
from sitl.faults.kinds import ServiceKilled
from sitl.flight.one_flight import perception_level
from sitl.perception.levels import perceive
from sitl.scenario.scenario import Scenario, load
from sitl.scenario.settings import settings_for

CASES = {
    "intercept": ServiceKilled(in_phase="intercept"),
    "descend": ServiceKilled(below_height_m=3.0),
    "gate": ServiceKilled(in_phase="gate"),
    "commit": ServiceKilled(in_phase="commit"),
    "press": ServiceKilled(in_phase="press"),
}
"""Phases in which it is killed. At the order to land the pad is in sight, so that `search` lasts for no guidance cycle."""
_BESIDE_M = 3.0
"""Distance of the pad to starboard at the start, m, so that there is an intercept."""


def scenario_of(name: str, phase: str, for_s: float) -> Scenario:
    """Return the shipped scenario with the daemon killed in a phase."""
    scenario = load(name)
    fault = msgspec.structs.replace(CASES[phase], for_s=for_s)
    start = msgspec.structs.replace(scenario.start, pad_right_m=_BESIDE_M)
    return msgspec.structs.replace(scenario, faults=(fault,), start=start, unreached_contacts=True)


def fly(args: argparse.Namespace, phase: str, seed: int) -> FlightEnd:
    """Fly once."""
    scenario = scenario_of(args.scenario, phase, args.for_s)
    settings = settings_for(scenario, None, by_autopilot=True)
    seen_by = perceive(args.perception)
    if args.binary is None:
        return StandInFlight(scenario, seed, settings, args.autopilot, perception=seen_by).fly()
    program = AutopilotProgram(args.autopilot, executable(args.binary))
    with tempfile.TemporaryDirectory(prefix="decklander-") as folder:
        return AutopilotFlight(scenario, seed, settings, program, Path(folder), perception=seen_by).fly()


def table(flights: Sequence[tuple[str, FlightEnd]]) -> str:
    """Return a table with a row for each phase; ranges are from the least to the largest."""
    head = (
        "phase", "landed on the pad", "height at the kill, m", "lowest over the deck, m", "touched it", "sank, m",
        "over the ground, m", "stopped after, s", "modes", "then error, cm", "into the deck, m/s",
    )  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for phase in CASES:
        killed = [end for flown, end in flights if flown == phase and end.silences]
        if not killed:
            continue
        quiet, down = [end.silences[0] for end in killed], [end.ending.contacts[-1] for end in killed if end.ending.on_pad]
        cells = (
            phase, f"{len(down)} of {len(killed)}", _range([q.height_m for q in quiet], 2),
            _range([q.lowest_m for q in quiet], 2), f"{sum(q.touched for q in quiet)}",
            _range([q.sank_m for q in quiet], 2), _range([q.moved_m for q in quiet], 1),
            _range([q.stopped_s for q in quiet if q.stopped_s is not None], 1),
            ", ".join(sorted({" to ".join(q.modes) for q in quiet})),
            _median([100.0 * each.lateral_m for each in down], 1), _median([each.vertical_speed_m_s for each in down], 2),
        )  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _range(values: Sequence[float], digits: int) -> str:
    return f"{min(values):.{digits}f} to {max(values):.{digits}f}" if values else "-"


def _median(values: Sequence[float], digits: int) -> str:
    return f"{median(values):.{digits}f}, {max(values):.{digits}f}" if values else "-"


def main() -> int:
    """Fly and print; return 0 if the daemon was killed in some flight, and each such flight ended on the pad."""
    parser = described(__doc__)
    parser.add_argument("--autopilot", choices=("px4", "arducopter"), default="arducopter")
    parser.add_argument("--binary")
    parser.add_argument("--scenario", default="rendezvous")
    parser.add_argument("--phase", nargs="+", choices=tuple(CASES), default=tuple(CASES))
    parser.add_argument("--first", type=int, default=21)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--perception", type=perception_level, default="pixels")
    parser.add_argument("--for", dest="for_s", type=float, default=5.0)
    args = parsed(parser, "--scenario calm --perception truth --phase press --for 1")
    flights = list[tuple[str, FlightEnd]]()
    for seed in range(args.first, args.first + args.seeds):
        for phase in args.phase:
            end = fly(args, phase, seed)
            flights.append((phase, end))
            outcome = end.failure or end.ending.word
            sys.stderr.write(f"{phase} {seed}: {outcome}, {len(end.ending.contacts)} contacts, failsafes {end.failsafes}\n")
    sys.stdout.write(table(flights) + "\n")
    killed = [end for _, end in flights if end.silences]
    return 0 if killed and all(end.ending.on_pad for end in killed) else 1


if __name__ == "__main__":
    sys.exit(main())
