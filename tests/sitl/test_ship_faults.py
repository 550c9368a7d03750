"""Faults of vessel and vehicle: what the deck and the vehicle do, and that the deck's motion stays consistent."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import VesselMotion, VesselReport, VesselWind
from estimator.contracts.time import after
from estimator.ship_motion import ShipMotion, ShipMotionOptions
from sitl.faults.corrupted import Corrupted
from sitl.faults.fault import Fault
from sitl.faults.kinds import DeckRoll, FerryWake, ShipSpeed, ShipTurn, TiltLimited, VesselReports
from sitl.flight.vessel_reports import VesselReporter
from sitl.scenario.scenario import Scenario, from_mapping, load, ship_model, vehicle_model
from sitl.scenario.settings import settings_for
from sitl.sea.sea import Sea
from sitl.vessel.file import VesselSettings
from sitl.world.world import Stick, World
from tests.sitl.test_faults import CALM, at

UNDER_WAY = msgspec.structs.replace(
    CALM,
    vessel=VesselSettings(file="supply_ship", moored=False, speed_m_s=2.0, heading_deg=30.0),
    sea=Sea(significant_height_m=0.0),
)
ROUGH = msgspec.structs.replace(UNDER_WAY, sea=Sea(significant_height_m=1.0, peak_period_s=8.0, runs_to_deg=200.0))


def decks(scenario: Scenario, *faults: Fault, until_s: float, each_s: float = 0.1) -> list[tuple[F64, F64, F64, F64]]:
    """Return position, velocity, rotation and angular velocity of the pad from the start on."""
    w = World(msgspec.structs.replace(scenario, faults=faults), 2)
    out = []
    for n in range(round(until_s / each_s) + 1):
        at(w, n * each_s)
        truth = w.truth()
        out.append((truth.p_pad_ned, truth.v_pad_ned, truth.R_ned_pad.matrix, w.pad_motion().w))
    return out


def heading(R: F64) -> float:
    return math.degrees(Rotation(R).rpy_rad[2])


def test_a_vessel_that_stops_comes_to_rest_where_her_speed_takes_her() -> None:
    track = decks(UNDER_WAY, ShipSpeed(at_s=1.0, to_m_s=0.0, over_s=4.0), until_s=8.0)
    assert np.hypot(*track[8][1][:2]) == pytest.approx(2.0, abs=1e-6)
    assert np.hypot(*track[-1][1][:2]) == pytest.approx(0.0, abs=1e-6)
    ran = track[-1][0] - track[0][0]
    assert np.hypot(*ran[:2]) == pytest.approx(2.0 * 1.0 + 0.5 * 2.0 * 4.0, abs=0.02)
    assert math.degrees(math.atan2(ran[1], ran[0])) == pytest.approx(30.0, abs=1e-3)


def test_a_turning_vessel_changes_her_heading_and_goes_where_she_points() -> None:
    track = decks(UNDER_WAY, ShipTurn(at_s=1.0, rate_deg_s=3.0, over_s=2.0), until_s=11.0)
    assert heading(track[5][2]) == pytest.approx(30.0, abs=1e-6)
    assert heading(track[-1][2]) == pytest.approx(30.0 + 3.0 * (10.0 - 1.0), abs=0.01)
    assert Rotation(track[-1][2]).rpy_rad[0] < -1e-4, "she heels outward, to port"
    assert math.degrees(track[-1][3][2]) == pytest.approx(3.0, abs=0.01)


def test_the_deck_rolls_by_as_much_as_it_says() -> None:
    rolls = [
        math.degrees(Rotation(R).rpy_rad[0]) for _, _, R, _ in decks(UNDER_WAY, DeckRoll(at_s=0.5, period_s=2.0), until_s=8.0)
    ]
    assert np.abs(rolls[:5]).max() < 1e-9
    assert max(rolls) == pytest.approx(8.0, abs=0.1)
    assert min(rolls) == pytest.approx(-8.0, abs=0.1)
    ended = decks(UNDER_WAY, DeckRoll(at_s=0.5, period_s=2.0, for_s=4.0), until_s=6.0)
    assert abs(Rotation(ended[-1][2]).rpy_rad[0]) < 1e-6


def test_a_wake_lifts_and_rolls_the_deck_and_passes() -> None:
    track = decks(UNDER_WAY, FerryWake(at_s=0.5, height_m=1.0, period_s=6.0, waves=3.0), until_s=20.0)
    still = decks(UNDER_WAY, until_s=20.0)
    heave = np.array([a[0][2] - b[0][2] for a, b in zip(track, still, strict=True)])
    assert 0.02 < np.abs(heave).max() < 1.5
    assert np.abs(heave[:5]).max() == 0.0
    assert np.abs(heave[-10:]).max() < 1e-9
    assert max(abs(Rotation(R).rpy_rad[0]) for _, _, R, _ in track) > math.radians(0.2)


ALL = [
    ShipSpeed(at_s=0.7, to_m_s=0.0, over_s=2.0),
    ShipTurn(at_s=0.9, rate_deg_s=-8.0, over_s=1.5, for_s=4.0),
    DeckRoll(at_s=0.3, period_s=2.5),
    FerryWake(at_s=0.2, height_m=1.0, period_s=3.0, waves=3.0, from_deg=60.0),
]


@pytest.mark.parametrize("faults", [[fault] for fault in ALL] + [ALL])
def test_velocity_and_rates_are_the_derivatives_of_the_pose(faults: list[Fault]) -> None:
    """Contact forces come from both: a velocity that is not the rate of the position would throw the vehicle off the deck."""
    h = 0.004
    track = decks(ROUGH, *faults, until_s=4.0, each_s=h)
    p, v, R, w = (np.array([one[i] for one in track]) for i in range(4))
    np.testing.assert_allclose((p[2:] - p[:-2]) / (2 * h), v[1:-1], atol=2e-4)
    turn = np.swapaxes(R[1:-1], 1, 2) @ (R[2:] - R[:-2]) / (2 * h)
    rates = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=-1)
    np.testing.assert_allclose(rates, w[1:-1], atol=2e-4)


def test_the_motion_ahead_is_what_comes_and_the_acceleration_that_of_the_velocity() -> None:
    """Guidance that is told the truth is told the deck's motion with the fault in it."""
    w = World(msgspec.structs.replace(ROUGH, faults=tuple(ALL)), 2)
    at(w, 2.0)
    ahead = w.pad_ahead(np.array([0.2, 0.5, 1.0]))
    before = w.truth().v_pad_ned
    a = w.pad_motion().a_ned
    at(w, 2.004)
    np.testing.assert_allclose((w.truth().v_pad_ned - before) / 0.004, a, atol=0.02)
    for n, later in enumerate((0.2, 0.5, 1.0)):
        truth = at(w, 2.0 + later).truth()
        np.testing.assert_allclose(ahead.p_ned[0, n], truth.p_pad_ned, atol=1e-4)
        np.testing.assert_allclose(ahead.v_ned[0, n], truth.v_pad_ned, atol=1e-6)


