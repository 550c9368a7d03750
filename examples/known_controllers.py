"""Fly a linear-quadratic regulator or a predictive controller through the mission.

    python -m examples.known_controllers lqr weather_3 [SEED]
    python -m examples.known_controllers mpc weather_3 [SEED]

Both take the vehicle to lean at once, know nothing of wind, delay or the deck's acceleration, and have an integral instead. The
law is compared with them (docs/training.md). Heights and heading stay the law's.
"""

import math
import sys
from typing import Protocol

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from companion.guidance.controller import Knowledge, Target
from companion.guidance.law.controllers import OFFERED, ControllerSetup, make_controller
from companion.guidance.law.follow_deck import FollowDeck, FollowDeckMemory
from companion.guidance.law.gains import regulator, riccati
from estimator.contracts.commands import Command, Lean
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import MonoNs, seconds_between
from sitl.flight.one_flight import fly
from sitl.scenario.scenario import load
from sitl.scenario.settings import settings_for

F64 = NDArray[np.float64]
Q, R = np.diag([0.3, 4.0, 1.0]), np.array([[0.6]])  # costs of the integral, m s; the place, m; the speed, m/s; the lean, m/s^2
LAG_S = 0.25  # time by which a vehicle leans late that bears this cost of the lean
INTEGRAL_MAX_M_S, FAR_M = 3.0, 1.0


def integrators(step_s: float) -> tuple[F64, F64]:
    """Return A and B of [integral of p, p, w] with w' = -u: the pad against a body that leans at once."""
    A = np.array([[1.0, step_s, 0.5 * step_s**2], [0.0, 1.0, step_s], [0.0, 0.0, 1.0]])
    B = np.array([[-(step_s**3) / 6.0], [-0.5 * step_s**2], [-step_s]])
    return A, B


class Lateral(Protocol):
    def lean(self, x: F64, most: float) -> F64:
        """Return the lean of both axes, (2,) m/s^2, for their states x (3, 2)."""
        ...


class Lqr:
    """u = -K x, the gains by the algebraic Riccati equation."""

    def __init__(self, period_s: float, R: F64 = R) -> None:
        A, B = integrators(period_s)
        self._K = regulator(A, B, Q * period_s, R * period_s)[0]

    def lean(self, x: F64, most: float) -> F64:
        return np.asarray(np.clip(-self._K @ x, -most, most))


class Mpc:
    """The same costs over a horizon, with the largest lean as a constraint, solved by accelerated projected gradients.

    Source: Nesterov, Introductory Lectures on Convex Optimization, 2004, sec. 2.2.4 (constant step scheme for strongly convex
    functions); Richter, Jones & Morari, Computational complexity certification for real-time MPC, IEEE TAC 57(6), 2012.
    """

    def __init__(self, step_s: float = 0.1, horizon: int = 20, iterations: int = 40, R: F64 = R) -> None:
        A, B = integrators(step_s)
        n = len(A)
        ahead, by = [np.eye(n)], np.zeros((n * horizon, horizon))
        for k in range(horizon):
            ahead.append(A @ ahead[-1])
            for j in range(k + 1):
                by[n * k : n * k + n, j : j + 1] = ahead[k - j] @ B
        free = np.vstack(ahead[1:])
        weight = np.kron(np.eye(horizon), Q)
        weight[-n:, -n:] = riccati(A, B, Q, R)  # what the regulator costs beyond the horizon
        H = by.T @ weight @ by + np.kron(np.eye(horizon), R)
        self._H, self._f = 0.5 * (H + H.T), by.T @ weight @ free
        values = np.linalg.eigvalsh(self._H)
        self._step, root = 1.0 / values[-1], math.sqrt(values[0] / values[-1])
        self._momentum, self._iterations, self._horizon = (1.0 - root) / (1.0 + root), iterations, horizon

    def lean(self, x: F64, most: float) -> F64:
        f, u = self._f @ x, np.zeros((self._horizon, 2))
        y = u
        for _ in range(self._iterations):
            after = np.clip(y - self._step * (self._H @ y + f), -most, most)
            y, u = after + self._momentum * (after - u), after
        return np.asarray(u[0])


