"""Measure what one event, one answer and one forecast cost in the filter, in floors.

    python -m benches.filter_steps [--seconds 4]

The streams are those of an AR.Drone: 800 samples a second and 30 sightings a second that arrive 120 +- 40 ms late, so that each
sighting is inserted before some 90 samples. The filter is a value, so every step is repeated from the same filter and the
shortest of the repetitions counts: another process on the core makes them longer and never shorter. A floor is one BGR to HSV
conversion and one inRange of a 640x360 frame, the shortest of some.
"""

import argparse
import os
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")

import cv2
import numpy as np

from estimator import ekf
from estimator.contracts.estimates import Sighting
from estimator.contracts.time import MonoNs
from tests.support.estimator_truth import Setting, TruthFlight, events

HORIZONS_S = tuple(0.25 * k for k in range(1, 13))
REPEATED = 8
SHARE = 20
"""One sample out of this many is measured; every sighting is."""


def shortest_s(call: Callable[[], object], times: int = REPEATED) -> float:
    """Return the shortest time of some calls, seconds."""
    took = []
    for _ in range(times):
        began = time.perf_counter()
        call()
        took.append(time.perf_counter() - began)
    return min(took)


def floor_s() -> float:
    px = np.random.default_rng(0).integers(0, 256, (360, 640, 3), dtype=np.uint8)
    return shortest_s(lambda: cv2.inRange(cv2.cvtColor(px, cv2.COLOR_BGR2HSV), (52, 217, 38), (68, 255, 153)), 300)


def measure(seconds: float) -> dict[str, list[float]]:
    """Return the times of steps by kind of event, and of answers and forecasts after them, seconds."""
    streams = Setting(
        seed=4, sea=4, duration_s=seconds, imu_hz=200.0, attitude_hz=200.0, velocity_hz=200.0, range_hz=100.0, baro_hz=100.0,
        sighting_hz=30.0,
    )  # fmt: skip
    filter_, took = ekf.start(), defaultdict(list)
    for n, event in enumerate(events(TruthFlight(streams))):
        before, seen = filter_, isinstance(event, Sighting)
        if seen or n % SHARE == 0:
            took[type(event).__name__].append(shortest_s(lambda event=event, before=before: ekf.step(before, event)))  # type: ignore[misc]
        filter_, _ = ekf.step(filter_, event)
        if seen:
            after, now = filter_, MonoNs(event.stamp.received_at + 1_000_000)

            def answered(after: ekf.Ekf = after, now: MonoNs = now) -> None:
                after.answers.clear()
                ekf.at(after, now)

            took["answer"].append(shortest_s(answered))
            took["forecast"].append(shortest_s(lambda after=after, now=now: ekf.forecast(after, now, HORIZONS_S)))  # type: ignore[misc]
    return took


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description="What an event costs in the filter.")
    parser.add_argument("--seconds", type=float, default=4.0)
    chosen = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    floor, took = floor_s(), measure(chosen.seconds)
    print(f"floor {1e3 * floor:.2f} ms")
    print("| | median us | mean us | median, floors | mean, floors |\n|---|---|---|---|---|")
    for kind, times in took.items():
        later = times[len(times) // 4 :]
        middle, mean = float(np.median(later)), float(np.mean(later))
        print(f"| {kind} | {1e6 * middle:.0f} | {1e6 * mean:.0f} | {middle / floor:.3f} | {mean / floor:.3f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
