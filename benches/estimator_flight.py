"""Measure the filter on a real AR.Drone 2.0 flight with motion capture: its drift without sightings and the cost of gaps in them.

    python -m benches.estimator_flight [FOLDER]

Sightings of a pad on the floor are synthesised as a camera on the body would make them: the pad's position in the body's axes by
motion capture, plus noise, levelled with the drone's own attitude at that instant, wrong as it may be. All other data are the
drone's own telemetry. The rotation from the captured body to the drone's axes is not documented: the heading is the one that fits
the drone's velocities best, roll and pitch are those that fit the accelerometer in undisturbed flight.
"""

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs
from estimator.paths import DeadReckoningPath, MedianMeanPath
from tests.support.mocap_flight import DELAY_S, FLYING_S, FOLDER, Event, MocapFilter, MocapRecording, load, run, sightings

PULLED_S = 34.0
"""Time from which something pulls the drone aside, seconds: accelerometer and motion capture agree on up to 9 degrees of roll,
while the drone's own attitude shows none."""


class OtherPath:
    """One of the thesis' paths, with the same interface."""

    def __init__(self, path: MedianMeanPath | DeadReckoningPath) -> None:
        self.path = path

    def step(self, event: Event) -> None:
        self.path = self.path.step(event)[0] if isinstance(event, Sighting) else self.path.step_samples([event])[0]

    def at(self, now: MonoNs) -> RelativeState | None:
        return self.path.at(now)


PATHS: dict[str, Callable[[], MocapFilter | OtherPath]] = {
    "ekf": MocapFilter,
    "dead_reckoning": lambda: OtherPath(DeadReckoningPath()),
    "median_mean": lambda: OtherPath(MedianMeanPath()),
}


def gaps(flight: MocapRecording, name: str, begin_s: Sequence[float], lengths_s: Sequence[float], rate_hz: float = 10.0) -> F64:
    """Return the error at the end of a gap, horizontal and vertical, and horizontal 0.5 s later, rms, (lengths, 3) m."""
    rows = []
    for length in lengths_s:
        squares = []
        for begin in begin_s:
            end = begin + length
            seen = sightings(flight, rate_hz, [(begin, end)], seed=round(begin))
            t, e, _ = run(flight, PATHS[name](), seen, end + 1.0)
            last = int(np.searchsorted(t, end))
            after = int(np.searchsorted(t, end + DELAY_S + 0.5))
            squares.append([np.sum(e[last, :2] ** 2), e[last, 2] ** 2, np.sum(e[min(after, len(e) - 1), :2] ** 2)])
        rows.append(np.sqrt(np.mean(squares, axis=0)))
    return np.array(rows)


def cold_starts(flight: MocapRecording, begin_s: Sequence[float], after_s: float = 5.0) -> F64:
    """Start the filter in flight; return (starts, 3): error and 1-sigma of the place (m), probability of a moving pad."""
    events = sorted([*flight.samples, *sightings(flight, 10.0, [])], key=lambda e: e.stamp.received_at)
    rows = []
    for begin in begin_s:
        path, end = MocapFilter(), begin + after_s
        for event in events:
            if event.stamp.measured_at * 1e-9 >= begin and event.stamp.received_at * 1e-9 <= end:
                path.step(event)
        state = path.at(MonoNs(round(end * 1e9)))
        if state is None:
            rows.append([math.nan] * 3)
            continue
        error = state.d_body_pad_level - flight.truth(end)[0]
        sigma = math.sqrt(np.trace(state.cov[:3, :3]))
        rows.append([float(np.linalg.norm(error)), sigma, dict(state.details)["probability_moving"]])
    return np.array(rows)


def main(arguments: Sequence[str]) -> int:
    flight = load(Path(arguments[0]) if arguments else FOLDER)
    lengths = (1.0, 3.0, 5.0)
    print("real flight: horizontal / vertical error at the end of a gap without sightings, horizontal 0.5 s later; cm, rms of 6")
    for title, begin in (("undisturbed", (17.0, 19.0, 21.0, 23.0, 25.0, 27.0)), ("pulled", (34.0, 35.0, 36.0, 37.0, 38.0, 39.0))):
        print(f"{title}, gaps from {begin[0]:.0f}-{begin[-1]:.0f} s on")
        for name in PATHS:
            table = gaps(flight, name, begin, lengths) * 100
            drift = float(np.sum(table[:, 0] * lengths) / np.sum(np.square(lengths)))
            cells = "   ".join(f"{n:.0f} s: {r[0]:5.1f} / {r[1]:4.1f} / {r[2]:4.1f}" for n, r in zip(lengths, table, strict=True))
            print(f"  {name:15s} {cells}   drift {drift:.1f} cm/s", flush=True)
    print("with sightings throughout, rms cm forward, right, down; NEES of the place (3 expected)")
    for name in PATHS:
        t, e, nees = run(flight, path := PATHS[name](), sightings(flight, 10.0, []), FLYING_S[1])
        for title, part in (("undisturbed", (t > 18.0) & (t < PULLED_S)), ("pulled", t > PULLED_S)):
            rms = np.sqrt(np.nanmean(e[part] ** 2, axis=0)) * 100
            print(f"  {name:15s} {title:12s} {rms.round(1)}  {np.nanmean(nees[part]):.2f}")
        state = path.at(MonoNs(round((FLYING_S[1] - 0.1) * 1e9)))
        if state is not None and state.path == "ekf":
            named = dict(state.details)
            print(f"  velocity scale {named['velocity_scale']:.3f} +- {named['sigma_velocity_scale']:.3f}, ", end="")
            print(
                f"accelerometer bias {[round(named[f'accel_bias_{k}_m_s2'], 2) for k in 'xyz']} m/s^2, "
                f"moving {named['probability_moving']:.2f}"
            )
    starts = cold_starts(flight, np.arange(PULLED_S, 41.0).tolist())
    print("the filter started in flight, every second from 34 to 40 s; 5 s later:")
    print(f"  off by cm {(100 * starts[:, 0]).round(1)}, 1-sigma {(100 * starts[:, 1]).round(1)}, moving {starts[:, 2].round(2)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