class LateralMemory(Struct, frozen=True, eq=False):
    law: FollowDeckMemory
    integral: tuple[float, float] = (0.0, 0.0)
    at: MonoNs | None = None


class KnownController:
    """A controller behind the port: lateral by one of the above, heights and heading by the law."""

    climb_max_m_s = None

    def __init__(self, name: str, lateral: Lateral, law: FollowDeck) -> None:
        self.name, self._lateral, self._law = name, lateral, law

    def start(self) -> LateralMemory:
        return LateralMemory(self._law.start())

    def ahead(self, memory: LateralMemory, knowledge: Knowledge, seconds: float) -> None:
        return None

    def step(
        self, memory: LateralMemory, now: MonoNs, knowledge: Knowledge, target: Target | None
    ) -> tuple[LateralMemory, Command]:
        law, kept = self._law.step(memory.law, now, knowledge, target)
        dt = 0.0 if memory.at is None else min(0.1, max(0.0, seconds_between(memory.at, now)))
        memory = replace(memory, law=law, at=now)
        relative, body = knowledge.relative, knowledge.body
        if target is None or relative is None or body is None or not isinstance(kept, Lean):
            return memory, kept
        p = relative.d_body_pad_level[:2] - target.d_body_pad_level[:2]
        p = p * min(1.0, FAR_M / max(1e-9, math.hypot(*p)))
        # The integral is kept north and east: the wind does not turn with the nose.
        c, s = math.cos(body.heading_rad), math.sin(body.heading_rad)
        to_level = np.array([[c, s], [-s, c]])
        whole = np.array(memory.integral) + dt * (to_level.T @ p) * (math.hypot(*p) < FAR_M)
        whole *= min(1.0, INTEGRAL_MAX_M_S / max(1e-9, math.hypot(*whole)))
        tilt_rad = math.radians(self._law.response.tilt.max_deg)
        if target.lean_max_rad is not None:
            tilt_rad = min(tilt_rad, target.lean_max_rad)
        most = G_M_S2 * math.tan(tilt_rad) * math.sqrt(0.5)
        lean = self._lateral.lean(np.vstack([to_level @ whole, p, relative.v_pad_level[:2]]), most)
        memory = replace(memory, integral=(float(whole[0]), float(whole[1])))
        return memory, Lean(lean, np.zeros(2), kept.v_level, kept.yaw_rate_rad_s)


def _law(setup: ControllerSetup) -> FollowDeck:
    law = make_controller(ControllerSetup(replace(setup.guidance, controller="follow_deck"), setup.response, setup.view))
    assert isinstance(law, FollowDeck)
    return law


def _cost(setup: ControllerSetup) -> F64:
    """Return the cost of a lean: an AR.Drone leans 0.55 s late, and swings without end at that of a quick vehicle."""
    tilt = setup.response.tilt
    return R * max(1.0, (tilt.delay_s + 2.0 * tilt.damping / tilt.frequency_rad_s + tilt.lag_s) / LAG_S) ** 2


OFFERED["lqr"] = lambda setup: KnownController("lqr", Lqr(1.0 / setup.guidance.rate_hz, _cost(setup)), _law(setup))
OFFERED["mpc"] = lambda setup: KnownController("mpc", Mpc(R=_cost(setup)), _law(setup))


def main(name: str, scenario_name: str, seed: int) -> bool:
    """Fly once; return whether the drone stands on the pad."""
    scenario = load(scenario_name)
    settings = settings_for(scenario, None)
    settings = replace(settings, guidance=replace(settings.guidance, controller=name))
    flight = fly(scenario_name, scenario, seed, settings, "model").as_json()
    print(f"{name} in {scenario_name}: {flight['outcome']} after {flight['duration_s']:.1f} s: {flight['because']}")
    return bool(flight["landed_on_pad"])


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4) or sys.argv[1] not in OFFERED:
        sys.exit(f"usage: python -m examples.known_controllers {{{','.join(OFFERED)}}} SCENARIO [SEED]")
    sys.exit(0 if main(sys.argv[1], sys.argv[2], int(sys.argv[3]) if len(sys.argv) > 3 else 3) else 1)
