"""The instants of a hard manoeuvre in the commit that no camera shows in time, for an ideal observer at the camera's rate.

    python -m benches.ship_brakes

The ship stops from 1.5 m/s within 1 s, or turns by 60 degrees within 1 s with the pad 3.2 m aft, some time before the contact
would come. The observer knows of it by the first frame that shows the deck three standard deviations beside where it would
be, and lifts an AR.Drone at once, as its climb's response says. Where that is too late, it touches at the speed that the deck
has gained by then. One that stands already, with its whole weight, is dragged by friction alone.
"""

import math
import sys

import numpy as np

from companion.settings.load import load, shipped_response
from companion.settings.response import Response
from estimator.contracts.motion import G_M_S2
from sitl.flight.flight import Timing
from sitl.vehicle.airframe import ContactSettings, Feet
from sitl.vessel.seakeeping import smooth_step

FRAME_S, SIGMA_M, SIGMAS = 1.0 / 30.0, 0.001, 3.0
SLIDE_MAX_M_S = ContactSettings().along_deck_max_m_s
STEP_S, WINDOW_S = 0.001, (0.05, 0.95)
AFT_M, TURN_RAD_S, OVER_S = 3.2, math.radians(120.0), 0.5


def lift_s(response: Response, rate_m_s: float) -> float:
    """Return for how long a descent goes on, in way over rate, after a climb was ordered, s."""
    climb = response.climb
    down = climb.max_m_s * math.log1p(rate_m_s / climb.max_m_s)
    return climb.delay_s + climb.lag_s * (rate_m_s - down) / rate_m_s


def table(name: str, speed_m_s: float, over_s: float, lift: float) -> None:
    """Print what becomes of a manoeuvre after which the deck goes by `speed_m_s` after `over_s`."""
    t = np.arange(0.0, 1.0, STEP_S)
    speed = speed_m_s * smooth_step(t / over_s)[0]
    shows_s = float(t[np.searchsorted(np.cumsum(speed) * STEP_S, SIGMAS * SIGMA_M)])
    timing = Timing()
    known_s = shows_s + timing.frame_delay_s + timing.vision_s + np.linspace(0.0, FRAME_S, 50)
    lifts = np.array([np.mean(known_s + lift <= x) for x in t])
    unsafe = np.where(speed > SLIDE_MAX_M_S, 1.0 - lifts, 0.0)
    among = (t >= WINDOW_S[0]) & (t < WINDOW_S[1])
    too_late = t[unsafe > 0.0]
    sys.stdout.write(
        f"{name}: shown {shows_s:.2f} s after it begins, known {known_s[0]:.2f} to {known_s[-1]:.2f} s, "
        f"a climb takes {lift:.2f} s; "
        f"over {SLIDE_MAX_M_S} m/s in any case from {too_late[0]:.2f} to {too_late[-1]:.2f} s before the contact: "
        f"{100.0 * float(np.mean(unsafe[among])):.0f} % of the instants\n"
    )


def left_m(friction: float) -> float:
    """Return how far from the pad's centre a drone comes to stand that stood on it before the turn, m."""
    pad = drone = np.array([-AFT_M, 0.0])
    v, dragged = np.zeros(2), friction * G_M_S2 * STEP_S
    for t in np.arange(0.0, 4.0, STEP_S).tolist():
        turning = TURN_RAD_S * float(smooth_step(np.array(t / OVER_S))[0] - smooth_step(np.array(t / OVER_S - 1.0))[0])
        slips = turning * np.array([-drone[1], drone[0]]) - v
        v = v + slips * min(1.0, dragged / max(1e-9, math.hypot(*slips)))
        pad, drone = pad + STEP_S * turning * np.array([-pad[1], pad[0]]), drone + STEP_S * v
    return math.dist(pad, drone)


def main() -> None:
    """Print both manoeuvres."""
    settings = load("sim")
    lift = lift_s(shipped_response("ardrone2"), settings.guidance.cone.commit_rate_m_s)
    table("stops", 1.5, 1.0, lift)
    table("turns", AFT_M * TURN_RAD_S, OVER_S, lift)
    mu = Feet().friction
    sys.stdout.write(f"turns: a drone that stands, with friction {mu:g}, is left {left_m(mu):.2f} m from the pad's centre\n")


if __name__ == "__main__":
    main()
