"""Fly every state of the vehicle's custody against every act of a person, and count what is disobeyed.

python -m benches.hands [--runs 20] [--seed 0] [--stack ArduPilot|PX4] [--state NAME ...] [--act NAME ...]
python -m benches.hands --arducopter PATH --px4 PATH [--minutes 30] ...

The arbiter of people's orders and the MAVLink driver fly a toy autopilot of each stack in virtual time. In each run a state is
reached, a random time passes, and the person acts once; by remote control he holds on to his switch, as people do. For three
seconds every message is judged: what this act forbids is disobedience, and the last such message is the time to obey. A report of
the autopilot is up to 0.25 s old, so a message may cross the act; later than `OBEY_S` none may come. Exit code 0: none did.

Two more kinds of columns: each failsafe of the autopilot, by its mode, by its state CRITICAL and by its words, while guidance
changes its mind; and each door of orders. `late D`: an order to begin, take or land that was given at door D before a pilot chose
his mode arrives behind that. `again D`: a copy of a hold arrives at door D after another person began again.

With the programs themselves (PATH, or "stand-in" for our own in their place) they are flown over a pad instead of the toys, one
run of each cell after the other until the runs are made or the time is over, and prints who flew afterwards. What no program
does on request is left out by its name.
"""

import argparse
import logging
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random

from benches.options import described, mapping, parsed
from companion.base.orders import OperatorOrder
from companion.guidance.operator.order_time import BEGINS
from drivers.mavlink.custody import LEFT_ALONE, Hand
from drivers.mavlink.vehicle import HOLD_MODE, LAND_MODE, RETURN_MODE, VELOCITY_MODE, Stack
from estimator.contracts.commands import Command, Hover, Land
from tests.support.doors import DOORS, LATE_DOORS, Doors
from tests.support.program_flown import ProgramFlown
from tests.support.toy_autopilot import MANUAL_MODE, PERSONS_MODE, STEP_S, STILL, Flown

OBEY_S = 0.3
WATCH_S = 3.0
AGAIN_S = 0.5
"""Time after which a person who sees his switch overridden chooses his mode again, s."""
LANDING_ORDERED, LANDING_LOST, HOLDING_REQUESTED = "landing, ordered", "landing, lost", "holding, requested"
STATES = (*(hand.value for hand in Hand), LANDING_ORDERED, LANDING_LOST, HOLDING_REQUESTED)
"""States of the custody, and three more: a landing by a person's order, one whose requests are lost, and a request to hold."""
_OTHER_HOLD = {Stack.ARDUPILOT: "poshold", Stack.PX4: "altctl"}
_STOPS = {Stack.ARDUPILOT: "brake", Stack.PX4: "auto.loiter"}
_MISSION = {Stack.ARDUPILOT: "auto", Stack.PX4: "auto.mission"}
_NEVER_ON_HOLD = ("arm", "take off", "reposition", "disarm forced")
_FAILSAFES: dict[str, tuple[str, dict[Stack, tuple[str, ...]]]] = {
    "battery": ("Battery Failsafe", {Stack.ARDUPILOT: ("land", "rtl"), Stack.PX4: ("auto.land", "auto.rtl")}),
    "fence": ("Fence Breached", {Stack.ARDUPILOT: ("rtl", "brake", "land"), Stack.PX4: ("auto.loiter", "auto.rtl")}),
    "RC lost": ("Radio Failsafe", {Stack.ARDUPILOT: ("rtl", "land", "brake"), Stack.PX4: ("auto.rtl", "auto.loiter")}),
    "EKF": ("EKF Failsafe", {Stack.ARDUPILOT: ("land", "alt_hold"), Stack.PX4: ("auto.land", "altctl")}),
}
"""Failsafes by name: what the autopilot says, and the modes by which it may act, as its parameters choose."""
_MINDS: tuple[Command | None, ...] = (STILL, Land(), Hover(), Hover(returns=True), None)
"""Commands that guidance may give after a failsafe came."""


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


