"""The rigid body, its inner loops, its contact with deck and water, and the file that describes it."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.settings.load import response_model, shipped, shipped_response
from decklander.place import SHIPPED
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import MonoNs
from sitl.flight.one_flight import fly
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.settings import following, settings_for
from sitl.vehicle.airframe import Airframe, Avionics, Loops, StickLimits, VehicleFile, ardrone2, load, rotors
from sitl.vehicle.disturbances import Wind
from sitl.vehicle.vehicle import DECK, SEA, Vehicle, VehiclePhase
from sitl.vessel.contact import DeckShape, Ground
from sitl.world.world import Stick, World

DT = 0.004
SHAPE = DeckShape(fore_m=3.0, aft_m=2.0, port_m=1.4, starboard_m=1.4)
EXACT = Avionics(
    tilt_bias_sigma_rad=0.0, tilt_drift_sigma_rad=0.0, flow_scale=1.0, flow_noise_sigma_m_s=0.0, flow_lag_s=0.001
)  # fmt: skip
STILL = replace(ardrone2(), avionics=EXACT)
NOWHERE = Ground.nowhere()


def make(airframe: Airframe = STILL, wind: Wind | None = None, seed: int = 1) -> Vehicle:
    return Vehicle(airframe, SHAPE, DT, np.random.SeedSequence(seed), wind)


def flying(airframe: Airframe = STILL, height_m: float = 10.0, yaw_rad: float = 0.0, wind: Wind | None = None) -> Vehicle:
    v = make(airframe, wind)
    v.place(np.array([0.0, 0.0, -height_m]), np.zeros(3), yaw_rad)
    return v


def run_vehicle(v: Vehicle, seconds: float, ground: Ground = NOWHERE) -> None:
    for _ in range(round(seconds / v.step_s)):
        v.step(ground)


def flat_deck() -> Ground:
    """Return a deck at z = -0.5 m over water at 0."""
    return Ground.of(np.array([0.0, 0.0, -0.5]), np.zeros(3), np.eye(3), np.zeros(3))


def moving_deck(t: float) -> Ground:
    """Heave 0.5 m in 6 s, roll 8 degrees in 5 s, surge 1 m/s, on heading 170 degrees."""
    w1, w2, roll0, heave0, heading = math.tau / 6, math.tau / 5, math.radians(8), 0.5, math.radians(170)
    roll = roll0 * math.sin(w2 * t)
    R = Rotation.from_rpy(roll, 0.0, heading).matrix
    ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
    p = np.array([0.0, 0.0, -1.0 + heave0 * math.sin(w1 * t)]) + ahead * t
    v = np.array([0.0, 0.0, heave0 * w1 * math.cos(w1 * t)]) + ahead
    return Ground.of(p, v, R, np.array([roll0 * w2 * math.cos(w2 * t), 0.0, 0.0]))


def on_pad(v: Vehicle, g: Ground) -> F64:
    """(3,) m, the body's origin in the pad frame."""
    return np.asarray((v.p_ned - np.array(g.p)) @ np.array(g.R))


def test_keeps_its_angular_momentum_when_tumbling() -> None:
    v = flying(replace(STILL, drag_per_s=(0.0, 0.0, 0.0), motor_lag_s=0.0), height_m=1000.0)
    v.cut_motors()
    v.w = (2.0, -1.0, 3.0)
    inertia = np.array(STILL.inertia_kg_m2)
    before = v.R_ned_body @ (inertia * v.w_body)
    run_vehicle(v, 2.0)
    after = v.R_ned_body @ (inertia * v.w_body)
    assert np.linalg.norm(after - before) < 0.02 * np.linalg.norm(before)
    assert np.abs(v.R_ned_body @ v.R_ned_body.T - np.eye(3)).max() < 1e-12


