"""Weather that belongs together, unkind effects, wrong models, and what becomes of a vehicle after its outcome."""

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.errors import BadInput
from estimator.contracts.time import MonoNs
from sitl.flight.afterwards import STANDS_AFTER_S
from sitl.flight.one_flight import FlyOptions
from sitl.scenario.scenario import WeatherSettings, load, raised_sea, raising_wind_m_s, sea_of, wind_of
from sitl.scenario.settings import settings_for
from sitl.vehicle.disturbances import SPREADS, EffectSettings, WrongModel
from sitl.vessel.file import read_log
from sitl.world.stage import airframe, true_camera
from sitl.world.truth import Truth
from sitl.world.world import Stick, World
from tests.drivers.nmea.test_sentences import line
from tests.fly import land, near
from tests.make import change
from tests.sitl.test_sea import WMO_3700_M
from tests.sitl.test_world import CALM, run_world

UNKIND: dict[str, Any] = {
    "rotor_saturation": True, "battery_sag": 0.15, "drag_per_m": 0.01, "rotor_drag": True, "downwash_m_s2": 1.0,
    "moving_deck": True, "vibration_m_s2": 2.0, "loop_climb_sigma_m_s": 0.1, "loop_rate_sigma_deg_s": 2.0, "unknown_mass_kg": 0.2,
}  # fmt: skip


@settings(max_examples=25, deadline=None)
@given(st.floats(1.0, 20.0), st.floats(1.0, 2000.0))
def test_a_sea_grows_with_wind_and_fetch_up_to_the_fully_grown_one(wind_m_s: float, fetch_km: float) -> None:
    grown, young = raised_sea(wind_m_s), raised_sea(wind_m_s, fetch_km)
    assert young.hs_m <= grown.hs_m + 1e-9
    assert young.hs_m <= raised_sea(wind_m_s, 2.0 * fetch_km).hs_m + 1e-9
    assert raising_wind_m_s(young.hs_m, fetch_km) <= wind_m_s + 1e-6
    assert raising_wind_m_s(grown.hs_m) == pytest.approx(wind_m_s, rel=1e-6)


@pytest.mark.parametrize("state", [2, 3, 4, 5, 6])
def test_the_shipped_weather_has_the_sea_of_its_state_and_the_wind_that_raises_it(state: int) -> None:
    scenario = load(f"weather_{state}")
    low, high = WMO_3700_M[state]
    (system, swell), air = sea_of(scenario).systems(), wind_of(scenario)
    assert low <= math.hypot(system.state.hs_m, swell.state.hs_m) <= high
    assert (swell.state.hs_m, swell.state.tp_s) == (0.5 * system.state.hs_m, 1.6 * system.state.tp_s)
    assert swell.towards_rad - system.towards_rad == pytest.approx(math.radians(60.0)), "it crosses"
    assert system.state.hs_m == pytest.approx(raised_sea(air.speed_m_s).hs_m)
    assert math.degrees(system.towards_rad) == pytest.approx((air.from_deg + 180.0) % 360.0)
    assert (air.model, air.profile, air.wake, air.hull_wake) == ("kaimal", "logarithmic", True, True)
    assert scenario.wrong_model.sigma == 1.0


