"""Vessels from files: main dimensions, response tables, recordings; and a ship that turns."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.settings.load import shipped
from decklander.place import SHIPPED
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation
from sitl.scenario.scenario import load as load_scenario
from sitl.sea.sea import SEA_STATES, Waves
from sitl.vessel.file import Mode, RecordedMotion, Table, load
from sitl.vessel.seakeeping import (
    FERRY,
    MODES,
    OTTER,
    SUPPLY_SHIP,
    Hull,
    Turn,
    TurningCourse,
    encounter_rad_s,
    responses,
    speed_in_turn_m_s,
)
from sitl.vessel.vessel import Mooring, RecordedVessel, TurningVessel, Vessel
from sitl.world.stage import sea_and_vessel


def as_toml(table: Table) -> str:
    """Return the text of a table as a vessel's file holds it."""
    lines = ["[table]", f"encounter_rad_s = {_row(table.encounter_rad_s)}", f"heading_deg = {_row(table.heading_deg)}"]
    for mode in MODES:
        held: Mode | None = getattr(table, mode)
        if held is not None:
            lines += ["", f"[table.{mode}]"]
            for name, rows in (("amplitude", held.amplitude), ("phase_deg", held.phase_deg)):
                lines += [f"{name} = [", *(f"  {_row(row)}," for row in rows), "]"]
    return "\n".join(lines) + "\n"


def _row(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.6g}" for value in values) + "]"


HEADER = "time_s,surge_m,sway_m,heave_down_m,roll_deg,pitch_deg,yaw_deg\n"
TURNING = Hull("s", 82.8, 19.2, 6.0, 0.65, 10.0, 0.33, 3.0, 14.0, (-22.0, 0.0), gm_m=2.14, kg_m=7.0)


def row(t: float) -> str:
    cells = (t, 0.2 * math.sin(t), 0.1, 0.3 * math.cos(0.7 * t), 4 * math.sin(0.9 * t), -1.0, 359.5 + t % 1)
    return ",".join(f"{x:.6f}" for x in cells) + "\n"


def recording(folder: Path, seconds: float = 30.0) -> Path:
    path = folder / "motion.csv"
    path.write_text(HEADER + "".join(row(0.1 * i) for i in range(round(seconds * 10) + 1)))
    return path


def vessel_file(folder: Path, rest: str) -> Path:
    path = folder / "ship.toml"
    path.write_text(
        'title = "s"\nsource = "test"\nlength_m = 5.0\nbeam_m = 2.8\ndraught_m = 0.3\nfreeboard_m = 0.55\n' + rest + "\n"
    )
    return path


def test_every_shipped_vessel_loads_says_its_source_and_carries_the_pad() -> None:
    assert {"model_ship", "ferry", "patrol_boat", "supply_ship"} <= set(shipped("vessels"))
    for name in shipped("vessels"):
        hull = load(SHIPPED / "vessels" / f"{name}.toml").hull
        assert min(hull.deck_m) >= 1.0, "the pad is 0.78 m wide"
        assert hull.gm_m is not None, "it can turn"


def tabled(hull: Hull, w: F64, headings_deg: F64) -> Table:
    """Return the closed-form responses of a hull at rest, written as a table."""
    modes = {}
    h = responses(hull, w, np.radians(headings_deg)[:, None])
    for i, mode in enumerate(("surge", "sway", "heave", "roll", "pitch", "yaw")):
        z = h[i] * (-1.0 if mode == "heave" else 1.0) * (math.degrees(1.0) if i > 2 else 1.0)
        modes[mode] = Mode(tuple(map(tuple, np.abs(z).tolist())), tuple(map(tuple, np.degrees(-np.angle(z)).tolist())))
    return Table(tuple(w.tolist()), tuple(headings_deg.tolist()), **modes)