def test_a_limited_tilt_is_never_exceeded() -> None:
    tilts = []
    for faults in ((), (TiltLimited(at_s=0.2, to_deg=3.0),)):
        w = World(msgspec.structs.replace(CALM, faults=faults), 1)
        w.stick(Stick(roll=1.0, progressive=True))
        tilts.append(math.degrees(max(abs(at(w, 0.05 * n).truth().R_ned_body.rpy_rad[0]) for n in range(1, 60))))
    assert tilts[0] > 9.0
    assert tilts[1] < 6.0, "3 degrees, the overshoot, and the vehicle's own attitude error"


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"faults": [{"kind": "ship_speed", "at_s": 1, "to_m_s": 0.0}]}, "faults[0]: ship_speed is of a vessel under way"),
        (
            {"vessel": {"moored": False, "speed_m_s": 2.0}, "faults": [{"kind": "ship_speed", "at_s": 1, "to_m_s": 2.0}]},
            "faults[0].to_m_s is 2 m/s, which is vessel.speed_m_s already",
        ),
        (
            {"vessel": {"moored": False}, "faults": [{"kind": "ship_turn", "at_s": 1, "rate_deg_s": 2.0}]},
            "faults[0]: a vessel that lies still does not turn; vessel.speed_m_s must be more than 0",
        ),
        (
            {
                "vessel": {"moored": False, "speed_m_s": 2.0, "turn_rate_deg_s": 1.0},
                "faults": [{"kind": "ship_turn", "at_s": 1, "rate_deg_s": 2.0}],
            },
            "faults[0]: ship_turn does not go with a vessel that turns already",
        ),
        ({"faults": [{"kind": "ship_turn", "at_s": 1, "rate_deg_s": 0.0}]}, "faults[0]: rate_deg_s must not be 0"),
        ({"faults": [{"kind": "deck_roll", "at_s": 1, "for_s": 3.0}]}, "faults[0]: for_s must be two periods or more, 16 s"),
        ({"faults": [{"kind": "ferry_wake", "at_s": 1, "for_s": 3.0}]}, "faults[0]: for_s does not go with a wake"),
    ],
)
def test_a_scenario_that_contradicts_itself_is_named(data: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput) as why:
        from_mapping({"title": "x", **data}, "mine.toml")
    assert f"mine.toml: {said}" in str(why.value)


