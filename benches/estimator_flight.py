"""The filter on a real AR.Drone 2.0 flight with motion capture: drift without sightings, and what gaps in them cost.

    python -m benches.estimator_flight [FOLDER]

Sightings are synthesised from the motion capture (a pad on the floor below); everything else is the drone's own telemetry. The
drone has its own north; it is tied to the motion capture's axes by the one angle that fits its velocities best.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimator import ekf
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity, Imu, Range
from estimator.contracts.time import MonoNs, Stamp
from estimator.paths import DeadReckoningPath, MedianMeanPath

FOLDER = Path(__file__).parents[2] / "shared/data/flight_with_mocap"
PAD_MOCAP_M = (0.1, -1.8, 0.0)
SIGMA_M = (0.01, 0.01, 0.015)
SIGMA_YAW_RAD = math.radians(1.0)
DELAY_S = 0.15
FLYING_S = (15.0, 34.0)
"""Later something pulls the drone aside: accelerometer and motion capture agree on 10 degrees of roll, its attitude has none.
Sightings levelled by that attitude would be off; those made from the motion capture are not, so that part shows nothing."""

Event = Imu | Attitude | BodyVelocity | Range | Sighting


@dataclass(frozen=True)
class Recording:
    """The flight. Times in s of its own clock; `ned` has the drone's own north, its origin where the motion capture has it."""

    samples: tuple[Event, ...]
    t: F64
    """(n,) of the motion capture."""
    p_ned: F64
    """(n, 3) m."""
    t_heading: F64
    heading_rad: F64
    """Unwrapped, by the drone."""
    p_pad_ned: F64
    heading_pad_rad: float

    def truth(self, t_s: float) -> tuple[F64, float]:
        """(3,) d_body_pad_level and yaw against the arrow."""
        p = np.array([np.interp(t_s, self.t, self.p_ned[:, k]) for k in range(3)])
        psi = float(np.interp(t_s, self.t_heading, self.heading_rad))
        Z = Rotation.from_rpy(0.0, 0.0, -psi)
        return Z @ (self.p_pad_ned - p), wrap_pi(psi - self.heading_pad_rad)


def stamp(taken_s: float, heard_s: float | None = None) -> Stamp:
    taken = round(taken_s * 1e9)
    return Stamp(MonoNs(taken), MonoNs(taken if heard_s is None else round(heard_s * 1e9)), 0.002, "synced")


def load(folder: Path = FOLDER) -> Recording:
    """Read the three tables (forward-left-up, as recorded) and turn them into samples (forward-right-down)."""
    nav, imu, mocap = (
        np.genfromtxt(folder / name, delimiter=",", names=True) for name in ("navdata.csv", "imu.csv", "optitrack.csv")
    )
    t = nav["t_stamp_s"]
    flip = np.array([1.0, -1.0, -1.0])
    f = np.stack([imu["ax"], imu["ay"], imu["az"]], axis=1) * flip
    w = np.stack([imu["wx"], imu["wy"], imu["wz"]], axis=1) * flip
    rpy = np.radians(np.stack([nav["rotX_deg"], nav["rotY_deg"], nav["rotZ_deg"]], axis=1)) * flip
    v = np.stack([nav["vx_mm_s"], -nav["vy_mm_s"]], axis=1) * 1e-3
    height = nav["altd_mm"] * 1e-3

    tm = mocap["t_stamp_s"]
    p = np.stack([mocap["x_m"], -mocap["y_m"], -mocap["z_m"]], axis=1)
    vm = np.gradient(p[:, 0] + 1j * p[:, 1], tm)
    vm = np.convolve(vm, np.ones(13) / 13, "same")
    told = (v[:, 0] + 1j * v[:, 1]) * np.exp(1j * rpy[:, 2])
    fast = height > 0.3
    angle = float(np.angle(np.vdot(np.interp(t, tm, vm)[fast], told[fast])))
    to_ned = Rotation.from_rpy(0.0, 0.0, angle)
    pad = np.array([PAD_MOCAP_M[0], -PAD_MOCAP_M[1], -PAD_MOCAP_M[2]])

    cov_att = np.radians(np.diag([0.5, 0.5, 2.0])) ** 2
    cov_v = np.diag([0.03**2, 0.03**2, UNKNOWN_VAR])
    out: list[Event] = []
    last_height = -1.0
    for k in range(t.size):
        s = stamp(t[k])
        out.append(Imu(s, w[k], f[k]))
        out.append(Attitude(s, Rotation.from_rpy(*rpy[k]), cov_att))
        if height[k] > 0.2:
            out.append(BodyVelocity(s, np.array([v[k, 0], v[k, 1], 0.0]), cov_v))
            if height[k] != last_height:
                out.append(Range(s, float(height[k]), 0.03))
        last_height = height[k]
    return Recording(
        tuple(out), tm, to_ned_all(to_ned, p), t, np.unwrap(rpy[:, 2]), to_ned @ pad, wrap_pi(angle)
    )  # fmt: skip


def to_ned_all(R: Rotation, p: F64) -> F64:
    return np.asarray(p @ R.matrix.T)