def test_a_table_gives_back_the_responses_it_was_made_of(tmp_path: Path) -> None:
    """Written as a file and read again: from port and from starboard, and a wave that the ship overtakes."""
    w = np.geomspace(0.2, 3.0, 90)
    path = vessel_file(tmp_path, as_toml(tabled(SUPPLY_SHIP, w, np.linspace(0, 180, 37))))
    hull = load(path).hull
    rng = np.random.default_rng(1)
    some_w, beta = rng.uniform(0.25, 1.5, 300), rng.uniform(-7, 7, 300)
    exact = responses(SUPPLY_SHIP, some_w, beta)
    size = np.abs(exact).max(axis=1, keepdims=True)
    assert (np.abs(responses(hull, some_w, beta) - exact) / size).max() < 0.03
    np.testing.assert_array_equal(hull.table.responses(-some_w, beta), hull.table.responses(some_w, beta).conj())
    overtaken = encounter_rad_s(np.array([2.0]), np.array([0.0]), 8.0)
    assert overtaken[0] < 0
    assert np.abs(hull.table.responses(np.array([300.0]), np.array([1.0]))).max() < 1e-6, "nothing beyond the table"


def test_recorded_motion_goes_through_its_samples_with_continuous_velocity(tmp_path: Path) -> None:
    motion = RecordedMotion.read(recording(tmp_path))
    t = np.arange(0.0, 29.9, 0.1)
    eta, dot, _ = motion.at(t)
    assert eta[:, 3] == pytest.approx(np.radians(4 * np.sin(0.9 * t)), abs=1e-5)
    middle = t + 0.05
    assert motion.at(middle)[0][20:-20, 2] == pytest.approx(0.3 * np.cos(0.7 * middle[20:-20]), abs=1e-5)
    assert dot[20:-20, 3] == pytest.approx(np.radians(3.6 * np.cos(0.9 * t[20:-20])), abs=1e-4)
    h = 1e-6
    left, right = motion.at(t[1:] - h), motion.at(t[1:] + h)
    assert np.abs(right[1] - left[1]).max() < 1e-4
    assert np.abs((right[0] - left[0]) / (2 * h) - dot[1:]).max() < 1e-6
    assert np.ptp(eta[:, 5]) < math.radians(2.0), "the yaw went over 360 degrees and was unwrapped"


def test_a_blended_loop_is_smooth_where_it_closes(tmp_path: Path) -> None:
    motion = RecordedMotion.read(recording(tmp_path), blend_s=4.0)
    assert math.isinf(motion.lasts_s)
    assert motion.period_s == pytest.approx(26.0)
    t = np.linspace(20.0, 60.0, 40_001)
    eta, dot, ddot = motion.at(t)
    assert np.abs(np.diff(eta, axis=0)).max() < 1e-3
    assert np.abs(np.gradient(eta, t, axis=0) - dot)[2:-2].max() < 1e-4
    assert np.abs(np.diff(dot, axis=0)).max() < 2e-2
    assert motion.at(t + 26.0)[0] == pytest.approx(eta)
    assert np.isfinite(ddot).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,x,y\n1,2,3\n", "the first line must be time_s,surge_m"),
        (HEADER + row(0) + row(0.1), "2 rows of motion; four or more are needed"),
        (HEADER + row(0) + "0.1,1,2\n", "line 3 has 3 cells, not 7"),
        (HEADER + row(0) + "0.1,0,0,nan,0,0,0\n", "line 3: heave_down_m needs a number, found 'nan'"),
        (HEADER + row(0.1) + row(0.1), "line 3: time_s must ascend, found 0.1 after 0.1"),
        (HEADER + row(0) + row(5), "line 3: a gap of 5 s"),
        (HEADER + row(0) + "0.1,0,0,0,95,0,0\n", "line 3: roll_deg must lie within 80, found 95"),
    ],
)
def test_a_bad_recording_is_refused_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(BadInput) as why:
        RecordedMotion.read(path)
    assert str(why.value).startswith(f"{path}: ")
    assert said in str(why.value)
    assert "\n" not in str(why.value)


