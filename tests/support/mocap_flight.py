"""A real AR.Drone 2.0 flight with motion capture: its samples, its truth, and sightings made from both.

Sightings of a pad on the floor are synthesised as a camera on the body would make them: the motion capture says where the pad is
in the body's axes, noise is added, and the result is levelled with the drone's own attitude of that instant and its error.
Everything else is the drone's own telemetry. Nobody wrote down how the captured body sits in the drone's axes: its nose is where
the drone's velocities fit best, its roll and pitch are what the accelerometer measures in undisturbed flight.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from msgspec import Struct

from estimator import ekf
from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, Rotation, skew, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity, Imu, Range
from estimator.contracts.time import MonoNs, Stamp

FOLDER = Path(__file__).parents[3] / "shared/data/flight_with_mocap"
PAD_MOCAP_M = (0.1, -1.8, 0.0)
SIGMA_M = (0.01, 0.01, 0.015)
SIGMA_YAW_RAD = math.radians(1.0)
DELAY_S = 0.15
COV_ATTITUDE = np.radians(np.diag([0.5, 0.5, 2.0])) ** 2
CALM_S = (17.0, 34.0)
FLYING_S = (15.0, 46.0)
Event = Imu | Attitude | BodyVelocity | Range | Sighting


class MocapRecording(Struct, frozen=True):
    """The flight. Times in s of its own clock; `ned` is the motion capture's floor, x as it has it, the pad's arrow along it."""

    samples: tuple[Event, ...]
    t: F64
    """(n,) of the motion capture."""
    p_ned: F64
    """(n, 3) m."""
    rpy_rad: F64
    """(n, 3) of R_ned_body by the motion capture, unwrapped."""
    t_measured: F64
    rpy_measured_rad: F64
    """(m, 3) of the drone's own attitude at `t_measured`, unwrapped; its north is its own."""
    p_pad_ned: F64

    def attitude(self, t_s: float) -> Rotation:
        """R_ned_body by the motion capture."""
        return Rotation.from_rpy(*(float(np.interp(t_s, self.t, self.rpy_rad[:, k])) for k in range(3)))

    def attitude_measured(self, t_s: float) -> Rotation:
        return Rotation.from_rpy(*(float(np.interp(t_s, self.t_measured, self.rpy_measured_rad[:, k])) for k in range(3)))

    def d_ned(self, t_s: float) -> F64:
        """(3,) m from the body to the pad."""
        return np.asarray(self.p_pad_ned - np.array([np.interp(t_s, self.t, self.p_ned[:, k]) for k in range(3)]))

    def truth(self, t_s: float) -> tuple[F64, float]:
        """(3,) d_body_pad_level and yaw against the arrow."""
        psi = self.attitude(t_s).rpy_rad[2]
        return Rotation.from_rpy(0.0, 0.0, -psi) @ self.d_ned(t_s), psi


def synced_stamp(measured_at_s: float, received_at_s: float | None = None) -> Stamp:
    measured_at = round(measured_at_s * 1e9)
    return Stamp(
        MonoNs(measured_at), MonoNs(measured_at if received_at_s is None else round(received_at_s * 1e9)), 0.002, "synced"
    )


def load(folder: Path = FOLDER) -> MocapRecording:
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
    measured_rpy = np.unwrap(rpy, axis=0)
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
        s = synced_stamp(t[k])
        out.append(Imu(s, w[k], f[k]))
        out.append(Attitude(s, Rotation.from_rpy(*rpy[k]), COV_ATTITUDE))
        if height[k] > 0.2:
            out.append(BodyVelocity(s, np.array([v[k, 0], v[k, 1], 0.0]), cov_v))
            if height[k] != last_height:
                out.append(Range(s, float(height[k]), 0.03))
        last_height = height[k]
    return MocapRecording(tuple(out), tm, p, captured, t, measured_rpy, pad)


def smooth(x: F64) -> F64:
    """(n, 3) over a fifth of a second."""
    return np.stack([np.convolve(column, np.ones(25) / 25, "same") for column in x.T], axis=1)


def captured_rpy(quats: F64, sits: Rotation) -> F64:
    """(n, 3) unwrapped, of the drone in whose axes the captured body sits so."""
    return np.unwrap(np.array([(Rotation.from_quat(q) @ sits).rpy_rad for q in quats]), axis=0)


def sightings(flight: MocapRecording, rate_hz: float, blind: Sequence[tuple[float, float]], seed: int = 0) -> list[Sighting]:
    """Return looks at the pad while flying, received late, none while `blind`."""
    rng = np.random.default_rng(seed)
    out = []
    for seq, measured_at in enumerate(np.arange(FLYING_S[0] - 2.0, FLYING_S[1], 1.0 / rate_hz).tolist()):
        noise = rng.standard_normal(4)
        if any(a <= measured_at < b for a, b in blind):
            continue
        body, level = flight.attitude(measured_at), flight.attitude_measured(measured_at).without_heading()
        d = level @ (body.inv @ flight.d_ned(measured_at) + SIGMA_M * noise[:3])
        yaw = (level @ body.inv).inv.rpy_rad[2] + SIGMA_YAW_RAD * float(noise[3])
        lever = skew(d) @ np.diag([1.0, 1.0, 0.0])
        cov = np.zeros((4, 4))
        cov[:3, :3] = level.rotate_cov(np.diag(np.square(SIGMA_M))) + lever @ COV_ATTITUDE @ lever.T
        cov[3, 3] = SIGMA_YAW_RAD**2
        seen = Sighting(
            synced_stamp(measured_at, measured_at + DELAY_S), seq, "selected", d, wrap_pi(yaw), False, 0.5 * (cov + cov.T), 1.0
        )
        out.append(seen)
    return out


OPTIONS = ekf.EkfOptions(velocity_scale=0.9, sigma_velocity_scale=0.15, sigma_mount_rad=math.radians(0.3), deck_radius_m=3.0)


def run(flight: MocapRecording, seen: Sequence[Sighting], until_s: float, path: ekf.Filter | None = None) -> tuple[F64, F64, F64]:
    """(n,) times, (n, 3) errors of the place, (n,) NEES of it, every 50 ms while flying; nan where there is no belief."""
    events = sorted([*flight.samples, *seen], key=lambda e: e.stamp.received_at)
    path, times, errors, nees = path or ekf.Filter(OPTIONS), [], [], []
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
        path.put([event])
    return np.array(times), np.array(errors), np.array(nees)
