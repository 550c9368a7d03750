"""Show how many steps a second the training worlds take, beside other environments on this machine.

    python -m benches.gym [--worlds 64] [--seconds 5] [--peer PYTHON]

A step is one command: 20 ms of four steps of physics. The peers are Gymnasium's pendulum, a floor of what a step in Python costs,
and PyFlyt's quadrotor, by another interpreter where that has it: PyFlyt needs an older numpy than ours.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Callable

import gymnasium
import numpy as np

from sitl.gym.environment import LandVectorEnv


def rate(step: Callable[[], None], worlds: int, seconds: float) -> tuple[float, float]:
    """Return the steps of all worlds together, a second of the clock and a second of CPU time."""
    step()
    taken, began, cpu = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - began < seconds:
        step()
        taken += worlds
    return taken / (time.perf_counter() - began), taken / (time.process_time() - cpu)


def _ours(worlds: int, threads: int, perception: str, scenario: str) -> Callable[[], None]:
    env = LandVectorEnv(worlds, scenario, perception=perception, threads=threads)  # type: ignore[arg-type]
    env.reset(seed=0)
    actions = 0.2 * np.random.default_rng(0).standard_normal((64, worlds, 4)).astype(np.float32)
    turn = iter(range(1 << 60))
    return lambda: (env.step(actions[next(turn) % len(actions)]), None)[1]


def _peer(name: str) -> Callable[[], None]:
    env = gymnasium.make(name)
    env.reset(seed=0)

    def step() -> None:
        _, _, ended, cut, _ = env.step(env.action_space.sample())
        if ended or cut:
            env.reset()

    return step


_PYFLYT = """
import sys, time
import gymnasium, PyFlyt.gym_envs
env = gymnasium.make("PyFlyt/QuadX-Hover-v4")
env.reset(seed=0)
taken, began, cpu = 0, time.perf_counter(), time.process_time()
while time.perf_counter() - began < float(sys.argv[1]):
    _, _, ended, cut, _ = env.step(env.action_space.sample())
    if ended or cut:
        env.reset()
    taken += 1
print("rates", taken / (time.perf_counter() - began), taken / (time.process_time() - cpu))
"""


def _pyflyt(python: str, seconds: float) -> tuple[float, float]:
    done = subprocess.run([python, "-c", _PYFLYT, str(seconds)], capture_output=True, text=True, check=True)
    wall, cpu = done.stdout.splitlines()[-1].split()[1:]
    return float(wall), float(cpu)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--peer", help="interpreter that has PyFlyt")
    args = parser.parse_args()
    rows = []
    for scenario in ("sea_state_4", "weather_4"):
        for perception, threads in (("truth", 1), ("model", 1), ("model", 2)):
            name = f"{scenario}, {perception}, {threads} thread{'s' * (threads > 1)}"
            rows.append((name, _ours(args.worlds, threads, perception, scenario), args.worlds))
    rows.append(("one world alone, sea_state_4", _ours(1, 1, "model", "sea_state_4"), 1))
    rows.append(("Gymnasium's Pendulum-v1", _peer("Pendulum-v1"), 1))
    sys.stdout.write(f"{args.worlds} worlds\n{'':34s} {'steps/s':>10s} {'steps/CPU s':>12s}\n")
    for name, step, worlds in rows:
        wall, cpu = rate(step, worlds, args.seconds)
        sys.stdout.write(f"{name:34s} {wall:10,.0f} {cpu:12,.0f}\n")
    if args.peer is not None:
        wall, cpu = _pyflyt(args.peer, args.seconds)
        sys.stdout.write(f"{'PyFlyt/QuadX-Hover-v4':34s} {wall:10,.0f} {cpu:12,.0f}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