CLOSED = "[closed_form]\nblock = 0.6\nroll_period_s = 2.2\nroll_damping = 0.2\n"


@pytest.mark.parametrize(
    ("rest", "said"),
    [
        ("", "exactly one of closed_form, table and recording must say how it moves, found 0"),
        ("pad_forward_m = 3.0\n" + CLOSED, "the pad's centre must lie on the deck"),
        ("[closed_form]\nblock = 0.6\nroll_damping = 0.2\n", "closed_form.roll_period_s is missing: it must be a number"),
        ('[recording]\nfile = "none.csv"\n', "none.csv: No such file"),
        ('[recording]\nfile = "motion.csv"\nloop_blend_s = 20.0\n', "30.0 s of motion are too short to blend 20 s of them"),
        (
            "[table]\nencounter_rad_s = [0.5, 0.4]\nheading_deg = [0, 180]\n"
            + "".join(f"[table.{m}]\namplitude = [[0,0],[0,0]]\nphase_deg = [[0,0],[0,0]]\n" for m in ("heave", "roll", "pitch")),
            "table: encounter_rad_s must hold two or more ascending",
        ),
        (
            "[table]\nencounter_rad_s = [0.5, 0.6]\nheading_deg = [0, 180]\n"
            + "".join(f"[table.{m}]\namplitude = [[0,0],[0]]\nphase_deg = [[0,0],[0,0]]\n" for m in ("heave", "roll", "pitch")),
            "table: heave.amplitude must hold 2 rows (headings) of 2 numbers",
        ),
    ],
)  # fmt: skip
def test_a_bad_vessel_is_refused_in_one_line(tmp_path: Path, rest: str, said: str) -> None:
    recording(tmp_path)
    with pytest.raises(BadInput) as why:
        load(vessel_file(tmp_path, rest))
    assert said in str(why.value)
    assert "\n" not in str(why.value)


@pytest.mark.parametrize(
    ("vessel", "said"),
    [
        ('file = "ferry"\nhull = "ferry"', "vessel: hull and file both name a ship: give one"),
        ("turn_rate_deg_s = 1.0", "vessel: turn_rate_deg_s needs speed_m_s"),
        ("turn_at_s = 9.0", "vessel: turn_at_s and turn_over_s belong to a turn"),
        ('moored = false\nspeed_m_s = 2.0\nturn_rate_deg_s = 1.0\nhull = "otter"', "hull otter: a turn needs gm_m and kg_m"),
        ('file = "ship.toml"', "a recording holds the vessel's whole motion; vessel.moored must be false"),
        ('file = "ship.toml"\nmoored = false', "the recording lasts 30.0 s and the flight up to 120 s"),
    ],
)
def test_a_scenario_and_a_vessel_that_contradict_each_other_are_refused(tmp_path: Path, vessel: str, said: str) -> None:
    recording(tmp_path)
    vessel_file(tmp_path, '[recording]\nfile = "motion.csv"')
    path = tmp_path / "mine.toml"
    path.write_text(f'title = "m"\n[vessel]\n{vessel}\n')
    with pytest.raises(BadInput) as why:
        load_scenario(path)
    assert said in str(why.value)
    assert "\n" not in str(why.value)


def test_a_recorded_vessel_flies_its_recording_from_a_place_by_the_seed(tmp_path: Path) -> None:
    recording(tmp_path)
    vessel_file(tmp_path, '[recording]\nfile = "motion.csv"\nloop_blend_s = 3.0\nrandom_start = true')
    path = tmp_path / "mine.toml"
    path.write_text('title = "m"\n[vessel]\nfile = "ship.toml"\nmoored = false\nspeed_m_s = 1.0\n')
    _, vessel = sea_and_vessel(load_scenario(path), [1, 2])
    assert isinstance(vessel, RecordedVessel)
    pads = vessel.pad(np.arange(0.0, 200.0, 0.5))
    assert pads.p_ned.shape == (2, 400, 3)
    assert pads.p_ned[0, -1, 0] - pads.p_ned[0, 0, 0] == pytest.approx(199.5, abs=1.0)
    assert not np.allclose(pads.p_ned[0, :, 2], pads.p_ned[1, :, 2])