@pytest.mark.parametrize("yaw_rad", [0.0, 2.0])
@pytest.mark.parametrize(
    ("stick", "expected"),
    [
        ((0.5, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)),
        ((0.0, -0.5, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.5, 0.0), (0.0, 0.0, -1.0, 0.0)),
        ((0.0, 0.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0)),
    ],
)
def test_each_stick_moves_its_own_way(yaw_rad, stick, expected):
    v = flying(yaw_rad=yaw_rad)
    v.command(*stick, progressive=True)
    run_vehicle(v, 2.0)
    level = Rotation.from_rpy(0.0, 0.0, yaw_rad).matrix.T @ v.v_ned
    moved = np.array([*level, v.w_body[2]])
    assert moved @ np.array(expected) > 0.3
    assert np.abs(moved * (np.array(expected) == 0.0)).max() < 0.1


def test_hover_stops_and_stays_against_a_new_wind() -> None:
    v = flying()
    v.v = (1.5, -1.0, 0.0)
    v.extra_wind = (3.0, 0.0, 0.0)
    run_vehicle(v, 30.0)
    assert np.abs(v.v_ned).max() < 0.01
    assert Rotation(v.R_ned_body).rpy_rad[1] == pytest.approx(3.0 * STILL.drag_per_s[0] / G_M_S2, rel=0.05)


@pytest.mark.parametrize("arm_m", [0.0, 1.0])
def test_flow_over_a_rolling_deck_is_by_the_point_below_and_not_by_the_height_above_it(arm_m: float) -> None:
    """A deck that rolls below a drone which stands still carries the point below it by arm times rate, mostly downwards."""
    roll, rate, height = 0.1, 0.2, 8.0
    R = Rotation.from_rpy(roll, 0.0, 0.0).matrix
    deck = Ground.of(np.array([0.0, 0.0, -0.5]), np.zeros(3), R, np.array([rate, 0.0, 0.0]))
    v = flying(height_m=height)
    v.place(np.array([0.0, arm_m, -height]), np.zeros(3), 0.0)
    run_vehicle(v, 0.1, deck)
    assert v.flow[1] == pytest.approx(rate * arm_m * math.tan(roll), abs=0.01)
    assert v.flow[0] == pytest.approx(0.0, abs=0.01)


def test_ground_effect_lifts_and_fades() -> None:
    """T/T_free = 1 / (1 - (R/4z)^2) with R of one disc as large as the four rotors."""
    frozen = replace(STILL, drag_per_s=(0.0, 0.0, 0.0))
    gained = []
    for height in (0.12, 0.3, 3.0):
        v = flying(frozen, height_m=0.5 + height)
        v.step(flat_deck())
        gained.append(-v.v_ned[2] / DT / G_M_S2)
    z = np.array([0.12, 0.3, 3.0]) + frozen.rotors_above_m
    expected = 1.0 / (1.0 - (2.0 * frozen.rotor_radius_m / 4.0 / z) ** 2) - 1.0
    assert gained == pytest.approx(expected, rel=0.02, abs=1e-5)
    assert gained[0] > gained[1] > gained[2] > 0.0


def test_lands_by_itself_and_stands() -> None:
    v = flying(height_m=2.5)
    v.land()
    assert v.phase == VehiclePhase.LANDING
    run_vehicle(v, 2.0, flat_deck())
    assert v.v_ned[2] == pytest.approx(STILL.landing_speed_m_s, abs=0.05)
    run_vehicle(v, 8.0, flat_deck())
    assert v.phase == VehiclePhase.LANDED
    assert v.touched_what == DECK
    assert 0.02 < v.touched_v[2] < STILL.landing_speed_m_s
    assert v.thrust_n < 1e-3
    assert on_pad(v, flat_deck()) == pytest.approx([0.0, 0.0, -STILL.feet.below_m], abs=0.004)
    assert v.f_body == pytest.approx([0.0, 0.0, -G_M_S2], abs=1e-6)


