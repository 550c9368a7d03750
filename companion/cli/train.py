"""`decklander train`: train a policy in the simulated worlds, or train one further, and write its file."""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from companion.base.signals import Stopped
from companion.base.version import version
from companion.cli.options import named_wait, option, refuse_any
from companion.cli.outputs import POLICY, output
from companion.guidance.law.policy import Policy, read_policy
from companion.settings.load import response_model
from estimator.contracts.errors import BadInput, refused
from sitl.scenario.scenario import load
from sitl.scenario.settings import settings_for
from sitl.study.gym.imitation import AS_HANDED_OVER, EpisodesFlown, Imitation, ImitationOptions, RoundProgress, fly_policy
from sitl.study.gym.training import TrainingWorlds

_FRESH = 1_000_000
"""Seeds of the flights that examine a policy begin here; training counts on from its own seed, far below."""
_EXAMINED = 64  # worlds in which a policy is examined
_WORLDS = 192  # worlds in which a policy is trained


DESCRIPTION = (
    "Train a policy for the controller 'policy': a teacher that knows the truth of the simulated worlds shows "
    "a small network what to do wherever the network goes. The same command with --rounds makes the same policy again. "
    "Exit code 1 if it lands fewer than half of its flights on fresh seeds. docs/training.md has more."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(
        parser,
        "scenario",
        "scenarios of one vehicle, each with a vessel on a steady course (default: weather_2 weather_3 weather_4); a policy "
        "expects the winds that it was trained in",
        nargs="*",
        default=["weather_2", "weather_3", "weather_4"],
    )
    output(parser, "--out FILE", "policy file to write (npz)", POLICY, required=True)
    option(parser, "--from FILE", "policy to train further (default: a new policy)", dest="first", type=Path)
    how_long = parser.add_mutually_exclusive_group()
    option(how_long, "--minutes M", "train for so long", type=float)
    option(how_long, "--rounds N", "train for so many rounds (default: 60)", type=int)
    option(parser, "--seed N", "seed of the worlds and of the network (default: 1)", default=1)
    option(parser, "--threads N", "threads that step the worlds (default: 1)", default=1)
    option(parser, "--json", "print one JSON object a round, and the record")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    sound = 0 <= args.seed < _FRESH // 2 and 1 <= args.threads <= 64
    refuse_any(
        (not (args.minutes is None or 0.05 <= args.minutes <= 1e4), f"--minutes must lie in 0.05 to 10000, got {args.minutes}"),
        (not (args.rounds is None or 1 <= args.rounds <= 100_000), f"--rounds must lie in 1 to 100000, got {args.rounds}"),
        (not sound, f"--seed must lie in 0 to {_FRESH // 2 - 1} and --threads in 1 to 64"),
    )
    first = None if args.first is None else read_policy(args.first, "--from")
    scenarios = [load(name) for name in args.scenario]
    if len({scenario.vehicle.file for scenario in scenarios}) > 1:
        raise BadInput(f"{' '.join(args.scenario)}: a policy is trained for one vehicle, and these have several")
    response = response_model(settings_for(scenarios[0], None))
    options = ImitationOptions()
    worlds = [TrainingWorlds(one, max(16, _WORLDS // len(scenarios)), AS_HANDED_OVER, args.threads) for one in scenarios]
    with refused(f"{' '.join(args.scenario)}", ValueError):
        student = Imitation(worlds, response, args.seed, first, options=options)
    curve: list[dict[str, Any]] = []
    began = time.monotonic()

    def share() -> float:
        """Return how much of the training is done, 0 to 1."""
        if args.minutes is not None:
            return (time.monotonic() - began) / (60.0 * float(args.minutes))
        return len(curve) / int(args.rounds or options.rounds)

    record: dict[str, Any] = {
        "scenarios": args.scenario, "vehicle": scenarios[0].vehicle.file, "seed": args.seed, "worlds": _WORLDS,
        "response": {"delay_s": response.tilt.delay_s, "frequency_rad_s": response.tilt.frequency_rad_s},
        "continued": None if first is None else first.record, "versions": {"decklander": version(), "numpy": np.__version__},
    }  # fmt: skip
    policy: Policy | None = None
    try:
        for progress in student.rounds(args.seed * 1000, share):
            curve.append(_point(progress))
            policy = student.policy({**record, "rounds": len(curve), "curve": list(curve)})
            if args.json:
                sys.stdout.write(json.dumps(curve[-1]) + "\n")
                sys.stdout.flush()
            else:
                sys.stderr.write(_words(progress) + "\n")
        assert policy is not None
        with named_wait("examining it on fresh seeds", quiet=args.json):
            fresh = [TrainingWorlds(scenario, _EXAMINED, None, args.threads) for scenario in scenarios]
            examined = [fly_policy(policy, one, _FRESH) for one in fresh]
    except (Stopped, KeyboardInterrupt):
        kept = "before the first round ended: nothing is kept"
        if policy is not None:
            policy.write(args.out)
            kept = f"after {policy.record['rounds']} rounds: their policy is kept in {args.out}, not examined; --from takes it up"
        sys.stderr.write(f"stopped {kept}\n")
        raise
    policy.record["examined"] = {
        name: {"seeds_from": _FRESH, **flown._asdict()} for name, flown in zip(args.scenario, examined, strict=True)
    }
    policy.write(args.out)
    _conclude(args, policy, examined)
    return 0 if min(flown.landed for flown in examined) >= 0.5 else 1


def _point(progress: RoundProgress) -> dict[str, Any]:
    """Return a round as the curve of the record holds it; without episodes there is no share and no distance."""
    flown = progress.flown
    return {
        "round": progress.round, "examples": progress.examples, "error": round(progress.error, 4), "episodes": flown.episodes,
        "landed": round(flown.landed, 3) if flown.episodes else None,
        "distance_m": round(flown.distance_m, 4) if flown.landed > 0.0 else None,
    }  # fmt: skip


def _words(progress: RoundProgress) -> str:
    n, flown = progress.round, progress.flown
    landed = f"{100.0 * flown.landed:3.0f} % of {flown.episodes} landed" if flown.episodes else "none ended"
    beside = f", {100.0 * flown.distance_m:.1f} cm median" if flown.landed > 0.0 else ""
    return f"round {n}: {progress.examples} examples, error {progress.error:.3f}; episodes of its own: {landed}{beside}"


def _conclude(args: argparse.Namespace, policy: Policy, examined: Sequence[EpisodesFlown]) -> None:
    if args.json:
        sys.stdout.write(json.dumps({"record": policy.record, "written": str(args.out)}) + "\n")
        return
    for name, flown in zip(args.scenario, examined, strict=True):
        beside = f" at a median of {100.0 * flown.distance_m:.1f} cm" if flown.landed > 0.0 else ""
        landed = f"{100.0 * flown.landed:.0f} % of {flown.episodes}"
        sys.stdout.write(f"{name}, fresh seeds: it lands {landed} training episodes{beside}\n")
    sys.stdout.write(
        f"written: {args.out}\nfly it: decklander simulate {args.scenario[0]} --perception model "
        f"--set guidance.controller=policy --set guidance.policy_file={args.out}\n"
    )