Flight = Flown | ProgramFlown
Later = tuple[tuple[float, Callable[[], object]], ...]
"""Things that happen some seconds after an act."""


@dataclass(frozen=True, slots=True)
class Act:
    """An act of a person, or of the autopilot.

    Args:
        does: carries it out, and returns what happens later; None where it changes nothing.
        forbids: whether a message is disobedience, by what it asks for; a setpoint is `setpoint`, a descending one `sinks`.
        over: whether the vehicle is as the person wants it.
        toys: whether toys alone can do it.
    """

    does: Callable[[Flight, Random], Later | None]
    forbids: Callable[[str], bool]
    over: Callable[[Flight], bool]
    by_switch: bool = False
    toys: bool = False


def switched(modes: dict[Stack, str]) -> Act:
    """Return the choice of a mode by remote control or ground station."""

    def does(flown: Flight, rng: Random) -> Later | None:
        mode = modes[flown.toy.stack]
        requested = {what for at, what in flown.toy.log if flown.now_s - at < WATCH_S}
        if flown.toy.mode == mode or f"mode {mode}" in requested:
            return None
        if flown.requested and mode == VELOCITY_MODE[flown.toy.stack]:
            return None  # the mode from before our request: that it was chosen shows in the second HEARTBEAT
        flown.toy.switch(mode)
        flown.chosen, flown.toy.others_stream = mode, True
        return _changes_its_mind(flown, rng)

    return Act(does, _moves, in_mode, True)


def ours(flown: Flight, rng: Random) -> Later | None:
    """Choose the mode that we are requesting in this moment."""
    if not flown.requested:
        return None
    flown.toy.switch(flown.requested)
    flown.chosen, flown.toy.others_stream = flown.requested, True
    return ((rng.uniform(1.0, 2.0), lambda: _command(flown, STILL)),)


def left_alone(flown: Flight) -> bool:
    """Return whether nothing of ours has the vehicle, or it stands."""
    return flown.hand in LEFT_ALONE or not flown.toy.armed


def in_mode(flown: Flight) -> bool:
    """Return whether the vehicle is in the mode that a person or a failsafe chose, or stands."""
    return flown.toy.mode == flown.chosen or not flown.toy.armed


def _moves(what: str) -> bool:
    return what not in ("sinks", "disarm forced")


def ordered(order: OperatorOrder, forbids: Callable[[str], bool], over: Callable[[Flight], bool]) -> Act:
    """Return an order at the computer."""
    return Act(lambda flown, rng: () if flown.order(order) is None else None, forbids, over)


def disarms(flown: Flight, rng: Random) -> Later | None:
    """Disarm by remote control."""
    was = flown.toy.armed
    flown.toy.disarm()
    return () if was else None


def failing(name: str) -> Act:
    """Return a failsafe that acts by a mode, also by the one that the vehicle is in; guidance changes its mind meanwhile.

    The autopilot reports it by its state, by a text, or by both.
    """
    words, modes = _FAILSAFES[name]

    def does(flown: Flight, rng: Random) -> Later | None:
        if isinstance(flown, ProgramFlown) or not (toy := flown.toy).armed or not toy.flying:
            return None
        flown.chosen = rng.choice(modes[toy.stack])
        if (how := rng.choice(("state", "text", "both"))) == "text":
            toy.switch(flown.chosen)
            flown.say(words)
        else:
            toy.fail(flown.chosen, words if how == "both" else "")
        return _changes_its_mind(flown, rng)

    return Act(does, _moves, left_alone, toys=True)


def warns(flown: Flight, rng: Random) -> Later | None:
    """Let a failsafe come that leaves the vehicle its mode."""
    if isinstance(flown, ProgramFlown) or not (toy := flown.toy).armed or not toy.flying:
        return None
    toy.fail(None, rng.choice(list(_FAILSAFES.values()))[0])
    return _changes_its_mind(flown, rng)


