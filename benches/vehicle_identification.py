"""Identification of a vehicle from recorded real flights, with 95 % intervals by bootstrap over pieces of the flight.

    python -m benches.vehicle_identification [--data FOLDER]

From the AR.Drone 2.0 flight with motion capture: rotor drag (body-axis specific force against velocity over the ground, indoors)
and the lag of thrust behind the motors. Its log has no commands, so that its tilt response and delay cannot be identified.
From the ArduCopter dataflash log (a quadcopter of unknown size, hand-flown in loiter): the response of roll and pitch to the
angle requested, as gain, delay, natural frequency and damping of a second-order system.
"""

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from companion.settings.load import SHIPPED
from estimator.contracts.geometry import F64
from sitl.vehicle.airframe import load
from tests.support import mocap_flight

DATA = Path(__file__).parents[2] / "shared/data"
DRAWS = 400
STEP_S = 0.01


def interval(draw: Callable[[F64], F64], pieces: int) -> tuple[F64, F64, F64]:
    """Return the estimate and the ends of its 95 % interval; `draw` takes how often each piece counts."""
    rng = np.random.default_rng(1)
    best = draw(np.ones(pieces))
    many = np.array([draw(np.bincount(rng.integers(0, pieces, pieces), minlength=pieces).astype(float)) for _ in range(DRAWS)])
    low, high = np.percentile(many, [2.5, 97.5], axis=0)
    return best, low, high


def line(name: str, unit: str, found: tuple[float, float, float]) -> str:
    """Return one row of the printout."""
    return f"  {name:<34s} {found[0]:7.3f}  [{found[1]:6.3f}, {found[2]:6.3f}] {unit}\n"


