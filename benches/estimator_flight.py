"""The filter on a real AR.Drone 2.0 flight with motion capture: drift without sightings, and what gaps in them cost.

    python -m benches.estimator_flight [FOLDER]

Sightings of a pad on the floor are synthesised as a camera on the body would make them: where the pad is in the body's axes by
the motion capture, noise, then levelled with the drone's own attitude of that instant, wrong as it may be. Everything else is
the drone's own telemetry. How the captured body sits in the drone's axes nobody wrote down: its nose is where the drone's
velocities fit best, its roll and pitch are what the accelerometer feels in undisturbed flight.
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
from estimator.contracts.geometry import F64, Rotation, skew, wrap_pi
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity, Imu, Range
from estimator.contracts.time import MonoNs, Stamp
from estimator.paths import DeadReckoningPath, MedianMeanPath

FOLDER = Path(__file__).parents[2] / "shared/data/flight_with_mocap"
PAD_MOCAP_M = (0.1, -1.8, 0.0)
SIGMA_M = (0.01, 0.01, 0.015)
SIGMA_YAW_RAD = math.radians(1.0)
DELAY_S = 0.15
COV_ATTITUDE = np.radians(np.diag([0.5, 0.5, 2.0])) ** 2
CALM_S = (17.0, 34.0)
G_M_S2 = 9.80665
FLYING_S = (15.0, 46.0)
PULLED_S = 34.0
"""From here on something pulls the drone aside: accelerometer and motion capture agree on up to 9 degrees of roll, of which its
own attitude has none."""

Event = Imu | Attitude | BodyVelocity | Range | Sighting


@dataclass(frozen=True)
class Recording:
    """The flight. Times in s of its own clock; `ned` is the motion capture's floor, x as it has it, the pad's arrow along it."""

    samples: tuple[Event, ...]
    t: F64
    """(n,) of the motion capture."""
    p_ned: F64
    """(n, 3) m."""
    rpy_rad: F64
    """(n, 3) of R_ned_body by the motion capture, unwrapped."""
    t_told: F64
    rpy_told_rad: F64
    """(m, 3) of the drone's own attitude at `t_told`, unwrapped; its north is its own."""
    p_pad_ned: F64

    def attitude(self, t_s: float) -> Rotation:
        """R_ned_body by the motion capture."""
        return Rotation.from_rpy(*(float(np.interp(t_s, self.t, self.rpy_rad[:, k])) for k in range(3)))

    def attitude_told(self, t_s: float) -> Rotation:
        return Rotation.from_rpy(*(float(np.interp(t_s, self.t_told, self.rpy_told_rad[:, k])) for k in range(3)))

    def d_ned(self, t_s: float) -> F64:
        """(3,) m from the body to the pad."""
        return self.p_pad_ned - np.array([np.interp(t_s, self.t, self.p_ned[:, k]) for k in range(3)])

    def truth(self, t_s: float) -> tuple[F64, float]:
        """(3,) d_body_pad_level and yaw against the arrow."""
        psi = self.attitude(t_s).rpy_rad[2]
        return Rotation.from_rpy(0.0, 0.0, -psi) @ self.d_ned(t_s), psi


