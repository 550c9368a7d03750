"""Fly every state of the vehicle's custody against every act of a person, and count what is disobeyed.

python -m benches.hands [--runs 20] [--seed 0] [--stack ArduPilot|PX4] [--state NAME ...] [--act NAME ...]
python -m benches.hands --arducopter PATH --px4 PATH [--minutes 30] ...

The arbiter of people's orders and the MAVLink driver fly a toy autopilot of each stack in virtual time. In each run a state is
reached, a random time passes, and the person acts once; by remote control he holds on to his switch, as people do. For three
seconds every message is judged: what this act forbids is disobedience, and the last such message is the time to obey. A report of
the autopilot is up to 0.25 s old, so a message may cross the act; later than `OBEY_S` none may come. Exit code 0: none did.

With the programs themselves (PATH, or "stand-in" for our own in their place) they are flown over a pad instead of the toys, one
run of each cell after the other until the runs are made or the time is over, and prints who flew afterwards.
"""

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random

from companion.base.orders import OperatorOrder
from drivers.mavlink.custody import Hand
from drivers.mavlink.vehicle import LAND_MODE, RETURN_MODE, VELOCITY_MODE, Stack
from tests.support.program_flown import ProgramFlown
from tests.support.toy_autopilot import MANUAL_MODE, PERSONS_MODE, STEP_S, Flown

OBEY_S = 0.3
WATCH_S = 3.0
AGAIN_S = 0.5
"""Time after which a person who sees his switch overridden chooses his mode again, s."""
LANDING_ORDERED = "landing, ordered"
STATES = (*(hand.value for hand in Hand), LANDING_ORDERED)
_OTHER_HOLD = {Stack.ARDUPILOT: "poshold", Stack.PX4: "altctl"}
_STOPS = {Stack.ARDUPILOT: "brake", Stack.PX4: "auto.loiter"}
_MISSION = {Stack.ARDUPILOT: "auto", Stack.PX4: "auto.mission"}
_NEVER_ON_HOLD = ("arm", "take off", "reposition", "disarm forced")


@dataclass(frozen=True, slots=True)
class Run:
    """The result of one act."""

    obeyed: bool
    worst_s: float
    """Time of the last message that the act forbids, s after it; 0 if there is none."""
    sent: tuple[str, ...]
    """Messages that were sent after the act."""
    after: str
    """The vehicle's custody in the end, and its mode."""


@dataclass(frozen=True, slots=True)
class Act:
    """An act of a person.

    Args:
        does: carries it out; returns False where it changes nothing.
        forbids: whether a message is disobedience, by what it asks for; a setpoint is `setpoint`, a descending one `sinks`.
        over: whether the vehicle is as the person wants it.
    """

    does: Callable[[Flown | ProgramFlown], bool]
    forbids: Callable[[str], bool]
    over: Callable[[Flown | ProgramFlown], bool]
    by_switch: bool = False


def switched(modes: dict[Stack, str]) -> Act:
    """Return the choice of a mode by remote control or ground station."""

    def does(flown: Flown | ProgramFlown) -> bool:
        mode = modes[flown.toy.stack]
        asked = {what for at, what in flown.toy.log if flown.now_s - at < WATCH_S}
        if flown.toy.mode == mode or f"mode {mode}" in asked:
            return False
        flown.toy.switch(mode)
        flown.toy.others_stream = True
        return True

    return Act(does, lambda what: what not in ("sinks", "disarm forced"), lambda f: f.toy.mode == modes[f.toy.stack], True)


def ordered(order: OperatorOrder, forbids: Callable[[str], bool], over: Callable[[Flown | ProgramFlown], bool]) -> Act:
    """Return an order at the computer."""
    return Act(lambda flown: flown.order(order) is None, forbids, over)


def disarms(flown: Flown | ProgramFlown) -> bool:
    """Disarm by remote control."""
    was = flown.toy.armed
    flown.toy.disarm()
    return was


def holds(flown: Flown | ProgramFlown) -> bool:
    """Return whether the vehicle neither descends nor climbs by our order, or stands."""
    return not flown.toy.flying or flown.toy.mode not in LAND_MODE.values() or flown.hand is Hand.PERSON


