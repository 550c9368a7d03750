"""The training worlds: the same by seed however many step together, a deck as the vessel's, and every end of an episode."""

import copy
import math
import pickle
import subprocess
import sys
from dataclasses import replace

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given
from hypothesis import strategies as st

from companion.guidance.law.policy import STEP_S
from companion.settings.load import load as load_settings
from estimator.contracts.errors import BadInput
from sitl.scenario.scenario import load
from sitl.study.experiments.chapter5 import error_of, spread
from sitl.study.experiments.flown import Estimate, ExperimentFlight, calm_scenario, fly_by_hand
from sitl.study.experiments.hand import HeldPose, hold, level_axes, thesis_axes, thesis_yaw_rad
from sitl.study.experiments.page import in_html
from sitl.study.gym.environment import LandEnv, LandVectorEnv, weighted
from sitl.study.gym.training import ENDS, TERMS, TrainingOptions, TrainingWorlds
from sitl.world.stage import sea_and_vessel
from sitl.world.world import World


def towards_pad(seen: np.ndarray, full_m_s2: float) -> np.ndarray:
    """Return the actions of a proportional-derivative law that descends in a cone over the pad."""
    actions = np.zeros((len(seen), 4), np.float32)
    actions[:, :2] = (0.8 * seen[:, :2] + 1.4 * seen[:, 3:5]) / full_m_s2
    actions[:, 2] = np.where(np.hypot(seen[:, 0], seen[:, 1]) < 0.15 + 0.3 * seen[:, 2], 0.7, 0.0)
    return actions


def test_a_simple_law_lands_in_the_worlds() -> None:
    worlds = TrainingWorlds(load("sea_state_3"), 32)
    worlds.begin(range(32))
    ends, distances = np.zeros(len(ENDS), int), []
    for _ in range(900):
        worlds.step(towards_pad(worlds.views, worlds.acceleration_m_s2))
        ends += np.bincount(worlds.ends, minlength=len(ENDS))
        distances.append(worlds.touchdowns[worlds.ends == ENDS.index("landed"), 0])
    assert ends[ENDS.index("landed")] > 15
    assert ends[ENDS.index("landed")] > 0.9 * ends[1:].sum()
    assert np.median(np.concatenate(distances)) < 0.25


@pytest.mark.parametrize("threads", [1, 3])
def test_a_world_is_the_same_among_others_as_alone(threads: int) -> None:
    """World 2 of eight meets the single environment of its seed to the bit, through the end of an episode."""
    many, alone = LandVectorEnv(8, "weather_4", threads=threads), LandEnv("weather_4")
    seen, _ = many.reset(seed=5)
    first, _ = alone.reset(seed=7)
    assert (seen[2] == first).all()
    rng, ended = np.random.default_rng(0), False
    while not ended:
        actions = rng.uniform(-0.4, 0.4, (8, 4)).astype(np.float32)
        seen, rewards, *_, info = many.step(actions)
        first, reward, terminated, truncated, _ = alone.step(actions[2])
        ended = terminated or truncated
        assert rewards[2] == np.float32(reward)
        assert ((info["final_obs"] if ended else seen)[2] == first).all()


def test_the_deck_moves_as_the_vessel_s_responses_say() -> None:
    """The closed form of the same harmonics with a world's phases, against what the worlds carry step by step."""
    scenario = load("sea_state_4")
    worlds = TrainingWorlds(scenario, 1)
    worlds.begin([3])
    vessel = sea_and_vessel(scenario, [0])[1]
    harmonics, count = vessel.harmonics[0], len(vessel.harmonics[0])
    world = worlds.snapshot(0)
    phases = np.array(world["phasor_re"][:count]) + 1j * np.array(world["phasor_im"][:count])
    steps = 300
    for _ in range(steps):
        worlds.step(np.zeros((1, 4), np.float32))
        assert worlds.ends[0] == 0
    turned = phases * np.exp(-1j * harmonics["w_rad_s"] * steps * STEP_S)
    eta = ((harmonics["re"] + 1j * harmonics["im"]) * turned[:, None]).real.sum(axis=0)
    assert worlds.snapshot(0)["deck_at"][1][:6] == pytest.approx(eta, abs=1e-9)
    heave_m = worlds.snapshot(0)["deck"]["p"][2] + vessel.hull.freeboard_m
    arm_m = 2.0 * abs(eta[3:5]).max() * math.hypot(*vessel.hull.d_vessel_pad_m)
    assert heave_m == pytest.approx(eta[2], abs=arm_m + 0.01)


