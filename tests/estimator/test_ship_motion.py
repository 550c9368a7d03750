"""The ship's motion sensors beside the camera: what is found of them, what is left out, and what the filter knows by them."""

import math
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from drivers.nmea import network_log as network
from estimator.contracts.estimates import Pose6, Sighting, Verdict
from estimator.contracts.geometry import F64, Rotation, rpy_matrix
from estimator.contracts.samples import VesselMotion, VesselReport
from estimator.ekf import Event, Forecast
from estimator.options import EstimatorOptions
from estimator.pipeline import RelativeEstimator
from estimator.ship_motion import ShipMotion, ShipMotionOptions, Standing
from tests.support.estimator_truth import OPTIONS, Setting, TruthFlight, events, ns, stamp

BOAT = Path(__file__).parents[3] / "shared/data/boat_nmea2000"
SEEN_S = 30.0
"""Instant at which the pad comes into sight; the sensor speaks from the start."""
Sensor = Callable[[float], tuple[float, float, float]]


def swell(t: float) -> tuple[float, float, float]:
    """Return down, m, roll and pitch, rad, of the pad's centre: two waves each."""
    down = 0.6 * math.sin(1.05 * t) + 0.25 * math.sin(1.6 * t + 1.0)
    return down, 0.05 * math.sin(0.9 * t), 0.04 * math.sin(1.05 * t + 2.0) + 0.015 * math.sin(0.6 * t)


def seen(t: float, rng: np.random.Generator, moves: Sensor = swell) -> tuple[Sighting, float]:
    """Return a sighting of the deck from 5 m above, and the place of a body whose IMU drifts by a parabola."""
    down, roll, pitch = moves(t)
    drift = 0.3 * t + 0.03 * t * t
    d = np.array([0.3, -0.2, 5.0 + down]) + 0.01 * rng.standard_normal(3)
    R = Rotation(rpy_matrix(roll + 0.02 + 0.005 * rng.standard_normal(), pitch - 0.01 + 0.005 * rng.standard_normal(), 0.4))
    pose = Pose6(d, R, 1e-4 * np.eye(6))
    return Sighting(stamp(t, t + 0.05), 1, "registration", d, -0.4, False, 1e-4 * np.eye(4), 1.0, pose), drift


def beside_camera(
    sensor: Sensor,
    *,
    until_s: float,
    hz: float = 5.0,
    late_s: float = 0.1,
    moves: Sensor = swell,
    options: ShipMotionOptions | None = None,
    yaw: float = 0.0,
    names: dict[str, Sensor] | None = None,
) -> tuple[ShipMotion, float | None]:
    """Return the witness after a flight, and when it first named a sensor, s after the pad came into sight."""
    rng, witness, named = np.random.default_rng(7), ShipMotion(options or ShipMotionOptions(), yaw), None
    sensors = {"PSXN": sensor} if names is None else names
    for k in range(round(10.0 * until_s)):
        t = 0.1 * k
        if k % round(10.0 / hz) == 0:
            for name, of in sensors.items():
                down, roll, pitch = of(t - late_s)
                witness.reported(VesselMotion(stamp(t, t + 0.01), name, roll, pitch, 1e-5, down, 1e-3))
        if t >= SEEN_S:
            witness.sighted(*seen(t, rng, moves))
        if witness.lost and named is None:
            named = t - SEEN_S
    return witness, named


def only(witness: ShipMotion) -> Standing:
    (standing,) = witness.standings()
    return standing


@pytest.mark.parametrize("late_s", [0.0, 0.25, 0.45])
def test_delay_and_noise_are_found_against_the_camera(late_s: float) -> None:
    rng = np.random.default_rng(3)

    def noisy(t: float) -> tuple[float, float, float]:
        down, roll, pitch = swell(t)
        return down + 0.1 * rng.standard_normal(), roll, pitch

    witness, named = beside_camera(noisy, until_s=55.0, late_s=late_s)
    found = only(witness)
    assert named is None
    assert found.used == ("heave", "tilt")
    assert abs(found.delay_s - late_s) < 2.5 * found.sigma_delay_s < 0.15
    assert 0.03 < found.noise_m < 0.12
    assert found.noise_rad < math.radians(0.4)