def stamp(measured_at_s: float, received_at_s: float | None = None) -> Stamp:
    measured_at = round(measured_at_s * 1e9)
    return Stamp(
        MonoNs(measured_at), MonoNs(measured_at if received_at_s is None else round(received_at_s * 1e9)), 0.002, "synced"
    )


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
    quats = np.stack([mocap["q4"], mocap["q1"], -mocap["q2"], -mocap["q3"]], axis=1)
    told_rpy = np.unwrap(rpy, axis=0)
    sits = Rotation.identity()
    vm = smooth(np.gradient(smooth(p), tm, axis=0))
    # The nose: where the drone says it goes. Then roll and pitch: where undisturbed flight presses its accelerometer.
    captured = captured_rpy(quats, sits)
    seen = (vm[:, 0] + 1j * vm[:, 1]) * np.exp(-1j * captured[:, 2])
    fast = height > 0.3
    nose = float(np.angle(np.vdot(v[fast, 0] + 1j * v[fast, 1], np.interp(t, tm, seen)[fast])))
    sits = sits @ Rotation.from_rpy(0.0, 0.0, nose)
    force = smooth(np.gradient(vm, tm, axis=0)) - np.array([0.0, 0.0, G_M_S2])
    force = np.array([(Rotation.from_quat(q) @ sits).inv @ x for q, x in zip(quats, force, strict=True)])
    calm = (t > CALM_S[0]) & (t < CALM_S[1])
    forward, right = (float(np.mean((f[:, k] - np.interp(t, tm, force[:, k]))[calm])) / G_M_S2 for k in (0, 1))
    sits = sits @ Rotation.from_rpy(-right, forward, 0.0)
    captured = captured_rpy(quats, sits)
    pad = np.array([PAD_MOCAP_M[0], -PAD_MOCAP_M[1], -PAD_MOCAP_M[2]])

    cov_v = np.diag([0.03**2, 0.03**2, UNKNOWN_VAR])
    out: list[Event] = []
    last_height = -1.0
    for k in range(t.size):
        s = stamp(t[k])
        out.append(Imu(s, w[k], f[k]))
        out.append(Attitude(s, Rotation.from_rpy(*rpy[k]), COV_ATTITUDE))
        if height[k] > 0.2:
            out.append(BodyVelocity(s, np.array([v[k, 0], v[k, 1], 0.0]), cov_v))
            if height[k] != last_height:
                out.append(Range(s, float(height[k]), 0.03))
        last_height = height[k]
    return Recording(tuple(out), tm, p, captured, t, told_rpy, pad)


def smooth(x: F64) -> F64:
    """(n, 3) over a fifth of a second."""
    return np.stack([np.convolve(column, np.ones(25) / 25, "same") for column in x.T], axis=1)


def captured_rpy(quats: F64, sits: Rotation) -> F64:
    """(n, 3) unwrapped, of the drone in whose axes the captured body sits so."""
    return np.unwrap(np.array([(Rotation.from_quat(q) @ sits).rpy_rad for q in quats]), axis=0)


def sightings(flight: Recording, rate_hz: float, blind: Sequence[tuple[float, float]], seed: int = 0) -> list[Sighting]:
    """Looks at the pad while flying, heard late, none while `blind`."""
    rng = np.random.default_rng(seed)
    out = []
    for seq, measured_at in enumerate(np.arange(FLYING_S[0] - 2.0, FLYING_S[1], 1.0 / rate_hz).tolist()):
        noise = rng.standard_normal(4)
        if any(a <= measured_at < b for a, b in blind):
            continue
        body, level = flight.attitude(measured_at), flight.attitude_told(measured_at).without_heading()
        d = level @ (body.inv @ flight.d_ned(measured_at) + SIGMA_M * noise[:3])
        yaw = (level @ body.inv).inv.rpy_rad[2] + SIGMA_YAW_RAD * float(noise[3])
        lever = skew(d) @ np.diag([1.0, 1.0, 0.0])
        cov = np.zeros((4, 4))
        cov[:3, :3] = level.rotate_cov(np.diag(np.square(SIGMA_M))) + lever @ COV_ATTITUDE @ lever.T
        cov[3, 3] = SIGMA_YAW_RAD**2
        seen = Sighting(
            stamp(measured_at, measured_at + DELAY_S), seq, "selected", d, wrap_pi(yaw), False, 0.5 * (cov + cov.T), 1.0
        )
        out.append(seen)
    return out


OPTIONS = ekf.EkfOptions(
    velocity_scale=0.9,
    sigma_velocity_scale=0.15,
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
    events = sorted([*flight.samples, *seen], key=lambda e: e.stamp.received_at)
    times, errors, nees = [], [], []
    next_s = FLYING_S[0]
    for event in events:
        received_at = event.stamp.received_at * 1e-9
        if received_at > until_s:
            break
        while received_at > next_s:
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


def cold_starts(flight: Recording, begin_s: Sequence[float], after_s: float = 5.0) -> F64:
    """Start the filter in flight; return (starts, 3): error and 1-sigma of the place (m), probability of a moving pad."""
    events = sorted([*flight.samples, *sightings(flight, 10.0, [])], key=lambda e: e.stamp.received_at)
    rows = []
    for begin in begin_s:
        path, end = EkfPath(), begin + after_s
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