def test_what_vessel_and_vehicle_cannot_do_is_named() -> None:
    no_heel = msgspec.structs.replace(
        UNDER_WAY, vessel=VesselSettings(moored=False, speed_m_s=2.0), faults=(ShipTurn(at_s=1.0, rate_deg_s=2.0),)
    )
    with pytest.raises(BadInput, match="a turn needs gm_m and kg_m"):
        ship_model(no_heel)
    heavy = from_mapping(
        {"title": "x", "vehicle": {"file": "hexa_7kg"}, "faults": [{"kind": "flow_blind", "below_height_m": 0.05}]}, "mine.toml"
    )
    with pytest.raises(BadInput, match=r"faults\[0\].below_height_m is 0.05 m, but .*hexa_7kg.toml stands .* and is never lower"):
        vehicle_model(heavy)


SHIP = VesselSettings(moored=False, speed_m_s=3.0, heading_deg=40.0, reports_hz=5.0)


def reports(*faults: Fault, ship: VesselSettings = SHIP, until_s: float = 4.0) -> list[VesselReport]:
    world = World(msgspec.structs.replace(CALM, vessel=ship, faults=faults), 1)
    reporter, out = VesselReporter(world), []
    for n in range(1, round(until_s / 0.01) + 1):
        world.advance(after(world.started, 0.01 * n))
        out += [report for report in reporter.reports(world.now) if isinstance(report, VesselReport)]
    return out


def velocities(made: list[VesselReport]) -> np.ndarray:  # type: ignore[type-arg]
    return np.array([r.v_vessel_ned for r in made])


def test_reports_are_true_but_for_their_noise_and_come_as_often_as_they_should() -> None:
    made = reports()
    assert len(made) == pytest.approx(20, abs=1)
    along = 3.0 * np.array([math.cos(math.radians(40.0)), math.sin(math.radians(40.0)), 0.0])
    assert np.abs(velocities(made) - along).max() < 0.5
    assert np.degrees([r.heading_rad for r in made]) == pytest.approx([40.0] * len(made), abs=4.0)
    assert all(r.stamp.received_at > r.stamp.measured_at for r in made[2:])
    assert reports(ship=VesselSettings(moored=False, speed_m_s=3.0)) == []
    assert np.array_equal(velocities(made), velocities(reports()))


def test_a_jump_a_frozen_and_a_silent_receiver() -> None:
    true = reports()
    jump = reports(VesselReports(at_s=1.0, for_s=1.0, east_m_s=5.0, heading_deg=10.0))
    off = velocities(jump)[:, 1] - velocities(true)[:, 1]
    assert off == pytest.approx([5.0 if 1.0 <= 0.2 * n < 2.0 else 0.0 for n in range(len(off))])
    turned = np.degrees([j.heading_rad - t.heading_rad for j, t in zip(jump, true, strict=True)])  # type: ignore[operator]
    assert turned[7] == pytest.approx(10.0)
    frozen = velocities(reports(VesselReports(at_s=1.0, for_s=1.0, frozen=True)))
    assert len({tuple(v) for v in frozen[5:10]}) == 1
    assert len({tuple(v) for v in frozen[10:]}) > 5
    assert len(reports(VesselReports(at_s=1.0, silent=True))) == pytest.approx(5, abs=1)


SENSING = VesselSettings(
    moored=False, speed_m_s=3.0, heading_deg=40.0, motion_hz=5.0, motion_at_m=(6.0, 1.0, 1.5), turn_hz=10.0, wind_hz=1.0
)


def sensed(kind: type[Any], *faults: Fault, ship: VesselSettings = SENSING) -> tuple[list[Any], np.ndarray]:  # type: ignore[type-arg]
    """Return one kind of her reports in 20 s of sea state 4, and the truth at each: down of the sensor, roll, pitch, turn."""
    world = World(msgspec.structs.replace(load("sea_state_4"), vessel=ship, faults=faults), 4)
    reporter, out, truth = VesselReporter(world), [], []
    for n in range(1, 2001):
        world.advance(after(world.started, 0.01 * n))
        t = world.truth()
        R = t.R_ned_pad.matrix
        way = t.p_pad_ned + R @ ship.motion_at_m
        truth.append([way[2], *t.R_ned_pad.rpy_rad[:2], R[2] @ t.w_pad, *way[:2]])
        out += [(n, report) for report in reporter.reports(world.now) if isinstance(report, kind)]
    late = 10 if kind is not VesselMotion else round(100 * ship.motion_delay_s)
    return [report for _, report in out], np.array([truth[max(0, n - late - 1)] for n, _ in out])