def test_weather_takes_the_place_of_waves_and_wind_and_contradicts_none(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('title = "a"\nbase = "sea_state_4"\n[weather]\nwind_m_s = 8.0\n')
    scenario = load(tmp_path / "a.toml")
    assert wind_of(scenario).speed_m_s == 8.0
    assert wind_of(scenario).from_deg == load("sea_state_4").wind.from_deg
    assert sea_of(scenario).significant_height_m == pytest.approx(raised_sea(8.0).hs_m)
    old = load("sea_state_4")
    assert (sea_of(old), wind_of(old)) == (old.sea, old.wind)
    for n, more in enumerate(("[sea]\nsea_state = 4\n", "[wind]\nspeed_m_s = 0.0\n")):
        (tmp_path / "b.toml").write_text(f'title = "b"\nbase = "{("a.toml", "weather_4")[n]}"\n{more}')
        with pytest.raises(BadInput, match=r"b\.toml: (sea\.sea_state|wind\.speed_m_s) follows from the weather: set weather\."):
            load(tmp_path / "b.toml")
    assert WeatherSettings(wind_m_s=8.0, fetch_km=50.0).sea(old.sea, 0.0).swell is None, "no swell comes into sheltered water"
    both = WeatherSettings(wind_m_s=5.0, sea_state=5)
    assert (both.wind(old.wind, superstructure=False).speed_m_s, both.sea(old.sea, 0.0).significant_height_m) == (5.0, 3.25)


def hovered(effects: EffectSettings, height_m: float = 0.6, **more: Any) -> tuple[list[float], tuple[float, ...]]:
    """Return where a vehicle is after two seconds of flight in 6 m/s of air near the deck, and what it feels."""
    wind = msgspec.structs.replace(CALM.wind, speed_m_s=6.0)
    start = msgspec.structs.replace(CALM.start, height_m=height_m)
    world = World(change(CALM, effects=effects, wind=wind, start=start, **more), seed=5)
    world.stick(Stick(pitch=-0.6, roll=0.8, gaz=-0.1, progressive=True))
    run_world(world, 2.0)
    return [round(x, 9) for x in world.truth().p_body_ned.tolist()], world.readings().f_body


def test_every_effect_acts_and_without_any_a_flight_is_the_same_to_the_bit() -> None:
    plain = hovered(EffectSettings())
    assert hovered(EffectSettings(thing_radius_m=0.5)) == plain, "nothing lies there"
    assert set(UNKIND) | {"thing_height_m", "video_most_s"} | {
        "thing_radius_m", "thing_forward_m", "thing_right_m", "video_least_s"
    } == set(EffectSettings.__struct_fields__)  # fmt: skip
    for name, value in UNKIND.items():
        place, felt = hovered(EffectSettings(**{name: value}))
        if name == "rotor_saturation":
            continue  # no rotor is at its limit here
        assert (place, felt) != plain, name


def test_a_rotor_at_its_limit_gives_no_more_torque() -> None:
    """A stick thrown over asks an AR.Drone for more than four rotors of 7.5 N give."""

    def turned(effects: EffectSettings) -> float:
        world = World(change(CALM, effects=effects), seed=1)
        world.limits.euler_angle_max_rad, world.limits.vz_max_m_s = 0.5, 2.0
        world.stick(Stick(roll=1.0, gaz=1.0, progressive=True))
        run_world(world, 0.25)
        return float(np.abs(world.truth().w_body).max())

    assert turned(EffectSettings(rotor_saturation=True)) < turned(EffectSettings())


def test_a_thing_on_the_pad_holds_a_vehicle_up() -> None:
    def stands_m(height_m: float) -> float:
        world = World(change(CALM, effects=EffectSettings(thing_height_m=height_m, thing_radius_m=0.5)), seed=2)
        world.vehicle.land()
        run_world(world, 12.0)
        return float(world.truth().d_body_pad_level[2])

    assert stands_m(0.05) - stands_m(0.0) == pytest.approx(0.05, abs=0.005)


def test_a_wrong_model_is_drawn_by_the_seed_and_leaves_the_service_s_model() -> None:
    drawn = WrongModel(sigma=1.0).drawn(7)
    assert drawn == WrongModel(sigma=1.0).drawn(7) != WrongModel(sigma=1.0).drawn(8)
    assert set(drawn.as_json()) == set(SPREADS)
    assert WrongModel().drawn(7) == WrongModel()
    logs = np.array([math.log(WrongModel(sigma=1.0).drawn(n).tilt_frequency) for n in range(300)])
    assert logs.std() == pytest.approx(SPREADS["tilt_frequency"], rel=0.15)
    assert np.abs(logs).max() <= 2.5 * SPREADS["tilt_frequency"] + 1e-4
    differs = change(CALM, wrong_model=WrongModel(tilt_frequency=0.8, thrust=0.9, mount_pitch_deg=2.0, focal_length=1.02))
    assert airframe(differs).loops.tilt_p == pytest.approx(0.64 * airframe(CALM).loops.tilt_p)
    assert airframe(differs).lift_share == 0.9
    assert settings_for(differs, None) == settings_for(CALM, None)
    reported, true = true_camera(CALM), true_camera(differs)
    assert true.fx == pytest.approx(1.02 * reported.fx)
    apart = reported.T_body_cam.R.matrix.T @ true.T_body_cam.R.matrix
    assert math.degrees(math.acos((np.trace(apart) - 1.0) / 2.0)) == pytest.approx(2.0)


def test_a_landing_says_where_the_vehicle_stands_and_in_what_it_differs() -> None:
    scenario = near(wrong_model={"sigma": 1.0})
    ending = land(scenario, 3).as_json()
    stands, touch = ending["standing"], ending["touchdown"]
    assert stands["after_s"] == pytest.approx(STANDS_AFTER_S, abs=0.01)
    moved = math.dist(stands["p_pad_m"], touch["p_pad_m"])
    assert stands["slid_m"] == pytest.approx(moved, abs=2e-4)
    assert stands["lateral_m"] == pytest.approx(math.hypot(*stands["p_pad_m"]), abs=2e-4)
    assert ending["afterwards"] is None
    assert ending["wrong_model"] == WrongModel(sigma=1.0).drawn(3).as_json()


def test_a_refused_vehicle_is_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.flight.afterwards.WATCHED_S", 2.0)
    scenario = near(weather={"wind_m_s": 20.0}, expect="refuse")
    flown: list[Truth] = []
    options = FlyOptions(on_truth=flown.append)
    chosen = settings_for(scenario, None)
    # A slow climb, which still goes on after the refusal.
    slow = msgspec.structs.replace(chosen, vehicle=msgspec.structs.replace(chosen.vehicle, vz_max_m_s=0.5))
    ending = land(scenario, settings=slow, options=options).as_json()
    assert ending["refused"]
    later = ending["afterwards"]
    assert later["watched_s"] == pytest.approx(2.0, abs=0.01)
    assert later["farthest_m"] >= later["end_m"] > 0.0
    crests_m = np.maximum.accumulate([-truth.p_pad_ned[2] for truth in flown])
    before_m = float(np.max([-truth.p_body_ned[2] for truth in flown] - crests_m))
    assert ending["highest_m"] > before_m + 0.1, "the height is watched to the end"
    assert ending["duration_s"] < 40.0


def log_line(t_s: float, north_m: float, height_m: float, quality: int = 4) -> str:
    minutes = 30.0 + north_m / 6_371_000.0 * 180.0 / math.pi * 60.0
    clock = f"{t_s // 3600:02.0f}{t_s % 3600 // 60:02.0f}{t_s % 60:05.2f}"
    place = f"22{minutes:011.8f},N,11430.00000000,E,{quality},21,0.7,{height_m:.4f}"
    return f"$GPGGA,{clock},{place},M,0.0,M,01,0000*00\n$GNHDT,90.0,T*00\n"


def test_a_boats_log_is_its_motion(tmp_path: Path) -> None:
    def heave(t: float) -> float:
        return 0.1 * math.sin(t)

    times = [0.2 * n for n in range(200)]
    text = "".join(log_line(t, 0.5 * t, heave(t)) for t in times)
    (tmp_path / "a.txt").write_text("torn\n" + log_line(86000.0, 0.0, 9.0, quality=1) + text + "$GPGGA,0000")
    t, eta = read_log(tmp_path / "a.txt", 0.0)
    assert (len(t), t[-1]) == (200, pytest.approx(39.8))
    assert eta[-1, 0] - eta[0, 0] == pytest.approx(0.5 * 39.8, abs=0.02)
    assert eta[:, 2] + np.array([heave(x) for x in times]) == pytest.approx(
        np.full(200, np.mean([heave(x) for x in times])), abs=2e-4
    )
    assert eta[:, 5] == pytest.approx(math.pi / 2.0)
    _, smooth = read_log(tmp_path / "a.txt", 0.5)
    assert smooth[20:-20, 2].std() == pytest.approx(eta[20:-20, 2].std() * math.exp(-0.5 * 0.25), rel=0.05)
    moved = [line(f"PSXN,23,2.00,-1.50,{(358.5 + 0.1 * t) % 360.0:.2f},{math.sin(t):.2f}").decode() for t in range(30)]
    (tmp_path / "c.txt").write_text("".join(f"2014-08-01Z {log_line(t, 0, 9, 1)}{said}" for t, said in enumerate(moved)))
    t, eta = read_log(tmp_path / "c.txt", 0.0)
    assert (len(t), t[-1]) == (30, 29.0)
    assert np.abs(eta[:, :2]).max() == 0.0
    assert eta[:, 2] == pytest.approx(np.sin(t) - np.sin(t).mean(), abs=0.01), "the heave is down, as its sentence says"
    assert np.degrees(eta[7, 3:5]) == pytest.approx([2.0, -1.5])
    assert np.degrees(eta[:, 5]) == pytest.approx(0.1 * (t - 14.5)), "about the course, through north"
    (tmp_path / "b.txt").write_text("nothing\n")
    with pytest.raises(BadInput, match=r"b\.txt: no 10 s of RTK places"):
        read_log(tmp_path / "b.txt", 0.0)
    scenario = near(vessel={"moored": False, "motion": str(tmp_path / "a.txt")}, duration_limit_s=30.0)
    world = World(scenario, 1)
    assert world.truth().v_pad_ned[0] == pytest.approx(0.5, abs=0.15)
    assert world.truth().v_body_ned[0] == pytest.approx(0.5, abs=0.15), "it starts with the boat"
    world.advance(MonoNs(5_000_000_000))