@pytest.mark.parametrize(("roll_deg", "height_m"), [(180.0, 1.0), (120.0, 2.0), (0.0, 20.0), (60.0, 8.0)])
def test_any_fall_ends_on_the_deck_not_in_it(roll_deg: float, height_m: float) -> None:
    v = flying(height_m=0.5 + height_m)
    v.q = tuple(Rotation.from_rpy(math.radians(roll_deg), 0.1, 0.0).quat_wxyz.tolist())
    v.cut_motors()
    v.thrust_n = 0.0
    run_vehicle(v, 5.0, flat_deck())
    assert v.touched_what == DECK
    assert not v.ditched
    assert v.tied
    assert -0.25 < on_pad(v, flat_deck())[2] < 0.0


def test_stands_on_a_moving_deck_without_drifting() -> None:
    v = make()
    v.stand(moving_deck(0.0), np.array([0.1, -0.2, -STILL.feet.below_m]), 0.4)
    worst = 0.0
    for n in range(1, 5000):
        g = moving_deck(n * DT)
        v.step(g)
        worst = max(worst, float(np.abs(on_pad(v, g) - [0.1, -0.2, -STILL.feet.below_m]).max()))
    assert worst < 1e-9
    assert v.tied
    R_pad_body = np.array(g.R).T @ v.R_ned_body
    assert Rotation(R_pad_body).rpy_rad == pytest.approx((0.0, 0.0, 0.4), abs=1e-9)
    assert v.w_body == pytest.approx(Rotation.from_rpy(0.0, 0.0, 0.4).matrix.T @ np.array(g.w), abs=1e-9)
    t = n * DT
    heave_acc = -0.5 * (math.tau / 6) ** 2 * math.sin(math.tau / 6 * (t - DT / 2))
    assert (v.R_ned_body @ v.f_body)[2] == pytest.approx(heave_acc - G_M_S2, abs=0.08)


def test_lands_on_a_moving_deck_and_goes_with_it() -> None:
    v = make()
    v.place(np.array([0.0, 0.0, -3.5]), np.array([*moving_deck(0.0).v[:2], 0.0]), math.radians(170))
    v.land()
    at_rest = None
    for n in range(1, 6000):
        g = moving_deck(n * DT)
        v.step(g)
        if v.phase == VehiclePhase.LANDED and v.tied and at_rest is None:
            at_rest = on_pad(v, g)
    assert np.abs(on_pad(v, g) - at_rest).max() < 1e-9
    assert np.hypot(*at_rest[:2]) < 0.5


def test_water_ends_the_flight() -> None:
    v = flying(height_m=2.0)
    v.p = (0.0, 4.0, -2.0)
    v.land()
    run_vehicle(v, 12.0, flat_deck())
    assert v.phase == VehiclePhase.EMERGENCY
    assert v.touched_what == SEA
    assert v.ditched
    assert v.p_ned[2] == pytest.approx(0.0, abs=0.1)
    v.leave_emergency()
    v.take_off()
    assert v.phase == VehiclePhase.EMERGENCY


STEP_S = 0.004


def shipped_vehicle(name: str) -> VehicleFile:
    return load(SHIPPED / "vehicles" / f"{name}.toml")


HEXA = shipped_vehicle("hexa_7kg").airframe()
LEVEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def test_the_file_of_the_ardrone_holds_the_vehicle_of_all_flights_so_far() -> None:
    vehicle = shipped_vehicle("ardrone2")
    assert vehicle.airframe().loops == Loops()
    assert vehicle.stick_limits() == StickLimits(math.radians(12.0), 0.7, math.radians(100.0))
    assert load_scenario("demo").vehicle.file.endswith("ardrone2")