def test_every_action_is_flown_and_every_episode_ends() -> None:
    """Actions without bounds end no episode otherwise than as listed; observations stay finite."""
    worlds = TrainingWorlds(load("weather_5"), 16, TrainingOptions(time_limit_s=6.0, wrong_model=3.0))
    worlds.begin(range(32, 48))
    rng, seen = np.random.default_rng(1), set()
    for step in range(400):
        actions = (rng.standard_normal((16, 4)) * 10.0).astype(np.float32)
        actions[:4, 2] = 1.0
        actions[4:8, :3] = (0.0, 1.0, 0.3)
        actions[8] = (-1.0) ** step * np.inf
        worlds.step(actions)
        seen |= {ENDS[end] for end in worlds.ends}
        assert np.isfinite(worlds.views).all()
        assert np.isfinite(worlds.terms).all()
    assert {"left", "timed_out"} < seen
    actions[5, 2] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        worlds.step(actions)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"action": "velocity", "perception": "truth", "vehicle": "quad_1_5kg"},
        {"observation": "pixels", "render_mode": "rgb_array"},
    ],
)
def test_gymnasium_s_checker_finds_nothing(options: dict[str, str], recwarn: pytest.WarningsRecorder) -> None:
    check_env(gymnasium.make("Decklander/Land-v0", **options).unwrapped, skip_render_check="render_mode" not in options)
    assert not [str(w.message) for w in recwarn if "infinity" not in str(w.message)]


@pytest.mark.parametrize(
    "line",
    [
        "import gymnasium; gymnasium.make('sitl.study.gym:Decklander/Land-v0')",
        "import gymnasium, sitl.study.gym; gymnasium.make('Decklander/Land-v0'); sitl.study.gym.register()",
        "import gymnasium, sitl.study.gym; gymnasium.make_vec('Decklander/Land-v0', 2, vectorization_mode='vector_entry_point')",
    ],
)
def test_a_plain_import_or_the_package_in_the_name_is_enough(line: str) -> None:
    subprocess.run([sys.executable, "-W", "error", "-c", line], check=True)


def test_a_reward_of_one_s_own_replaces_the_shipped_one() -> None:
    env = LandEnv("calm", reward=weighted(dict.fromkeys(TERMS, 0.0) | {"time": 1.0}))
    env.reset(seed=1)
    assert env.step(np.zeros(4, np.float32))[1] == pytest.approx(-STEP_S)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("more", [{}, {"observation": "pixels"}, {"num_envs": 3, "threads": 2}])
def test_a_copy_flies_on_as_the_world_does_and_apart_from_it(copied, more) -> None:
    env = (LandVectorEnv if "num_envs" in more else LandEnv)(scenario="calm", **more)
    env.reset(seed=4)
    actions = np.full((40, *env.action_space.shape), 0.2, np.float32)
    for action in actions[:5]:
        env.step(action)
    env.action_space.seed(1)
    twin = copied(env)
    flown = [env.step(action)[:4] for action in actions] + [env.reset()[:1]]
    again = [twin.step(action)[:4] for action in actions] + [twin.reset()[:1]]
    assert all(np.array_equal(a, b) for one, other in zip(flown, again, strict=True) for a, b in zip(one, other, strict=True))
    assert np.array_equal(env.action_space.sample(), twin.action_space.sample())