def numeric(vessel: Vessel, t: float, d: F64) -> tuple[F64, F64, F64]:
    h = 2e-3
    m = vessel.mounted(np.array([t - h, t, t + h]), d)
    p, R = m.p_ned[0], m.R_ned[0]
    w = R[1].T @ (R[2] - R[0]) / (2 * h)
    return (p[2] - p[0]) / (2 * h), (p[2] - 2 * p[1] + p[0]) / h**2, np.array([w[2, 1], w[0, 2], w[1, 0]])


@pytest.mark.parametrize("t", [3.0, 6.0, 11.0, 40.0])
@pytest.mark.parametrize("current", [(0.0, 0.0), (0.5, -0.3)])
def test_a_turning_ships_velocities_are_those_of_its_motion(t: float, current: tuple[float, float]) -> None:
    """The velocities agree before, while and after the turn develops, at a point far from amidships."""
    waves = Waves.draw(SEA_STATES[4], [5], towards_rad=2.0).carried(current)
    vessel = TurningVessel(TURNING, waves, Turn(math.radians(2.0), 5.0, 10.0), heading_rad=0.7, speed_m_s=6.0)
    d = np.array([-22.0, 3.0, -3.0])
    m = vessel.mounted(t, d)
    v, a, w = numeric(vessel, t, d)
    np.testing.assert_allclose(m.v_ned[0], v, atol=2e-5)
    np.testing.assert_allclose(m.a_ned[0], a, atol=2e-3)
    np.testing.assert_allclose(m.w[0], w, atol=1e-5)


def test_a_turn_costs_speed_and_heels_the_ship_outwards() -> None:
    """A circle of 4 lengths leaves 0.074 x 4 + 0.149 of the speed; phi = V r (KG - T/2) / (g GM)."""
    after = speed_in_turn_m_s(6.0, rate := math.radians(1.0), 82.8)
    diameter = 2 * after / rate
    assert after / 6.0 == pytest.approx(0.074 * diameter / 82.8 + 0.149)
    assert speed_in_turn_m_s(6.0, 1e-4, 80.0) == 6.0, "a wide circle costs nothing"
    course = TurningCourse(Turn(rate, 0.0, 10.0), 6.0, 82.8)
    c = course.at(np.linspace(10.0, 10.0 + math.tau / rate, 5))
    assert np.ptp(c.speed) == 0.0
    assert c.p[0] == pytest.approx(c.p[-1], abs=1e-6), "the circle closes"
    assert np.abs(c.p[0] - c.p[2]) @ np.abs(c.p[0] - c.p[2]) == pytest.approx((2 * after / rate) ** 2)
    ship = TurningVessel(TURNING, Waves.draw(SEA_STATES[0], 1), Turn(rate, 0.0, 10.0), speed_m_s=6.0)
    heel = float(ship.motion(60.0).eta[0, 3])
    expected = math.atan(float(c.speed[0]) * rate / 9.80665) * (7.0 - 3.0) / 2.14
    assert heel == pytest.approx(-expected, rel=1e-3), "a turn to starboard heels to port"


def test_a_moored_ship_in_a_current_meets_the_waves_where_they_pass() -> None:
    """The surface at the ship and the ship's heave stay together: long waves carry it like a cork."""
    waves = Waves.draw(SEA_STATES[5], [3], towards_rad=0.4).carried((1.2, 0.4))
    for mooring in (Mooring(0.0, 0.0, 0.0), None):
        vessel = Vessel(FERRY, waves, mooring=mooring)
        t = np.arange(0.0, 60.0, 0.5)
        p = vessel.mounted(t, np.zeros(3)).p_ned[0]
        water = np.array([waves.elevation(p[i, :2], t[i])[0] for i in range(t.size)])
        assert np.corrcoef(-p[:, 2], water)[0, 1] > 0.98
        assert np.hypot(*(p[-1, :2] - p[0, :2])) == pytest.approx(0.0 if mooring else 59.5 * math.hypot(1.2, 0.4), abs=4.0)