def _held(what: str) -> bool:
    return what in (*_NEVER_ON_HOLD, "sinks", *(f"mode {m}" for m in (*LAND_MODE.values(), *RETURN_MODE.values())))


ACTS: dict[str, Act] = {
    "hold mode": switched(PERSONS_MODE), "other hold": switched(_OTHER_HOLD), "manual mode": switched(MANUAL_MODE),
    "stop mode": switched(_STOPS), "land mode": switched(LAND_MODE), "return mode": switched(RETURN_MODE),
    "mission": switched(_MISSION), "station's": switched(VELOCITY_MODE),
    "disarm": Act(disarms, lambda what: what in ("arm", "take off") or what.startswith("mode"), lambda f: not f.toy.armed),
    "EMERGENCY": ordered(OperatorOrder.EMERGENCY, lambda what: what != "disarm forced", lambda f: not f.toy.armed),
    "HOLD": ordered(OperatorOrder.HOLD, _held, holds), "ABORT": ordered(OperatorOrder.ABORT, _held, holds),
}  # fmt: skip


def begins_on_deck(state: str) -> bool:
    """Return whether a state is reached from the deck."""
    return state == Hand.TAKING_OFF.value


def fly(flown: Flown | ProgramFlown, state: str, act: Act, rng: Random) -> Run | None:
    """Fly one act in a state; None where it changes nothing."""
    if state == LANDING_ORDERED:
        flown.bring_to(Hand.NOBODY)
        flown.order(OperatorOrder.LAND)
        flown.until(lambda: flown.hand is Hand.LANDING)
    else:
        flown.bring_to(Hand(state))
    flown.run(rng.uniform(0.0, 7.0 if begins_on_deck(state) else 1.5))
    at_s = flown.now_s
    if not act.does(flown):
        return None
    flown.toy.refuses_modes = flown.toy.refuses_disarm = False
    again_s = at_s + AGAIN_S
    for _ in range(round(WATCH_S / STEP_S)):
        flown.step()
        if act.by_switch and flown.now_s >= again_s and not act.over(flown):
            act.does(flown)
            again_s += AGAIN_S
    if isinstance(flown, ProgramFlown) and act.by_switch and flown.toy.denied and not act.over(flown):
        return None  # PX4 takes no mission that it does not have
    return judged(flown, act, at_s)


def judged(flown: Flown | ProgramFlown, act: Act, at_s: float) -> Run:
    """Judge what was sent since an act."""
    messages = [*flown.toy.log, *((at, "setpoint" if v <= 0.0 else "sinks") for at, v in flown.toy.setpoints)]
    after = sorted((at - at_s, what) for at, what in messages if at > at_s)
    worst_s = max((at for at, what in after if act.forbids(what) or (what == "sinks" and act.forbids("setpoint"))), default=0.0)
    sent = tuple(f"{at:.2f} {what}" for at, what in after if what not in ("setpoint", "sinks"))
    holder = f"{flown.hand.value}, {flown.toy.mode}{'' if flown.toy.armed else ', disarmed'}"
    return Run(worst_s <= OBEY_S + STEP_S and act.over(flown), worst_s, sent, holder)


Cell = tuple[int, int, float, str]
"""The number of runs, those disobeyed, the worst time, s, and what was sent in the first disobeyed one."""


def toy(stack: Stack, state: str, act: Act, seed: int) -> Run | None:
    """Fly one act on a toy."""
    rng = Random(seed)
    height_m = 0.0 if begins_on_deck(state) else 8.0
    return fly(Flown(stack, height_m=height_m, late_s=rng.uniform(0.01, 0.05), seed=seed), state, act, rng)


def counted(job: tuple[Stack, str, str], runs: int, first: int) -> Cell:
    """Fly the runs of a cell on toys."""
    stack, state, name = job
    return cell([r for seed in range(first, first + runs) if (r := toy(stack, state, ACTS[name], seed)) is not None])