@pytest.mark.parametrize("name", shipped("vehicles"))
def test_every_shipped_vehicle_says_what_is_assumed_and_hovers(name: str) -> None:
    vehicle = shipped_vehicle(name)
    assert "assumed" in vehicle.source
    v = Vehicle(vehicle.airframe(), DeckShape(2.0, 2.0, 2.0, 2.0), STEP_S, np.random.SeedSequence(1))
    v.place(np.array([0.0, 0.0, -10.0]), np.zeros(3), 0.3)
    for _ in range(2000):
        v.step(Ground.nowhere())
    assert np.linalg.norm(v.v_ned) < 0.2
    assert v.thrust_n == pytest.approx(vehicle.mass_kg * 9.80665, rel=0.03)
    assert len(v.rotor_health) == (6 if vehicle.layout == "hexa_x" else 4)


@pytest.mark.parametrize("name", shipped("vehicles"))
def test_a_tilt_step_has_the_frequency_and_damping_of_the_file(name: str) -> None:
    """The tilt's overshoot against that of a second-order loop behind delay and motor lag, integrated by itself."""
    vehicle = shipped_vehicle(name)
    f = replace(vehicle.airframe(), avionics=replace(ardrone2().avionics, tilt_bias_sigma_rad=0.0, tilt_drift_sigma_rad=0.0))
    v = Vehicle(f, DeckShape(2.0, 2.0, 2.0, 2.0), STEP_S, np.random.SeedSequence(1))
    v.limits = vehicle.stick_limits()
    v.place(np.array([0.0, 0.0, -50.0]), np.zeros(3), 0.0)
    v.command(0.5, 0.0, 0.0, 0.0, True)
    asked, roll, rate, torque = 0.5 * v.limits.euler_angle_max_rad, 0.0, 0.0, 0.0
    flown, model = [], []
    for i in range(400):
        v.step(Ground.nowhere())
        flown.append(Rotation(v.R_ned_body).rpy_rad[0])
        target = asked if i * STEP_S >= f.command_delay_s else 0.0
        torque += (1 - math.exp(-STEP_S / f.motor_lag_s)) * (f.loops.tilt_p * (target - roll) - f.loops.tilt_d * rate - torque)
        rate += STEP_S * torque
        roll += STEP_S * rate
        model.append(roll)
    np.testing.assert_allclose(flown, model, atol=0.04 * asked)


@given(name=st.sampled_from(shipped("vehicles")), rotor=st.integers(0, 5), left=st.floats(0.8, 1.0), seed=st.integers(0, 1000))
@settings(max_examples=12)
def test_a_vehicle_with_a_weak_rotor_and_authority_left_flies_on_level(name: str, rotor: int, left: float, seed: int) -> None:
    """WHY: a motor at 80 % tilts a real multicopter by some degrees, for a moment: its loops have an integral."""
    f = shipped_vehicle(name).airframe()
    n = len(rotors(f))
    assert f.mass_kg * 9.80665 / left < 0.75 * f.thrust_max_n, "the weak rotor can still carry its part of the weight"
    v = Vehicle(f, DeckShape(2.0, 2.0, 2.0, 2.0), STEP_S, np.random.SeedSequence(seed))
    v.place(np.array([0.0, 0.0, -30.0]), np.zeros(3), 0.3)
    for _ in range(500):
        v.step(Ground.nowhere())
    v.rotor_health = tuple(left if i == rotor % n else 1.0 for i in range(n))
    tilts = []
    for _ in range(1500):
        v.step(Ground.nowhere())
        tilts.append(math.acos(v.R_ned_body[2, 2]))
    assert max(tilts) < math.radians(25.0)
    assert max(tilts[-250:]) < math.radians(6.0)
    assert abs(v.w_body[2]) < 0.05
    assert np.linalg.norm(v.v_ned) < 0.4


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mass_kg = 7.0", "mass_kg = 13.0", "thrust_max_n is 140 N: it must be 1.2 times the weight or more"),
        ('layout = "hexa_x"', 'layout = "octo"', 'layout must be one of "hexa_x", "quad_x", found "octo"'),
        ("0.22, 0.22, 0.40", "0.10, 0.10, 0.40", "inertia_kg_m2: no body has one moment larger"),
        ("arm_m = 0.45", "", "arm_m is missing: it must be a number from 0.03 to 2 m"),
        ("tilt_p = 25.0", 'tilt_p = "fast"', "loops.tilt_p must be a number from 1 to 1000 1/s^2"),
    ],
)
def test_a_bad_vehicle_is_refused_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = (SHIPPED / "vehicles" / "hexa_7kg.toml").read_text()
    assert old in text
    path = tmp_path / "v.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(BadInput) as why:
        load(path)
    assert str(why.value).startswith(f"{path}: ")
    assert said in str(why.value)
    assert "\n" not in str(why.value)


