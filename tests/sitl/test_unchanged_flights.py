"""The shipped scenarios fly as they always did: new seas, vessels, winds and vehicles are new keys and change nothing by default.

WHY: recordings, measured tables and other people's seeds refer to these flights. WHAT: positions and velocities of vehicle and
pad along eight seconds of physics under a fixed stick, to a tenth of a micrometre, on any machine.
    python -m tests.sitl.test_unchanged_flights
prints what unchanged_flights.json keeps again; a change needs its reason in the commit.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs
from sitl.scenario.scenario import load
from sitl.world.world import Stick, World

KEPT: dict[str, list[list[float]]] = json.loads(Path(__file__).with_name("unchanged_flights.json").read_text())


def fly_fixed_stick(name: str) -> F64:
    """(4, 12) m and m/s: position and velocity of the body and of the pad after 2, 4, 6 and 8 s."""
    world = World(load(name), 3)
    rows = []
    for i in range(1, 161):
        world.advance(MonoNs(i * 50_000_000))
        gaz = -0.5 if i > 60 else 0.1
        world.stick(Stick(0.2 * math.sin(i / 9), 0.15 * math.cos(i / 7), gaz, 0.1, progressive=i % 40 > 8))
        if i == 120:
            world.vehicle.land()
        if i % 40 == 0:
            t = world.truth()
            rows.append(np.concatenate([t.p_body_ned, t.v_body_ned, t.p_pad_ned, t.v_pad_ned]))
    return np.array(rows)


@pytest.mark.parametrize("name", KEPT)
def test_shipped_flights_are_what_they_were(name: str) -> None:
    np.testing.assert_allclose(fly_fixed_stick(name), KEPT[name], rtol=0, atol=1e-7)


if __name__ == "__main__":
    json.dump({each: fly_fixed_stick(each).round(8).tolist() for each in KEPT}, sys.stdout)
