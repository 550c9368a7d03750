"""Show the stability margins of the law that follows the deck, the error that it should reach, and the cost of a step.

    python -m benches.law [--response NAME]

The rows leave parts of the law out, or let the vehicle answer otherwise than its response file says. Both come from
`companion.guidance.law.margins`. The second table sets the law beside the bound: the linear-quadratic-Gaussian controller,
which has the vehicle and the disturbances exactly and keeps no margins, at the law's amount of tilt and at three times as much.
"""

import argparse
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from msgspec import structs

from companion.guidance.controller import Knowledge, Target
from companion.guidance.law.follow_deck import FollowDeck
from companion.guidance.law.gains import ObserverNoise, observer, regulator, tilt_model
from companion.guidance.law.margins import PERIOD_S, AxisDisturbances, GaussMarkov, LoopMargins, margins, stationary
from companion.settings.load import find_file, read_toml, shipped_response
from companion.settings.response import Response, TiltResponse, response_from_mapping
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs

SURROUNDINGS = {
    "sea_state_4": AxisDisturbances(),
    # The wind that pushed 8 flights of weather_4, and over the deck the scenario's turbulence and vibration.
    "weather_4": AxisDisturbances(GaussMarkov(0.35, 1.5), sample_m_s2=0.25, downwash_m_s2=GaussMarkov(0.5, 0.3)),
}


def bound(tilt: TiltResponse, around: AxisDisturbances, cost: float) -> tuple[float, float]:
    """Return the standard deviations of place, m, and commanded tilt, m/s^2, of the LQG controller of one axis.

    Args:
        cost: metres of place that cost as much as 1 m/s^2 of tilt.

    Source: Anderson & Moore, Optimal Control: Linear Quadratic Methods, 1990, sec. 8.2.
    """
    vehicle, pushes = tilt_model(tilt, PERIOD_S), (around.gust_m_s2, around.downwash_m_s2, around.deck_m_s2)
    own = len(vehicle.A)
    n, exo = own + len(pushes), slice(own, None)
    keep = np.array([math.exp(-PERIOD_S / push.time_s) for push in pushes])
    A, B, Q, wanted, C = np.zeros((n, n)), np.zeros((n, 1)), 1e-12 * np.eye(n), 1e-12 * np.eye(n), np.zeros((4, n))
    A[:own, :own], A[exo, exo], B[:own, 0] = vehicle.A, np.diag(keep), vehicle.B
    A[1, 1] -= PERIOD_S * around.drag_1_s
    A[0, exo], A[1, exo] = 0.5 * PERIOD_S**2, PERIOD_S
    Q[exo, exo] += np.diag(np.array([push.sigma for push in pushes]) ** 2 * (1.0 - keep**2))
    wanted[0, 0] = 1.0
    # Measured are place, speed, tilt, and the acceleration by tilt and air.
    C[[0, 1, 2, 3], [0, 1, 2, 2]], C[3, own : own + 2] = 1.0, -1.0
    # Errors of place and speed last for some cycles; one cycle's counts as the law's observer counts it.
    R = np.diag([10.0 * around.place_m.sigma**2, 10.0 * around.speed_m_s.sigma**2, 1e-6, around.sample_m_s2**2])
    K, L = regulator(A, B, wanted, np.array([[cost**2]])), observer(A, C, Q, R)
    M = np.block([[A, -B @ K], [L @ C @ A, A - B @ K - L @ C @ A]])
    by_push, by_error = np.vstack([np.eye(n), L @ C]), np.vstack([np.zeros((n, 4)), L])
    X = stationary(M, by_push @ Q @ by_push.T + by_error @ R @ by_error.T)
    return math.sqrt(X[0, 0]), math.sqrt((K @ X[n:, n:] @ K.T)[0, 0])


def _bounds(tilt: TiltResponse) -> Iterator[str]:
    yield f"\n{'':38s} {'cm a side':>9s} {'median':>8s} {'p95':>7s} {'tilt m/s^2':>11s}\n"
    for name, around in SURROUNDINGS.items():
        law = margins(tilt, around=around)
        rows = [(f"{name}: the law", law.error_m, law.command_m_s2)]
        tried = [bound(tilt, around, cost) for cost in np.geomspace(1.0, 1e-4, 200)]
        for times in (1.0, 3.0):
            rows.append((f"bound, {times:g} times the tilt", *min(tried, key=lambda b: abs(b[1] - times * law.command_m_s2))))
        for what, error, lean in rows:
            yield f"{what:38s} {1e2 * error:9.2f} {118 * error:8.2f} {245 * error:7.2f} {lean:11.2f}\n"