def cell(results: list[Run]) -> Cell:
    """Return a cell of the table."""
    bad = [r for r in results if not r.obeyed]
    return len(results), len(bad), max((r.worst_s for r in results), default=0.0), ", ".join(bad[0].sent) if bad else ""


def flown_by_program(stack: Stack, path: str, jobs: list[tuple[str, str]], args: argparse.Namespace) -> list[Cell]:
    """Fly the runs of all cells on a program, and print who flew afterwards.

    Args:
        path: the program, or "stand-in".
        jobs: states and acts.
    """
    results: dict[tuple[str, str], list[Run]] = {job: [] for job in jobs}
    rng, ends_s, lost = Random(args.seed), time.monotonic() + 60.0 * args.minutes, Counter[str]()
    with ProgramFlown(stack, None if path == "stand-in" else Path(path).absolute(), args.seed) as flown:
        for state, name in rng.sample(jobs * args.runs, len(jobs) * args.runs):
            if time.monotonic() > ends_s:
                break
            try:
                flown.begin(on_deck=begins_on_deck(state))
                result = fly(flown, state, ACTS[name], rng)
            except TimeoutError as why:
                lost[f"{state}: {why}"] += 1
                continue
            if result is not None:
                results[state, name].append(result)
    print(f"\n{stack.value}, who flew {WATCH_S:g} s after the act, and what was sent in the meantime")
    for (state, name), runs in results.items():
        for after, n in Counter(r.after for r in runs).items():
            sent = Counter(what.split(" ", 1)[1] for r in runs if r.after == after for what in r.sent)
            print(f"  {state} x {name}: {n} x {after}" + "".join(f"; {what} x{k}" for what, k in sent.items()))
    print("".join(f"  not reached, {n} times: {what}\n" for what, n in lost.items()), end="")
    return [cell(results[job]) for job in jobs]


def table(stack: Stack, states: tuple[str, ...], acts: tuple[str, ...], found: Iterator[tuple[int, int, float, str]]) -> int:
    """Print a stack's table, each cell as disobeyed/runs worst; return the number disobeyed."""
    print(f"\n{stack.value}: disobeyed/runs, and the last forbidden message, s after the act")
    print("".join(f"{name:>17}" for name in ("", *acts)))
    total, worst, why = 0, 0.0, list[str]()
    for state in states:
        cells = []
        for name in acts:
            runs, bad, worst_s, sent = next(found)
            total, worst = total + bad, max(worst, worst_s)
            cells.append(f"{bad}/{runs} {worst_s:.2f}" if runs else "-")
            why += [f"  {state} x {name}: {sent}"] if bad else []
        print(f"{state:>17}" + "".join(f"{cell:>17}" for cell in cells))
    print(f"{stack.value}: {total} disobeyed (0 asked), worst time to obey {worst:.2f} s ({OBEY_S:g} s asked)")
    print("\n".join(why), end="\n" if why else "")
    return total


def main(argv: list[str]) -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--arducopter", metavar="PATH")
    parser.add_argument("--px4", metavar="PATH")
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--stack", choices=[s.value for s in (Stack.ARDUPILOT, Stack.PX4)], nargs="+")
    parser.add_argument("--state", choices=STATES, nargs="+", default=STATES)
    parser.add_argument("--act", choices=tuple(ACTS), nargs="+", default=tuple(ACTS))
    args = parser.parse_args(argv)
    stacks = [Stack(name) for name in args.stack or ("ArduPilot", "PX4")]
    states, acts = tuple(args.state), tuple(args.act)
    disobeyed = 0
    programs = {stack: path for stack, path in ((Stack.ARDUPILOT, args.arducopter), (Stack.PX4, args.px4)) if path is not None}
    for stack, path in programs.items():
        cells = flown_by_program(stack, path, [(state, name) for state in states for name in acts], args)
        disobeyed += table(stack, states, acts, iter(cells))
    if programs:
        return int(disobeyed > 0)
    with ProcessPoolExecutor(args.jobs) as pool:
        for stack in stacks:
            jobs = [(stack, state, name) for state in states for name in acts]
            disobeyed += table(stack, states, acts, pool.map(partial(counted, runs=args.runs, first=args.seed), jobs))
    return int(disobeyed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