def drag(folder: Path) -> str:
    """Return what the accelerometer says of rotor drag: f = -k v + bias along the body's x and y."""
    flight = mocap_flight.load(folder)
    nav = np.genfromtxt(folder / "imu.csv", delimiter=",", names=True)
    t0 = nav["t_stamp_s"]
    keep = (t0 > mocap_flight.FLYING_S[0]) & (t0 < mocap_flight.FLYING_S[1])
    t = t0[keep]
    smooth = np.ones(40) / 40  # 0.2 s: the motors' vibration is far above the drag's frequencies
    v_ned = np.stack(
        [
            np.interp(t, flight.t, np.convolve(np.gradient(flight.p_ned[:, i], flight.t), np.ones(25) / 25, "same"))
            for i in range(3)
        ],
        -1,
    )
    out = ""
    for axis, column, sign in ((0, "ax", 1.0), (1, "ay", -1.0)):  # the file is forward-left-up
        f = np.convolve(sign * nav[column][keep], smooth, "same")
        v = np.array([(flight.attitude(x).matrix.T @ u)[axis] for x, u in zip(t, v_ned, strict=True)])
        v = np.convolve(v, smooth, "same")
        piece = ((t - t[0]) // 2.0).astype(int)
        pieces = int(piece.max()) + 1
        sums = np.array([[np.bincount(piece, a, pieces) for a in (np.ones_like(v), v, f, v * v, v * f)]])[0]

        def slope(count: F64, sums: F64 = sums) -> F64:
            n, sv, sf, svv, svf = sums @ count
            return np.array([-(n * svf - sv * sf) / (n * svv - sv**2)])

        best, low, high = interval(slope, pieces)
        out += line(f"drag along {'xy'[axis]} (speed rms {v.std():.2f} m/s)", "1/s", (best[0], low[0], high[0]))
    return out


def thrust_lag(folder: Path) -> str:
    """Return the first-order lag of the vertical specific force behind the motors' PWM squared."""
    nav, imu = (np.genfromtxt(folder / name, delimiter=",", names=True) for name in ("navdata.csv", "imu.csv"))
    t = np.arange(mocap_flight.FLYING_S[0], mocap_flight.FLYING_S[1], 0.005)
    pwm = sum(np.interp(t, nav["t_stamp_s"], nav[f"motor{i}"]) ** 2 for i in (1, 2, 3, 4))
    az = np.interp(t, imu["t_stamp_s"], imu["az"])
    piece = ((t - t[0]) // 2.0).astype(int)
    return _best_lag(np.asarray(pwm), az, piece, 0.005, "thrust behind the motors' PWM")


def _best_lag(u: F64, y: F64, piece: F64, step_s: float, name: str) -> str:
    lags = np.arange(0.0, 0.16, 0.005)
    pieces = int(piece.max()) + 1
    f = np.fft.rfftfreq(2 * u.size, step_s)
    u, y = u - u.mean(), y - y.mean()
    wide = np.fft.rfft(u, 2 * u.size)
    # Slow drifts (battery, tilt) and vibration are outside 0.3 to 6 Hz.
    band = (f > 0.3) & (f < 6.0)
    y = np.fft.irfft(np.fft.rfft(y, 2 * y.size) * band)[: y.size]
    stats = []
    for lag in lags:
        x = np.fft.irfft(wide * band / (1.0 + 1j * math.tau * f * lag))[: u.size]
        stats.append([np.bincount(piece, a, pieces) for a in (x * x, x * y, y * y)])
    table = np.array(stats)

    def best(count: F64) -> F64:
        xx, xy, yy = np.moveaxis(table @ count, 1, 0)
        return np.array([lags[np.argmax(xy**2 / (xx * yy))]])

    found = interval(best, pieces)
    xx, xy, yy = table.sum(axis=2)[np.searchsorted(lags, found[0][0])]
    return line(f"{name} (r {xy / math.sqrt(xx * yy):.2f})", "s", tuple(float(x[0]) for x in found))  # type: ignore[arg-type]


def loops_behind_lag(w: float, zeta: float, lag_s: float) -> tuple[float, float]:
    """Return tilt_p and tilt_d for which the loop's slow poles are those of a second-order system, with a motor lag in the loop.

    (s^2 + 2 zeta w s + w^2) (s + c) lag = lag s^3 + s^2 + d s + p, where c = 1 / lag - 2 zeta w is the third pole.

    Raises:
        ValueError: the lag is too long for such a response.
    """
    c = 1.0 / lag_s - 2.0 * zeta * w
    if c <= w:
        raise ValueError(f"a motor lag of {lag_s:g} s is too long for {w:.1f} rad/s")
    return lag_s * w * w * c, lag_s * (w * w + 2.0 * zeta * w * c)


def tilt_response(log: Path) -> tuple[str, tuple[float, float]]:
    """Return the printout of roll and pitch, and the mean (natural frequency rad/s, damping)."""
    from pymavlink import DFReader

    reader = DFReader.DFReader_binary(str(log))
    rows = []
    while (m := reader.recv_match(type=["ATT"])) is not None:
        rows.append((m.TimeMS * 1e-3, m.DesRoll, m.Roll, m.DesPitch, m.Pitch))
    att = np.array(rows)
    first, last = 90.0, 215.0  # hand-flown in loiter; it ends upside down later
    t = np.arange(first, last, STEP_S)
    at = att[(att[:, 0] > first + 2.0) & (att[:, 0] < last), 0]
    piece = ((at - at[0]) // 5.0).astype(int)
    pieces = int(piece.max()) + 1
    delays, zetas = np.arange(0.0, 0.22, 0.02), np.arange(0.4, 1.45, 0.1)
    frequencies = np.geomspace(3.0, 30.0, 22)
    grid = np.array([(d, w, z) for d in delays for w in frequencies for z in zetas])
    s = 1j * math.tau * np.fft.rfftfreq(2 * t.size, STEP_S)
    out, found = "", []
    for name, asked, flown in (("roll", 1, 2), ("pitch", 3, 4)):
        u = np.interp(t, att[:, 0], att[:, asked])
        y = np.interp(at, att[:, 0], att[:, flown])
        wide = np.fft.rfft(u, 2 * t.size)
        stats = []
        for delay, w, zeta in grid:
            x = np.fft.irfft(wide * np.exp(-s * delay) * w * w / (s * s + 2 * zeta * w * s + w * w))[: t.size]
            x = np.interp(at, t, x)
            stats.append([np.bincount(piece, a, pieces) for a in (np.ones_like(x), x, y, x * x, x * y, y * y)])
        table = np.array(stats)

        def best(count: F64, table: F64 = table) -> F64:
            n, sx, sy, sxx, sxy, syy = np.moveaxis(table @ count, 1, 0)
            vx, vy, c = sxx - sx**2 / n, syy - sy**2 / n, sxy - sx * sy / n
            i = int(np.argmin(vy - c**2 / vx))
            # The delay and the lag of a second-order system at low frequency trade off: their sum is known best.
            delay, w, zeta = grid[i]
            return np.array(
                [c[i] / vx[i], delay, w, zeta, delay + 2 * zeta / w, math.sqrt(max(vy[i] - c[i] ** 2 / vx[i], 0) / n[i])]
            )

        value, low, high = interval(best, pieces)
        for k, (what, unit) in enumerate(
            (
                ("gain", "1"),
                ("delay", "s"),
                ("natural frequency", "rad/s"),
                ("damping ratio", "1"),
                ("delay + 2 zeta / w", "s"),
                ("residual", "deg"),
            )
        ):
            out += line(f"{name}: {what}", unit, (float(value[k]), float(low[k]), float(high[k])))
        found.append(value[2:4])
    mean = np.mean(found, axis=0)
    return out, (float(mean[0]), float(mean[1]))


def main() -> int:
    """Print what is found; exit code 2 if the recordings are not there."""
    parser = argparse.ArgumentParser(description="Identify a vehicle's flown properties from recorded real flights.")
    parser.add_argument("--data", type=Path, default=DATA, metavar="FOLDER", help="folder with the recordings")
    args = parser.parse_args()
    folder, log = args.data / "flight_with_mocap", args.data / "mavlink/arducopter_flight.bin"
    for needed in (folder, log):
        if not needed.exists():
            sys.stderr.write(f"error: {needed} is not there: --data names the folder with the recordings\n")
            return 2
    out = sys.stdout
    ardrone = load(SHIPPED / "vehicles/ardrone2.toml")
    out.write("AR.Drone 2.0 with motion capture (estimate, 95 % interval)\n")
    out.write(drag(folder))
    out.write("  (it hovered: an interval that holds 0 or less says that this flight cannot tell)\n")
    out.write(thrust_lag(folder))
    out.write(
        f"  in configs/vehicles/ardrone2.toml: drag {ardrone.drag_per_s[0]} 1/s, motor lag {ardrone.motor_lag_s} s (assumed)\n"
    )
    out.write("ArduCopter quadcopter of unknown size, hand-flown in loiter, 10 Hz log\n")
    text, (w, zeta) = tilt_response(log)
    out.write(text)
    lag = load(SHIPPED / "vehicles/quad_1_5kg.toml").motor_lag_s
    p, d = loops_behind_lag(w, zeta, lag)
    out.write(f"  mean of both: {w:.1f} rad/s, damping {zeta:.2f}\n")
    out.write(f"  behind a motor lag of {lag} s that takes tilt_p = {p:.1f}, tilt_d = {d:.1f}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