def _changes_its_mind(flown: Flight, rng: Random) -> Later:
    """Return two commands of guidance, once the autopilot's report has come; none where nobody ordered anything."""
    times_s = () if flown.hand is Hand.NOBODY else (rng.uniform(OBEY_S, 1.0), rng.uniform(1.0, 2.0))
    return tuple((at_s, partial(_command, flown, rng.choice(_MINDS))) for at_s in times_s)


def _command(flown: Flight, command: Command | None) -> None:
    flown.guidance.command = command


def _doors(flown: Flight) -> Doors:
    return Doors(flown.arbiter, lambda: flown.now, lambda seconds: flown.run(max(seconds, 2.0 * STEP_S)))


def late(door: str) -> Act:
    """Return a pilot's choice of his mode, behind which an order arrives that was given before it."""

    def does(flown: Flight, rng: Random) -> Later | None:
        order = rng.choice([o for o in DOORS[door] if o in BEGINS])
        deliver = _doors(flown).give(door, order)
        flown.run(rng.uniform(0.1, 1.0))
        pilot = ACTS["hold mode" if flown.toy.mode != PERSONS_MODE[flown.toy.stack] else "other hold"]
        mind = pilot.does(flown, rng)
        return None if mind is None else ((rng.uniform(OBEY_S, 1.0), deliver), *mind[1:])

    return Act(does, _moves, in_mode, True)


def again(door: str) -> Act:
    """Return the copy of a hold that arrives at a door after another person ordered to begin again."""

    def does(flown: Flight, rng: Random) -> Later | None:
        deliver = _doors(flown).give(door, OperatorOrder.HOLD)
        deliver()
        if not flown.answers or flown.answers[-1].refusal is not None:
            return None
        flown.run(0.6)
        if flown.order(OperatorOrder.BEGIN) is not None:
            return None
        flown.run(rng.uniform(0.1, 0.6))
        deliver()
        return ()

    return Act(does, _held, lambda f: f.guidance.paused and holds(f))


def holds(flown: Flight) -> bool:
    """Return whether the vehicle neither descends nor climbs by our order, or stands."""
    return not flown.toy.flying or flown.toy.mode not in LAND_MODE.values() or flown.hand is Hand.PERSON


def _held(what: str) -> bool:
    return what in (*_NEVER_ON_HOLD, "sinks", *(f"mode {m}" for m in (*LAND_MODE.values(), *RETURN_MODE.values())))


ACTS: dict[str, Act] = {
    "hold mode": switched(PERSONS_MODE), "other hold": switched(_OTHER_HOLD), "manual mode": switched(MANUAL_MODE),
    "stop mode": switched(_STOPS), "land mode": switched(LAND_MODE), "return mode": switched(RETURN_MODE),
    "mission": switched(_MISSION), "station's": switched(VELOCITY_MODE), "our mode": Act(ours, _moves, in_mode, True),
    "disarm": Act(disarms, lambda what: what in ("arm", "take off") or what.startswith("mode"), lambda f: not f.toy.armed),
    "EMERGENCY": ordered(OperatorOrder.EMERGENCY, lambda what: what != "disarm forced", lambda f: not f.toy.armed),
    "HOLD": ordered(OperatorOrder.HOLD, _held, holds), "ABORT": ordered(OperatorOrder.ABORT, _held, holds),
    **{name: failing(name) for name in _FAILSAFES},
    "failsafe warns": Act(warns, lambda what: _moves(what) and what != "setpoint", lambda f: True, toys=True),
    **{f"late {door}": late(door) for door in LATE_DOORS},
    **{f"again {door}": again(door) for door, orders in DOORS.items() if OperatorOrder.HOLD in orders},
}  # fmt: skip


def begins_on_deck(state: str) -> bool:
    """Return whether a state is reached from the deck."""
    return state == Hand.TAKING_OFF.value