def test_a_motion_sensor_measures_its_own_place_late_and_filters_its_heave() -> None:
    made, true = sensed(VesselMotion)
    assert len(made) == pytest.approx(100, abs=2)
    tilt = np.array([[m.roll_rad, m.pitch_rad] for m in made]) - true[:, 1:3]
    assert np.degrees(tilt.std(axis=0)) == pytest.approx([0.03, 0.03], abs=0.03), "apart from how it is mounted"
    down = np.array([m.heave_down_m for m in made])
    assert np.corrcoef(down, true[:, 0])[0, 1] > 0.9
    assert (down - true[:, 0]).std() < 0.5 * true[:, 0].std()
    assert np.allclose(down * 100.0, np.round(down * 100.0)), "whole centimetres"
    quick, _ = sensed(VesselMotion, ship=msgspec.structs.replace(SENSING, motion_high_pass_s=8.0))
    assert np.std(np.array([m.heave_down_m for m in quick]) - down) > 0.1, "a filter for a short period hides the sea"
    turned, _ = sensed(VesselMotion, Corrupted(signal="ship_heave", error="sign", at_s=10.0))
    assert [m.heave_down_m for m in turned[60:]] == pytest.approx(-down[60:])
    often, true = sensed(VesselMotion, ship=msgspec.structs.replace(SENSING, motion_hz=50.0))
    felt, a = np.array([m.acceleration_m_s2 for m in often])[5:-5], np.diff(true[:, 4:], 2, axis=0)[4:-4] / 0.02**2
    assert np.std(felt - np.hypot(*a.T)) < 0.06 < 0.5 * np.std(felt), "the second difference of its place"


def test_settings_that_follow_a_scenario_know_how_her_pad_antenna_and_motion_sensor_lie() -> None:
    places = {"motion_at_m": (25.0, -4.0, 1.5), "reports_at_m": (-12.0, 3.0, -9.0)}
    away = msgspec.structs.replace(SENSING, file="supply_ship", reports_hz=5.0, pad_yaw_deg=-30.0, **places)
    settings = settings_for(msgspec.structs.replace(load("sea_state_4"), vessel=away), None)
    ship, yaw_rad = settings.vessel, settings.estimator.ekf.pad_yaw_in_vessel_rad
    assert math.degrees(yaw_rad) == pytest.approx(330.0)
    assert (ship.pad_forward_m, ship.pad_right_m, ship.pad_up_m) == (12.0, -3.0, -9.0)
    with pytest.raises(BadInput, match=r"vessel\.motion_at_m: ShipMotionOptions\.forward_m must lie in -400 to 400, got 500\.0"):
        settings_for(from_mapping({"title": "x", "vessel": {"motion_at_m": [500.0, 0.0, 0.0]}}, "file"), None)
    made, _ = sensed(VesselMotion, ship=away)
    _, of_pad = sensed(VesselMotion, ship=msgspec.structs.replace(away, motion_at_m=(0.0, 0.0, 0.0)))
    off_m = []
    for options in (ship.motion_sensor, ShipMotionOptions()):
        witness = ShipMotion(options, yaw_rad)
        down = [getattr(witness.reported(sample), "heave_down_m", math.nan) for sample in made]
        off_m.append(np.nanstd((np.array(down, dtype=float) - of_pad[:, 0])[50:]))
    assert off_m[0] < 0.5 * off_m[1], "by its place the sensor's heave is that of the pad"


def test_the_other_sensors_of_the_ship_measure_turn_and_wind() -> None:
    made, true = sensed(VesselReport)
    assert len(made) == pytest.approx(200, abs=3)
    assert np.degrees(np.std(np.array([m.turn_rad_s for m in made]) - true[:, 3])) == pytest.approx(0.2, abs=0.05)
    winds, _ = sensed(VesselWind)
    speed = np.mean([w.speed_m_s for w in winds])
    assert 0.7 * 2.5 < speed < 1.4 * 2.5, "sea_state_4 has 2.5 m/s"
    fault = {"kind": "corrupted", "signal": "ship_turn", "error": "sign", "at_s": 1.0}
    with pytest.raises(BadInput, match=r"signal is ship_turn, which is not there; vessel.turn_hz must be more than 0"):
        from_mapping({"title": "x", "faults": [fault]}, "file")


def test_a_ship_that_does_not_report_cannot_report_wrongly() -> None:
    data = {"title": "x", "faults": [{"kind": "vessel_reports", "at_s": 1.0, "silent": True}]}
    with pytest.raises(
        BadInput, match=r"faults\[0\]: vessel_reports is of a ship that reports, .*vessel.reports_hz must be more than 0"
    ):
        from_mapping(data, "mine.toml")
    with pytest.raises(ValueError, match="nothing says what is wrong with the reports"):
        VesselReports(at_s=1.0)