def test_a_vehicle_that_comes_over_the_edge_is_lifted_by_degrees() -> None:
    """No step in the vertical acceleration as it crosses at 1 m/s, where today's rule for the body's middle makes one."""
    jumps = {}
    for effect in ("body", "rotors"):
        f = replace(HEXA, ground_effect=effect)  # type: ignore[arg-type]
        v = Vehicle(f, DeckShape(2.0, 2.0, 2.0, 2.0), STEP_S, np.random.SeedSequence(3))
        ground = Ground((0.0, 0.0, -3.0), (0.0, 0.0, 0.0), LEVEL, (0.0, 0.0, 0.0), 0.0)
        v.place(np.array([0.0, 3.0, -3.4]), np.array([0.0, -1.0, 0.0]), 0.0)
        a = []
        for _ in range(400):
            v.command(0.0, 0.0, 0.0, 0.0, True)
            v.step(ground)
            a.append(float(v.a[2]))
        jumps[effect] = np.abs(np.diff(a[20:])).max()
    assert jumps["rotors"] < 0.4 * jumps["body"]


def test_stick_and_settings_change_the_vehicle_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "v.toml").write_text(
        'title = "v"\nbase = "calm"\n[vehicle]\nfile = "quad_1_5kg"\nmass_kg = 1.8\nmotor_lag_s = 0.1\nvz_max_m_s = 0.5\n'
    )
    world = World(load_scenario(tmp_path / "v.toml"), 1)
    f = world.vehicle.airframe
    file = shipped_vehicle("quad_1_5kg")
    assert (f.mass_kg, f.motor_lag_s, world.limits.vz_max_m_s) == (1.8, 0.1, 0.5)
    assert f.inertia_kg_m2[0] == pytest.approx(1.2 * file.inertia_kg_m2[0])
    assert world.limits.euler_angle_max_rad == pytest.approx(math.radians(file.limits.euler_angle_max_deg))
    world.stick(Stick(gaz=1.0, progressive=True))
    world.advance(MonoNs(2_000_000_000))
    assert -world.truth().v_body_ned[2] == pytest.approx(0.5, abs=0.1)


def test_a_vehicle_with_a_response_of_its_own_is_flown_by_it_down_to_the_middle_of_the_pad() -> None:
    # Why: by the AR.Drone's response, three times as slow, the quadcopter swings and misses the middle by 16 and 21 cm.
    scenario = load_scenario("quad_1_5kg")
    flown_with = settings_for(scenario, None)
    assert response_model(flown_with) == shipped_response("quad_1_5kg")
    assert (flown_with.vehicle.euler_angle_max_deg, flown_with.guidance.cone.feet_aside_m) == (35.0, 0.12)  # type: ignore
    calm = following(load_scenario("calm"), flown_with)
    assert (response_model(calm), calm.vehicle.euler_angle_max_deg) == (shipped_response("ardrone2"), 29.5)  # type: ignore
    endings = [fly("quad_1_5kg", scenario, seed, flown_with, "truth") for seed in (1, 2)]
    assert all(ending.good for ending in endings)
    assert max(ending.contacts[-1].lateral_m for ending in endings) < 0.08