def fly(flown: Flight, state: str, act: Act, rng: Random) -> Run | None:
    """Fly one act in a state; None where it changes nothing."""
    flown.requested = ""
    if state == LANDING_ORDERED:
        flown.bring_to(Hand.NOBODY)
        flown.order(OperatorOrder.LAND)
        flown.until(lambda: flown.hand is Hand.OURS)
    elif state == LANDING_LOST:
        if isinstance(flown, ProgramFlown):
            return None
        flown.bring_to(Hand.OURS)
        flown.lost, flown.guidance.command, flown.requested = 1.0, Land(), LAND_MODE[flown.toy.stack]
        flown.run(rng.uniform(0.1, 2.5))
        flown.lost = 0.0
    elif state == HOLDING_REQUESTED:
        flown.bring_to(Hand.OURS)
        flown.guidance.command, flown.requested = None, HOLD_MODE[flown.toy.stack]
        flown.until(lambda: flown.toy.log[-1:] != [] and flown.toy.log[-1][1] == f"mode {flown.requested}")
    else:
        flown.bring_to(Hand(state))
    flown.run(0.0 if flown.requested else rng.uniform(0.0, 7.0 if begins_on_deck(state) else 1.5))
    if (later := act.does(flown, rng)) is None:
        return None
    began_s = at_s = flown.now_s
    flown.toy.refuses_modes = flown.toy.refuses_disarm = False
    again_s = began_s + AGAIN_S
    for _ in range(round(WATCH_S / STEP_S)):
        flown.step()
        while later and flown.now_s >= began_s + later[0][0]:
            later[0][1]()
            later = later[1:]
        if act.by_switch and flown.now_s >= again_s and not act.over(flown):
            flown.toy.switch(flown.chosen)
            again_s += AGAIN_S
            if any(what.startswith("mode ") and at_s - STEP_S <= at <= at_s + OBEY_S for at, what in flown.toy.log):
                at_s = flown.now_s  # a request of ours crossed his choice, of which no report came
    if isinstance(flown, ProgramFlown) and act.by_switch and flown.toy.denied and not act.over(flown):
        return None  # PX4 takes no mission that it does not have
    return judged(flown, act, at_s)


def judged(flown: Flight, act: Act, at_s: float) -> Run:
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
    print(f"{stack.value}: {total} disobeyed (0 required), worst time to obey {worst:.2f} s ({OBEY_S:g} s required)")
    print("\n".join(why), end="\n" if why else "")
    return total


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = described(__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--arducopter", metavar="PATH")
    parser.add_argument("--px4", metavar="PATH")
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--stack", choices=[s.value for s in (Stack.ARDUPILOT, Stack.PX4)], nargs="+")
    parser.add_argument("--state", choices=STATES, nargs="+", default=STATES)
    parser.add_argument("--act", choices=tuple(ACTS), nargs="+", default=tuple(ACTS))
    args = parsed(parser, "--runs 1 --stack PX4 --state ours --act EMERGENCY", argv)
    stacks = [Stack(name) for name in args.stack or ("ArduPilot", "PX4")]
    states, acts = tuple(args.state), tuple(args.act)
    disobeyed = 0
    if args.arducopter or args.px4:
        alone = [name for name in acts if ACTS[name].toys]
        acts = tuple(name for name in acts if name not in alone)
        print(f"no program does this on request: {', '.join(alone)}" if alone else "")
    programs = {stack: path for stack, path in ((Stack.ARDUPILOT, args.arducopter), (Stack.PX4, args.px4)) if path is not None}
    for stack, path in programs.items():
        cells = flown_by_program(stack, path, [(state, name) for state in states for name in acts], args)
        disobeyed += table(stack, states, acts, iter(cells))
    if programs:
        return int(disobeyed > 0)
    logging.disable(logging.WARNING)
    with mapping(args.jobs) as mapped:
        for stack in stacks:
            jobs = [(stack, state, name) for state in states for name in acts]
            disobeyed += table(stack, states, acts, mapped(partial(counted, runs=args.runs, first=args.seed), jobs))
    return int(disobeyed > 0)


if __name__ == "__main__":
    sys.exit(main())
