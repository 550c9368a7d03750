"""A sample of the bench that sets the vehicle beside RotorPy's: the response to a tilt step, and the air's drag."""

import pytest

pytest.importorskip("rotorpy", reason="RotorPy is not installed (requirements/rotorpy.in)")
from benches.witness.body import VEHICLE, Ours, Theirs, moving, tilt_step
from sitl.vehicle.airframe import load


def test_the_vehicle_answers_and_is_braked_as_in_rotorpy() -> None:
    f = load(VEHICLE).airframe()
    ours, theirs = (tilt_step(kind(f), 10.0) | moving(kind(f), 5.0, 0.0) for kind in (Ours, Theirs))
    for name in ("10 to 90 %, ms", "drag, m/s^2"):
        assert ours[name] == pytest.approx(theirs[name], rel=0.2), name