PERIODS = np.arange(5.0, 18.0, 0.25)


def test_the_supply_ship_answers_as_its_published_tables_say() -> None:
    # Fossen's MSS supply vessel at rest: roll peaks at 3.1 deg/m near 9.5 s in beam seas, pitch at 2.4 deg/m near 8.5 s in
    # head seas.
    w = math.tau / PERIODS
    roll = np.degrees(np.abs(responses(SUPPLY_SHIP, w, np.full_like(w, math.pi / 2))[3]))
    pitch = np.degrees(np.abs(responses(SUPPLY_SHIP, w, np.full_like(w, math.pi))[4]))
    assert roll.max() == pytest.approx(3.1, rel=0.1)
    assert PERIODS[roll.argmax()] == pytest.approx(9.5, abs=0.75)
    assert pitch.max() == pytest.approx(2.4, rel=0.25)
    assert PERIODS[pitch.argmax()] == pytest.approx(8.5, abs=0.75)


def test_a_boat_follows_the_surface_that_waves_show() -> None:
    # Sea state 4 is long for a 2 m boat: the height and slope of `elevation` at its place are what it does.
    waves = Waves.draw(SEA_STATES[4], 3, towards_rad=0.4)
    vessel = Vessel(OTTER, waves, heading_rad=1.1)
    t = np.arange(0.0, 60.0, 0.1)
    eta = vessel.motion(t).eta[0]
    surface = waves.elevation((0.0, 0.0), t)[0]
    assert np.std(eta[:, 2] + surface) < 0.15 * surface.std()
    bow, stern = (waves.elevation((s * math.cos(1.1), s * math.sin(1.1)), t)[0] for s in (1e-3, -1e-3))
    ahead = bow - stern
    assert np.corrcoef(ahead, eta[:, 4])[0, 1] > 0.9


def test_under_way_it_meets_the_waves_of_the_places_it_passes() -> None:
    waves = Waves.draw(SEA_STATES[4], 8, towards_rad=2.6)
    vessel = Vessel(OTTER, waves, heading_rad=-0.5, speed_m_s=2.0)
    t = np.arange(0.0, 40.0, 0.1)
    way = 2.0 * t[:, None] * [math.cos(-0.5), math.sin(-0.5)]
    surface = waves.elevation(way, t)[0]
    assert np.std(vessel.motion(t).eta[0, :, 2] + surface) < 0.25 * surface.std()


@given(
    which=st.sampled_from([FERRY, SUPPLY_SHIP]),
    seed=st.integers(0, 10**6),
    heading_rad=st.floats(-4, 4),
    speed_m_s=st.floats(0, 5),
    t=st.floats(0, 300),
    pad_yaw_rad=st.floats(-3, 3),
)
@settings(max_examples=40)
def test_velocity_and_acceleration_are_the_derivatives_of_place_and_attitude(which, seed, t, heading_rad, speed_m_s, pad_yaw_rad):
    course = {"heading_rad": heading_rad, "speed_m_s": speed_m_s, "pad_yaw_rad": pad_yaw_rad}
    vessel = Vessel(which, Waves.draw(SEA_STATES[4], seed), mooring=Mooring(), seeds=seed, **course)
    h = 1e-3
    before, now, later = (vessel.pad_at(t + s) for s in (-h, 0.0, h))
    np.testing.assert_allclose(now.v_ned, (later.p_ned - before.p_ned) / (2 * h), atol=3e-5)
    np.testing.assert_allclose(now.a_ned, (later.v_ned - before.v_ned) / (2 * h), atol=3e-5)
    turned = Rotation(before.R_ned).inv @ Rotation(later.R_ned)
    np.testing.assert_allclose(now.w, turned.rotvec_rad / (2 * h), atol=3e-5)