def sightings(flight: Recording, rate_hz: float, blind: Sequence[tuple[float, float]], seed: int = 0) -> list[Sighting]:
    """Looks at the pad while flying, heard late, none while `blind`."""
    rng = np.random.default_rng(seed)
    out = []
    for seq, taken in enumerate(np.arange(FLYING_S[0] - 2.0, FLYING_S[1], 1.0 / rate_hz).tolist()):
        d, yaw = flight.truth(taken)
        noise = rng.standard_normal(4)
        if any(a <= taken < b for a, b in blind):
            continue
        cov = np.diag([*SIGMA_M, SIGMA_YAW_RAD]) ** 2
        seen = wrap_pi(yaw + SIGMA_YAW_RAD * noise[3])
        out.append(
            Sighting(stamp(taken, taken + DELAY_S), seq, "selected", d + SIGMA_M * noise[:3], seen, False, cov, 1.0)
        )  # fmt: skip
    return out


OPTIONS = ekf.EkfOptions(
    velocity_scale=0.9,
    sigma_velocity_scale=0.15,
    sighting_has_attitude_error=False,
    sigma_mount_rad=math.radians(0.3),
    deck_radius_m=3.0,
)


class EkfPath:
    """The filter behind the shape of the other paths."""

    def __init__(self) -> None:
        self.memory = ekf.start(OPTIONS)

    def step(self, event: Event) -> None:
        self.memory, _ = ekf.step(self.memory, event)

    def at(self, now: MonoNs) -> RelativeState | None:
        return ekf.at(self.memory, now)


class OtherPath:
    """One of the thesis' paths, held the same way."""

    def __init__(self, path: MedianMeanPath | DeadReckoningPath) -> None:
        self.path = path

    def step(self, event: Event) -> None:
        self.path = self.path.step(event)[0]

    def at(self, now: MonoNs) -> RelativeState | None:
        return self.path.at(now)


PATHS: dict[str, Callable[[], EkfPath | OtherPath]] = {
    "ekf": EkfPath,
    "dead_reckoning": lambda: OtherPath(DeadReckoningPath()),
    "median_mean": lambda: OtherPath(MedianMeanPath()),
}


def run(flight: Recording, path: EkfPath | OtherPath, seen: Sequence[Sighting], until_s: float) -> tuple[F64, F64, F64]:
    """(n,) times, (n, 3) errors of the place, (n,) NEES of it, every 50 ms while flying; nan where there is no belief."""
    events = sorted([*flight.samples, *seen], key=lambda e: e.stamp.heard)
    times, errors, nees = [], [], []
    next_s = FLYING_S[0]
    for event in events:
        heard = event.stamp.heard * 1e-9
        if heard > until_s:
            break
        while heard > next_s:
            state = path.at(MonoNs(round(next_s * 1e9)))
            error = np.full(3, np.nan)
            if state is not None:
                error = state.d_body_pad_level - flight.truth(next_s)[0]
            times.append(next_s)
            errors.append(error)
            nees.append(math.nan if state is None else float(error @ np.linalg.solve(state.cov[:3, :3], error)))
            next_s += 0.05
        path.step(event)
    return np.array(times), np.array(errors), np.array(nees)


def gaps(flight: Recording, name: str, begin_s: Sequence[float], lengths_s: Sequence[float], rate_hz: float = 10.0) -> F64:
    """(lengths, 3) m: error at the end of a gap, horizontal and vertical, and horizontal 0.5 s later; rms over the gaps."""
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


def main(arguments: Sequence[str]) -> int:
    flight = load(Path(arguments[0]) if arguments else FOLDER)
    lengths = (1.0, 3.0, 5.0)
    begin = (17.0, 19.0, 21.0, 23.0, 25.0, 27.0)
    print("real flight: horizontal / vertical error at the end of a gap without sightings, horizontal 0.5 s later; cm, rms of 6")
    for name in PATHS:
        table = gaps(flight, name, begin, lengths) * 100
        drift = float(np.sum(table[:, 0] * lengths) / np.sum(np.square(lengths)))
        cells = "   ".join(f"{n:.0f} s: {r[0]:5.1f} / {r[1]:4.1f} / {r[2]:4.1f}" for n, r in zip(lengths, table, strict=True))
        print(f"  {name:15s} {cells}   drift {drift:.1f} cm/s")
    t, e, nees = run(flight, path := EkfPath(), sightings(flight, 10.0, []), FLYING_S[1])
    settled = t > 18.0
    rms = np.sqrt(np.nanmean(e[settled] ** 2, axis=0)) * 100
    print(
        f"  ekf with sightings throughout: rms {rms.round(1)} cm, NEES of the place {np.nanmean(nees[settled]):.2f} (3 expected)"
    )
    state = path.at(MonoNs(round((FLYING_S[1] - 0.1) * 1e9)))
    if state is not None:
        named = dict(state.details)
        print(f"  velocity scale {named['velocity_scale']:.3f} +- {named['sigma_velocity_scale']:.3f}, ", end="")
        print(
            f"accelerometer bias {[round(named[f'accel_bias_{k}_m_s2'], 2) for k in 'xyz']} m/s^2, "
            f"moving {named['probability_moving']:.2f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