def step_cost_s(response: Response, steps: int = 2000) -> float:
    """Return the CPU time of one step of the whole controller, s."""
    law = FollowDeck(response, PERIOD_S)
    memory = law.start()
    R, cov3 = Rotation.identity(), 1e-4 * np.eye(3)
    target = Target(np.array([0.0, 0.0, 0.3]))
    known = []
    for k in range(steps):
        now = MonoNs(k * round(PERIOD_S * 1e9))
        v = np.array([0.01 * math.sin(0.1 * k), 0.0, 0.1])
        relative = RelativeState(now, "ekf", np.array([0.02, -0.01, 1.0]), v, 0.1, 1e-4 * np.eye(7), now, True)
        body = BodyMotion(now, 0.3, v, cov3, v, R, cov3)
        deck = DeckMotion(now, v, v, 1e-4 * np.eye(6), 0.0, 0.0, 0.0, 0.0, 1e-6 * np.eye(4))
        known.append(Knowledge(now, relative, body, deck))
    began = time.process_time()
    for knowledge in known:
        memory, _ = law.step(memory, knowledge.at, knowledge, target)
    return (time.process_time() - began) / steps


def _row(name: str, of: LoopMargins) -> str:
    if not of.stable:
        return f"{name:38s} unstable\n"
    down, up = of.gain
    return (
        f"{name:38s} {down:5.2f} {up:7.2f} {of.phase_deg:7.0f} {1e3 * of.delay_s:8.0f} {of.sensitivity:8.2f}"
        f" {1e2 * of.error_m:9.2f} {1e2 * 1.18 * of.error_m:8.2f} {1e2 * 2.45 * of.error_m:7.2f}\n"
    )


def main() -> int:
    """Print the tables; exit code 1 where the loop stands less than 60 ms of further delay."""
    parser = argparse.ArgumentParser(description="Show the margins, the error and the cost of the law that follows the deck.")
    parser.add_argument("--response", metavar="NAME", help="shipped response or file (default: ardrone2)")
    args = parser.parse_args()
    response = shipped_response("ardrone2")
    if args.response is not None:
        path = find_file(args.response, "responses", Path(), "--response")
        response = response_from_mapping(read_toml(path), str(path))
    tilt, out = response.tilt, sys.stdout
    out.write(f"tilt: delay {1e3 * tilt.delay_s:.0f} ms, {tilt.frequency_rad_s:g} rad/s, damping {tilt.damping:g}, ")
    out.write(f"lag {1e3 * tilt.lag_s:.0f} ms; guidance every {1e3 * PERIOD_S:.0f} ms\n\n")
    heads = ("gain -", "gain +", "phase", "delay ms", "peak", "cm a side", "median", "p95")
    out.write(f"{'':37s} {heads[0]:>6s} {heads[1]:>7s} {heads[2]:>7s} {heads[3]:>8s} {heads[4]:>8s} {heads[5]:>9s}")
    out.write(f" {heads[6]:>8s} {heads[7]:>7s}\n")
    whole = margins(tilt)
    out.write(_row("the law", whole))
    out.write(_row("without the accelerometer", margins(tilt, noise=ObserverNoise(accelerometer=False))))
    out.write(_row("without the delay line", margins(tilt, delay_line=False)))
    for ms in (40, 100):
        late = structs.replace(tilt, delay_s=tilt.delay_s + 1e-3 * ms)
        out.write(_row(f"{ms} ms more delay, unknown", margins(tilt, late)))
        out.write(_row(f"{ms} ms more delay, known", margins(late)))
    for share in (0.7, 1.4):
        other = structs.replace(tilt, frequency_rad_s=share * tilt.frequency_rad_s)
        out.write(_row(f"tilt {share:g} times as quick, unknown", margins(tilt, other)))
    double = AxisDisturbances(gust_m_s2=GaussMarkov(0.42, 2.0))
    out.write(_row("gusts doubled", margins(tilt, around=double)))
    out.writelines(_bounds(tilt))
    out.write(f"\none step of the controller: {1e6 * step_cost_s(response):.0f} us\n")
    return 0 if whole.stable and whole.delay_s >= 0.06 else 1


if __name__ == "__main__":
    sys.exit(main())
