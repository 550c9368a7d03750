"""A drone that lies on the deck: its motors are stopped, and in the air, at any attitude, the rule never fires."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.controller import Impact
from companion.guidance.mission.machine import PHASES, aim, mission_step
from companion.guidance.mission.progress import Progress
from companion.guidance.mission.tipped import tipped
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Land
from estimator.contracts.geometry import Rotation
from estimator.contracts.motion import G_M_S2
from estimator.integrity.parity import Bin
from tests.companion.test_mission_states import cycle
from tests.make import ns

NOUGHT = (0.0, 0.0, 0.0)
OPTIONS = GuidanceOptions()
TOUCHED = Impact(ns(1.0), "accelerometer", 8.0)
LIES = Reason(ReasonCause.TIPPED, 60.0, 50.0)
OURS = (State.COMMIT, State.PRESS, State.GO_AROUND, State.HOLD_BLIND, State.SEARCH, State.PAUSED, State.REFUSED)
NOT_OURS = (State.TAKEN, State.READY, State.LANDED, State.STANDBY, State.EMERGENCY)


def bins(n: int, R_ned_body: Rotation, f_ned: np.ndarray, w: float = 0.0, from_s: float = 2.0) -> list[Bin]:
    """Return tenths of a second of one attitude and one force, m/s^2 in `ned`."""
    f, up = R_ned_body.matrix.T @ f_ned, R_ned_body.matrix[2]
    return [
        Bin(ns(from_s + 0.1 * i), 0.1, NOUGHT, NOUGHT, NOUGHT, NOUGHT, (w, 0.0, 0.0), tuple(f), tuple(up), (1.0, 0.0))
        for i in range(n)
    ]


attitudes = st.tuples(st.floats(-math.pi, math.pi), st.floats(-1.5, 1.5)).map(lambda a: Rotation.from_rpy(a[0], a[1], 0.0))
tilted = st.tuples(st.floats(0.95, math.pi), st.floats(0.0, math.tau))


@pytest.mark.hazard("H4", "A13")
@settings(max_examples=60)
@given(attitudes, st.floats(0.0, 30.0), st.floats(0.0, 5.7), st.floats(0.0, math.tau), st.floats(-8.0, 8.0), st.booleans())
def test_in_the_air_no_attitude_thrust_or_wind_is_lying_on_a_deck(R, thrust, drag, bearing, w, touched):
    """Thrust along the body's axis alone, and a drag up to the largest; a bird may have met it a moment ago."""
    force = -thrust * R.matrix[:, 2] + drag * np.array([math.cos(bearing), math.sin(bearing), 0.0])
    assert tipped(bins(12, R, force, w), [TOUCHED if touched else None], math.radians(20.0)) is None


@settings(max_examples=40)
@given(attitudes, st.lists(st.floats(-40.0, 40.0), min_size=3, max_size=3), st.floats(-8.0, 8.0))
def test_without_a_contact_nothing_at_all_is(R, force, w):
    assert tipped(bins(12, R, np.array(force), w), [None, None], 0.3) is None
    assert tipped(bins(12, R, np.array(force), w, from_s=30.0), [TOUCHED], 0.3) is None


@pytest.mark.hazard("H4", "A13")
@given(tilted, st.floats(-1.5, 1.5), st.floats(-1.0, 1.0))
def test_whoever_lies_on_a_heaving_deck_is_noticed_within_a_second(tilt, heave, w):
    roll, pitch = tilt[0] * math.cos(tilt[1]), tilt[0] * math.sin(tilt[1])
    R = Rotation.from_rpy(roll, 0.0, 0.0) if abs(pitch) > 1.5 else Rotation.from_rpy(roll, pitch, 0.0)
    if math.acos(R.matrix[2, 2]) < 0.9:
        return
    force = np.array([0.0, 0.0, heave - G_M_S2])
    why = tipped(bins(10, R, force, w), [TOUCHED], math.radians(20.0))
    assert why.measured == pytest.approx(math.degrees(math.acos(R.matrix[2, 2])), abs=0.1)
    assert tipped(bins(9, R, force, w), [TOUCHED], math.radians(20.0)) is None


def test_one_lying_sensor_alone_is_none_and_a_vehicle_that_flies_steeply_may_lean_more() -> None:
    weight, side = np.array([0.0, 0.0, -G_M_S2]), Rotation.from_rpy(1.1, 0.0, 0.0)
    # The attitude says 63 degrees over a drone that flies level.
    level = [b._replace(up=tuple(side.matrix[2])) for b in bins(10, Rotation.from_rpy(0.0, 0.0, 0.0), weight)]
    assert tipped(level, [TOUCHED], 0.3) is None
    # The accelerometer feels a weight across the body of a drone whose attitude is level.
    across = [b._replace(up=(0.0, 0.0, 1.0)) for b in bins(10, side, weight)]
    assert tipped(across, [TOUCHED], 0.3) is None
    assert tipped(bins(10, side, weight), [TOUCHED], math.radians(45.0)) is None


@pytest.mark.parametrize("state", OURS)
def test_its_motors_are_stopped_in_every_state_of_ours_and_no_go_around_starts_them(state: State) -> None:
    p = Progress(state, automatic=True, begun=True, stood=False, since=ns(1.0))
    s = cycle(tipped=LIES)
    p, wanted, changes = mission_step(p, s, OPTIONS)
    assert [c.target for c in changes] == [State.DOWN]
    assert wanted == Land(on_deck=True)
    # What a deck in its face, a second pad or time say later starts nothing.
    for t in range(100):
        p, wanted, changes = mission_step(p, structs.replace(cycle(), at=ns(100.0 + t)), OPTIONS)
        assert not changes
        assert wanted == Land(on_deck=True)


@pytest.mark.parametrize("state", NOT_OURS)
def test_a_vehicle_that_somebody_else_flies_is_left_to_him(state: State) -> None:
    assert Event.TIPPED not in PHASES[state].ways
    p = Progress(state, automatic=False, begun=True, stood=False, since=ns(1.0))
    assert not isinstance(aim(p, cycle(tipped=LIES), OPTIONS)[1], Land)