@pytest.mark.parametrize(
    "bad",
    [
        {"perception": "pixels"}, {"action": "thrust"}, {"observation": "image"}, {"num_envs": 2, "observation": "pixels"},
        {"wrong_model": math.nan}, {"wrong_model": -1.0}, {"start_low": (math.nan,) * 4}, {"time_limit_s": 0.0}, {"reward": "x"},
        {"num_envs": 0}, {"num_envs": 2, "threads": -1}, {"num_envs": 2, "perception": "Truth"},
        {"scenario": "supply_ship_turning"},
    ],
    ids=str,
)  # fmt: skip
def test_a_word_or_number_that_no_world_has_is_refused_and_named(bad) -> None:
    with pytest.raises((ValueError, BadInput), match=f"{[*bad][-1]}|steady course|1 or more"):
        (LandVectorEnv if "num_envs" in bad else LandEnv)(**bad)


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.1, 10), st.floats(-3.1, 3.1))
def test_the_axes_of_the_thesis_lead_back(x: float, y: float, z: float, yaw: float) -> None:
    assert thesis_axes(level_axes(HeldPose(x, y, z))).tolist() == [x, y, z]
    assert math.isclose(math.cos(thesis_yaw_rad(thesis_yaw_rad(yaw)) - yaw), 1.0, abs_tol=1e-12)


def test_a_flight_begins_at_the_pose_of_the_thesis() -> None:
    truth = World(calm_scenario(HeldPose(1.0, 2.0, 3.5, -90.0), 5.0, exact_attitude=True), 1).truth()
    assert thesis_axes(truth.d_body_pad_level) == pytest.approx([1.0, 2.0, 3.5], abs=0.02)
    assert math.degrees(thesis_yaw_rad(truth.yaw_rad)) == pytest.approx(-90.0, abs=0.5)


def test_the_spread_counts_frames_without_an_estimate() -> None:
    flown = ExperimentFlight(frames=4)
    for error in (0.01, 0.03):
        flown.sightings.append(Estimate(1.0, "arrow", np.array([error, 0.0, 1.0]), 0.1, np.array([0.0, 0.0, 1.0]), 0.0, 0.01))
    found = spread(flown, "arrow", "x")
    assert found == pytest.approx((20.0, 10.0, 10.0, 30.0, 0.5))
    assert error_of(flown.sightings[0], "yaw") == pytest.approx(math.degrees(0.1))
    assert spread(flown, "corners", "x") is None
    half = replace(flown.sightings[0], name="corners", yaw_rad=0.1 - math.pi)
    assert error_of(half, "yaw") == pytest.approx(math.degrees(0.1))
    assert error_of(replace(half, name="arrow"), "yaw") == pytest.approx(math.degrees(0.1 - math.pi))


def test_a_notebook_shows_headings_tables_and_figures_of_the_experiments() -> None:
    text = "# **One** & `two`\n\n| a | b |\n|---|---|\n|  | 1 < 2 |\n\n![Errors](x.png)\n"
    table = "<table><tr><th> a </th><th> b </th></tr><tr><td>  </td><td> 1 &lt; 2 </td></tr></table>"
    assert in_html(text, {"x.png": "<svg/>"}) == f"<h1><b>One</b> &amp; <code>two</code></h1>\n{table}\n<svg/>"


def test_a_short_hover_by_hand_sees_the_pad_and_errs_little() -> None:
    settings = load_settings("sim")
    settings = msgspec.structs.replace(settings, vision=msgspec.structs.replace(settings.vision, method="fused"))
    flown = fly_by_hand(settings, hold(HeldPose(0.0, 0.0, 1.0)), 0.6, 3)
    assert flown.frames >= 5
    for method in ("arrow", "corners", "registration", "best"):
        found = spread(flown, method, "z")
        assert found.available > 0.8
        assert abs(found.mean) < 10.0
    assert {e.name for e in flown.beliefs} == {"ekf", "median_mean", "dead_reckoning"}
    assert max(abs(float(e.xyz_m[2] - e.true_xyz_m[2])) for e in flown.of("ekf")) < 0.1