FAULTS: dict[str, tuple[Sensor, str]] = {
    "wrong sign of the heave": (lambda t: (-swell(t)[0], *swell(t)[1:]), "its sign is wrong"),
    "double": (lambda t: (2.0 * swell(t)[0], *swell(t)[1:]), "it is double"),
    "wrong sign of the tilt": (lambda t: (swell(t)[0], -swell(t)[1], -swell(t)[2]), "tilt and the camera"),
    "frozen": (lambda t: swell(min(t, SEEN_S - 1.0)), "repeat"),
    "always the same": (lambda t: (0.0, 0.0, 0.0), "the camera"),
    "wandering": (lambda t: (swell(t)[0] + 1.5 * math.sin(t / 6.0), *swell(t)[1:]), "wanders"),
    "a second late": (lambda t: swell(t - 1.0), "camera"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_sensor_that_lies_is_named_within_five_seconds_of_sight(name: str) -> None:
    sensor, words = FAULTS[name]
    witness, named = beside_camera(sensor, until_s=SEEN_S + 6.0)
    assert named <= 5.0
    assert any(words in why for why in witness.lost), witness.lost
    assert len(only(witness).used) < 2


def test_a_liar_in_flat_water_is_named_and_a_good_one_is_not() -> None:
    flat: Sensor = lambda t: (0.0, 0.0, 0.0)  # noqa: E731
    witness, named = beside_camera(lambda t: (1.5 * math.sin(t / 9.0), 0.0, 0.0), until_s=SEEN_S + 5.0, moves=flat)
    assert named is not None
    assert any("wanders" in why for why in witness.lost)
    assert beside_camera(flat, until_s=SEEN_S + 5.0, moves=flat)[1] is None


@pytest.mark.parametrize("period_s", [14.0, 18.0, 22.0])
def test_a_good_sensor_in_a_long_swell_is_not_named(period_s: float) -> None:
    swell_of: Sensor = lambda t: (math.sin(math.tau * t / period_s), 0.02 * math.sin(math.tau * t / period_s + 1.0), 0.0)  # noqa: E731
    witness, named = beside_camera(swell_of, until_s=SEEN_S + 15.0, moves=swell_of)
    assert named is None, witness.lost


@lru_cache
def recorded_heave(name: str) -> tuple[tuple[float, float], ...]:
    """Return instants, s, and heave downward, m, of the set whose heave wanders."""
    rows = [s for s in network.read(BOAT / f"{name}.raw", lambda _: None) if isinstance(s, VesselMotion)]
    return tuple((s.stamp.measured_at * 1e-9, s.heave_down_m) for s in rows if s.sensor == "src 27" and s.heave_down_m)


@pytest.mark.skipif(not BOAT.is_dir(), reason="the recorded boat is not here")
@pytest.mark.parametrize("name", ["furuno-130842", "furuno-130842-accel"])
@pytest.mark.parametrize("begin_s", [0.0, 60.0, 120.0, 180.0])
def test_a_recorded_heave_of_a_boat_in_flat_water_is_named_within_five_seconds_of_sight(name: str, begin_s: float) -> None:
    heave = [(at - begin_s, down) for at, down in recorded_heave(name)]
    rng, witness = np.random.default_rng(2), ShipMotion(ShipMotionOptions(), 0.0)
    for k in range(round(10.0 * (SEEN_S + 5.0))):
        t = 0.1 * k
        while heave and heave[0][0] <= t:
            at, down = heave.pop(0)
            if at >= 0.0:
                witness.reported(VesselMotion(stamp(at, at + 0.01), "src 27", None, None, 0.0, down, 0.003))
        if t >= SEEN_S:
            witness.sighted(*seen(t, rng, lambda t: (0.0, 0.0, 0.0)))
    assert any("heave" in why for why in witness.lost)
    assert only(witness).used == ()


def test_in_sight_nobody_is_fused_before_the_camera_has_agreed() -> None:
    rng, witness, taken = np.random.default_rng(1), ShipMotion(ShipMotionOptions(), 0.0), []
    for k in range(400):
        t = 0.1 * k
        down, roll, pitch = swell(t)
        made = witness.reported(VesselMotion(stamp(t), "PSXN", roll, pitch, 1e-5, down, 1e-3)) if k % 2 == 0 else None
        if isinstance(made, VesselMotion):
            taken.append(t - SEEN_S)
        if t >= SEEN_S:
            witness.sighted(*seen(t, rng))
    assert min(taken) < -20.0
    assert [t for t in taken if 0.2 < t < 2.0] == []
    assert max(taken) > 8.0


@pytest.mark.parametrize(("sign", "confirms"), [(1.0, True), (-1.0, False)])
def test_the_camera_confirms_a_sensor_that_begins_together_with_sight(sign: float, confirms: bool) -> None:
    rng, witness = np.random.default_rng(1), ShipMotion(ShipMotionOptions(), 0.0)
    for k in range(100):
        down, roll, pitch = (sign * x for x in swell(0.1 * k))
        witness.reported(VesselMotion(stamp(0.1 * k), "PSXN", roll, pitch, 1e-5, down, 1e-3))
        witness.sighted(*seen(0.1 * k, rng))
        assert k > 20 or not witness.confirmed(ns(0.1 * k))
    assert [witness.confirmed(ns(t)) for t in (10.0, 13.0)] == [confirms, False], "a silent one says nothing of now"


def test_motion_is_that_of_the_pad_and_about_its_arrow() -> None:
    """A sensor 20 m ahead of the pad, 2 m to port of it, and an arrow that points to starboard."""
    options, roll, pitch = ShipMotionOptions(forward_m=20.0, right_m=-2.0), 0.02, 0.03
    witness = ShipMotion(options, math.pi / 2.0)
    made = None
    for k in range(601):  # a mean of zero over a minute, and then this
        t, sign = 0.1 * k, (-1.0) ** (k // 10)
        last = k == 600
        report = VesselMotion(stamp(t), "MRU", sign * roll, sign * pitch, 0.0, sign * 0.1, 0.0)
        result = witness.reported(report)
        made = result if last else made
    # Bow up puts what lies aft of the sensor lower; starboard down what lies to starboard of it.
    assert made.heave_down_m == pytest.approx(0.1 + 20.0 * pitch + 2.0 * roll, abs=0.02)
    assert (made.roll_rad, made.pitch_rad) == pytest.approx((pitch, -roll), abs=2e-3)


def test_the_begin_of_a_manoeuvre_is_felt_and_a_sensor_that_leaps_ends_nothing_for_long() -> None:
    """A ship on waves of 0.3 m/s^2 brakes from 40 s on. Her rate of turn has noise alone; one acceleration leaps every 2 s."""
    for leaps in (0.0, 1.0):
        rng, witness, felt = np.random.default_rng(5), ShipMotion(ShipMotionOptions(), 0.0), []
        for k in range(2050):
            t, leap = 0.02 * k, leaps * (k % 100 == 0 and k >= 500)
            a = abs(0.3 * math.sin(1.1 * t) + 45.0 * max(0.0, t - 40.0) ** 2 + leap + 0.02 * rng.standard_normal())
            witness.feel(VesselMotion(stamp(t, t), "MRU", acceleration_m_s2=a))
            witness.feel(VesselReport(stamp(t, t), None, None, None, None, 0.0035 * rng.standard_normal(), 0.0035))
            felt += [t] if witness.jolted(ns(t)) else []
        assert 40.0 < min(t for t in felt if t > 20.0 * leaps) < 40.25, "waves and noise are usual, and soon a leap"


def test_steps_that_no_ship_makes_and_frozen_numbers_are_refused() -> None:
    witness = ShipMotion(ShipMotionOptions(), 0.0)
    for k in range(100):
        witness.reported(VesselMotion(stamp(0.1 * k), "MRU", *swell(0.1 * k)[1:], 0.0, swell(0.1 * k)[0], 0.0))
    down, roll, pitch = swell(9.9)
    assert witness.reported(VesselMotion(stamp(10.0), "MRU", roll, pitch, 0.0, down + 3.0, 0.0)) is Verdict.IMPOSSIBLE
    verdicts = [witness.reported(VesselMotion(stamp(10.1 + 0.1 * k), "MRU", roll, pitch, 0.0, down, 0.0)) for k in range(50)]
    assert Verdict.FROZEN in verdicts
    assert "repeat" in witness.lost[0]


def test_the_sensor_that_agrees_best_is_fused() -> None:
    rng = np.random.default_rng(5)
    rough: Sensor = lambda t: (swell(t)[0] + 0.15 * rng.standard_normal(), *swell(t)[1:])  # noqa: E731
    witness, _ = beside_camera(swell, until_s=55.0, names={"rough": rough, "fine": swell})
    heave = {s.sensor: "heave" in s.used for s in witness.standings()}
    assert heave == {"rough": False, "fine": True}
    chosen, _ = beside_camera(
        swell, until_s=40.0, options=ShipMotionOptions(sensor="rough"), names={"rough": rough, "fine": swell}
    )
    assert {s.sensor: bool(s.used) for s in chosen.standings()} == {"rough": True, "fine": False}
    assert not any(s.used for s in beside_camera(swell, until_s=20.0, options=ShipMotionOptions(sensor="none"))[0].standings())


# With the filter


class Over(NamedTuple):
    """Answers of an estimator over a sea whose pad comes into sight after 20 s."""

    verdicts: list[Verdict]
    """Verdicts of the sightings."""
    ahead: list[tuple[float, Forecast, bool]]
    """Instant, forecast of 1 s, and whether a pad was tracked."""
    missed: F64
    """Vertical speed of the pad that was not forecast, (n,) over that of one standard deviation of it."""


def over_a_sea(seed: int, *, sensor: bool, until_s: float = 24.0) -> Over:
    """Fly with or without a motion sensor 0.15 s late."""
    flight = TruthFlight(
        Setting(seed=seed, sea=4, duration_s=until_s, pose6=True, imu_hz=50.0, sighting_hz=15.0, blind=((0.0, 20.0),))
    )
    rows: list[Event] = list(events(flight))
    if sensor:
        t = np.arange(0.5, until_s, 0.25)
        eta, p = flight.vessel.motion(t).eta[0], flight.pad(t)[0]
        for k, at in enumerate(t.tolist()):
            late, (roll, pitch) = stamp(at + 0.15, at + 0.17), eta[k, 3:5].tolist()
            rows.append(VesselMotion(late, "PSXN", roll, pitch, 1e-4, float(p[k, 2] - flight.p0[2]), 0.01))
    estimator, verdicts, ahead, next_s = RelativeEstimator(EstimatorOptions(ekf=OPTIONS)), list[Verdict](), [], 10.0
    for event in sorted(rows, key=lambda one: one.stamp.received_at):
        while event.stamp.received_at >= ns(next_s):
            made = estimator.forecast(ns(next_s), [1.0])
            ahead += [] if made is None else [(next_s, made, estimator.at(ns(next_s)) is not None)]
            next_s += 0.5
        results = estimator.put([event])
        if isinstance(event, Sighting):
            verdicts.append(results[0][0].verdict)
    usual = float(np.std(flight.pad(np.arange(0.0, 60.0, 0.1))[1][:, 2]))
    came = flight.pad(np.array([t + 1.0 for t, *_ in ahead] or [0.0]))[1][:, 2]
    missed = [made.rise_m_s.item(0) + v for (_, made, _), v in zip(ahead, came.tolist(), strict=bool(ahead))]
    return Over(verdicts, ahead, np.array(missed) / usual)


def test_the_deck_is_forecast_before_the_pad_is_seen_and_sight_begins_with_it() -> None:
    before = [over_a_sea(seed, sensor=True, until_s=19.0) for seed in (4, 5, 6)]
    missed = np.concatenate([one.missed for one in before])
    assert missed.size == 54
    assert not any(tracked for one in before for *_, tracked in one.ahead)
    assert np.sqrt(np.mean(missed**2)) < 0.75
    assert over_a_sea(4, sensor=False, until_s=19.0).ahead == []
    assert all(verdict is Verdict.FUSED for verdict in over_a_sea(4, sensor=True).verdicts)
