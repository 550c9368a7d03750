"""The levels of perception: one flight, seen by an error model or by the truth, with the same pilot behind."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec import structs

from companion.cli.main import main
from companion.settings.load import load
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.register.sighting import sighting_of
from sitl.faults.kinds import KINDS
from sitl.perception import parameters
from sitl.perception.levels import REPRESENTED, TrueMotion, perceive, represents
from sitl.perception.model import Chance, DetectionTable, View, Viewer, _turned, symmetric
from sitl.perception.port import LEVELS, Level
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.settings import settings_for
from sitl.study.perception import recorded as samples_module
from sitl.study.perception.__main__ import main as fit_files
from sitl.study.perception.fit import Errors, Source, fit_detections, fit_estimates
from sitl.world.world import World
from tests.fly import ObservedCalls, fly_for

SIM = load("sim")
CALM = load_scenario("calm")
LOW = msgspec.structs.replace(
    CALM, start=msgspec.structs.replace(CALM.start, height_m=2.2, pad_forward_m=0.3, pad_right_m=0.2), duration_limit_s=40.0
)
FUSED = parameters.load("fused")
EFFECTS = {
    "signal": "gyro", "error": "sign", "by_s": 1.0, "forward_m": 1.0, "frozen": True, "dropped_fraction": 1.0, "instead": True,
    "silent": True,
}  # fmt: skip
"""Keys that give a fault of some kind an effect."""


def verdicts(seconds: float, level: Level, kind: str, start_s: float, duration_s: float, **keys: float) -> list[Verdict]:
    """Return the verdicts of the frames of a flight with one fault."""
    calls = ObservedCalls()
    fly_for(seconds, LOW, 3, level=level, observers=[calls], faults=(KINDS[kind](at_s=start_s, for_s=duration_s, **keys),))
    return [frame.verdict for frame in calls.frames]


def a_view(height_m: float = 2.0, shown: float = 1.0, tilt_rad: float = 0.0) -> View:
    return View(np.eye(3), np.array([0.0, 0.0, height_m]), height_m, shown, tilt_rad)


@pytest.mark.parametrize("level", ["model", "truth"])
def test_a_drone_whose_video_is_coded_is_flown_without_pictures(level: Level) -> None:
    """WHY: the codec of an AR.Drone 1.0 changed the pixels by which a drawn detection is found again."""
    first = load_scenario("ardrone1")
    flight = fly_for(1.5, first, level=level, settings=settings_for(first, None))
    assert flight.health.frames[Verdict.FUSED] > 10


def test_faults_of_frames_act_in_the_model_as_in_pictures() -> None:
    """The verdicts are those that the pilot gives pictures with the same fault."""
    frozen = verdicts(1.6, "model", "frames_frozen", 0.5, 1.0)
    assert frozen.count(Verdict.REPEATED) >= 25
    assert verdicts(1.6, "model", "lens_covered", 0.5, 1.0).count(Verdict.NO_PAD) >= 25
    assert len(verdicts(1.6, "model", "frames", 0.5, 1.0, dropped_fraction=1.0)) <= len(frozen) - 25
    assert Verdict.TOO_OLD in verdicts(1.6, "model", "frames", 0.3, 1.3, delay_s=0.8)
    stamped = verdicts(1.6, "model", "frames_misstamped", 0.5, 1.0, by_s=-2.0)
    assert {Verdict.TOO_OLD, Verdict.NO_ATTITUDE} & set(stamped)


@pytest.mark.parametrize("level", ["model", "pixels"])
def test_a_shifted_pad_is_elsewhere_while_the_picture_holds_it(level: Level) -> None:
    """The picture reaches 1.7 m to the right from 2 m over the deck, but only 1 m ahead: there the shifted pad is cut off."""
    reports = verdicts(1.4, level, "frames_shifted", 0.8, 1.0, right_m=1.0)
    seen = reports.index(Verdict.ELSEWHERE)
    # Once they agree with one another they come as far as the filter, which refuses them.
    assert len(reports[seen:]) >= 15
    assert set(reports[:seen]) == {Verdict.FUSED}
    assert set(reports[seen:]) <= {Verdict.ELSEWHERE, Verdict.GATED}
    cut = verdicts(1.4, level, "frames_shifted", 0.8, 1.0, forward_m=1.3)
    assert cut.count(Verdict.FUSED) == reports.count(Verdict.FUSED), "nothing beside the pad is taken for it"
    assert set(cut) <= {Verdict.FUSED, Verdict.NO_PAD, Verdict.LOW_CONFIDENCE}


@pytest.mark.parametrize("kind", sorted(set(KINDS) - REPRESENTED))
def test_truth_refuses_a_fault_that_it_cannot_represent_and_names_a_level_that_can(kind: str) -> None:
    own = {key: value for key, value in EFFECTS.items() if key in KINDS[kind].__struct_fields__}
    fault = KINDS[kind](at_s=0.5, for_s=1.0, **own)
    with pytest.raises(BadInput, match=kind) as refused:
        perceive("truth").refuse([fault])
    named = next(level for level in LEVELS if str(refused.value).endswith(f"use --perception {level}"))
    assert represents(perceive(named), [fault])


def test_the_true_pose_comes_through_vision_and_back() -> None:
    """The sighting and the attitude give back the pose that registration measured, tilted deck included."""
    pilot = perceive("pixels").pilot(SIM)
    viewer = Viewer(pilot.camera, pilot.pad)
    body, deck = Rotation.from_rpy(0.06, -0.09, 0.7), Rotation.from_rpy(0.03, 0.02, 0.4)
    view = viewer.view(body.matrix, np.array([0.3, -0.2, 1.7]), deck.matrix)
    stamp = Stamp(MonoNs(10**9), MonoNs(10**9), 0.002, "sim")
    reported = Attitude(stamp, Rotation.from_rpy(0.07, -0.08, 0.75), np.eye(3) * math.radians(0.6) ** 2)
    rng = np.random.default_rng(1)
    root = rng.standard_normal((6, 6)) * np.array([1e-4, 1e-4, 3e-4, 1e-3, 1e-3, 1e-3])[:, None]
    error = np.array([2e-4, -1e-4, 5e-4, 1e-3, -2e-3, 5e-4])
    pose = PadPose(Rotation(_turned(error[3:]) @ view.R_cam_pad), view.t_cam_pad + error[:3])
    frame = Frame(stamp, 1, np.zeros((360, 640, 3), np.uint8))
    seen = sighting_of(frame, pose, root @ root.T, pilot.camera, Orientation.of(reported), False, 1.0)
    back = samples_module._in_camera(seen, reported, pilot.camera, math.radians(2.0), view)
    scale = np.array([view.height_m] * 3 + [1.0] * 3)
    np.testing.assert_allclose(back.error * scale, error, atol=1e-9)
    np.testing.assert_allclose(back.cov * np.outer(scale, scale), root @ root.T, rtol=1e-4, atol=1e-12)


def test_the_share_of_the_disc_in_the_picture() -> None:
    pilot = perceive("pixels").pilot(SIM)
    viewer = Viewer(pilot.camera, pilot.pad)
    level, mount = np.eye(3), pilot.camera.T_body_cam.t
    assert viewer.view(level, np.array([0.0, 0.0, 3.0]) + mount, level).shown == 1.0
    half = viewer.view(level, np.array([3.0 * 180 / pilot.camera.fy, 0.0, 3.0]) + mount, level).shown
    assert 0.4 < half < 0.6
    assert viewer.view(level, np.array([3.0, 0.0, 3.0]) + mount, level).shown == 0.0
    assert viewer.view(level, np.array([0.0, 0.0, -3.0]), level).shown == 0.0


def test_draws_have_the_moments_of_the_file() -> None:
    cell = next(c for c in FUSED.detection.cell if c.found > 100 and c.outliers == 0.0)
    model = msgspec.structs.replace(FUSED.detection, cell=(cell,))
    table, rng = DetectionTable(model), np.random.default_rng(2)
    view = a_view(2.0)
    k = table._ratio(view, 0.0)
    found = [table.probability(view, 0.0, True) > u for u in rng.random(4000)]
    assert abs(np.mean(found) - table.probability(view, 0.0, True)) < 0.03
    errors = np.array([table.draw(view, 0.0, rng.standard_normal(7), Chance(np.zeros(7), np.ones(4))).error for _ in range(4000)])
    scale = np.array([2.0] * 3 + [1.0] * 3)
    np.testing.assert_allclose(errors.mean(axis=0) / scale, cell.bias, atol=4 * k * np.sqrt(max(cell.error)) / math.sqrt(4000))
    expected = k * np.sqrt(symmetric(cell.error, 6).diagonal())
    np.testing.assert_allclose((errors / scale).std(axis=0), expected, rtol=0.06)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("format = 1", "format = 7", "format 7"),
        ('method = "fused"', "method = 3", "method"),
        ("kept = ", "kept = 2.0 #", "kept"),
        ("heights_m = [0.15, 0.25", "heights_m = [0.25, 0.15", "must rise"),
    ],
)
def test_a_damaged_model_is_refused_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    path, text = tmp_path / "bad.toml", parameters.dump(FUSED)
    path.write_text(text)
    assert parameters.load(str(path)) == FUSED
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(BadInput, match=said) as why:
        parameters.load(str(path))
    assert "\n" not in str(why.value)
    with pytest.raises(BadInput, match="thesis"):
        perceive("model").pilot(msgspec.structs.replace(SIM, vision=msgspec.structs.replace(SIM.vision, method="thesis")))


def test_the_claimed_covariance_of_a_draw_is_positive() -> None:
    table = DetectionTable(FUSED.detection)
    for height in (0.2, 0.4, 1.0, 3.0, 8.0, 25.0):
        for shown in (0.05, 0.4, 1.0):
            drawn = table.draw(a_view(height, shown), 0.0, np.zeros(7), Chance(np.zeros(7), np.ones(4)))
            assert np.linalg.eigvalsh(drawn.cov).min() > 0.0


def flown_samples(
    rng: np.random.Generator, n: int, p: float, root: np.ndarray, bias: np.ndarray
) -> list[samples_module.DetectionSample]:
    """Return detections of the whole pad from 2.5 m, found with probability p, with errors of a known bias and covariance."""
    view, out = a_view(2.5), []
    for i in range(n):
        error = bias + root @ rng.standard_normal(6)
        measured = samples_module.Measured(error, 4.0 * root @ root.T, False, False) if rng.random() < p else None
        out.append(samples_module.DetectionSample(i / 30.0, view, measured, 0.9))
    return out


def test_the_fit_finds_what_made_the_samples() -> None:
    rng = np.random.default_rng(3)
    root = np.diag([1e-4, 2e-4, 5e-4, 1e-3, 1e-3, 2e-3])
    bias = np.array([5e-5, 0.0, -2e-4, 0.0, 1e-3, 0.0])
    usual = Source(tuple(flown_samples(rng, 4000, 0.9, root, bias)), 0.0)
    dim = Source(tuple(flown_samples(rng, 1500, 0.5, 2.0 * root, bias)), -3.0)
    model = fit_detections([usual, dim])
    (cell,) = model.cell
    assert cell.frames == 5500
    assert cell.found == sum(sample.measured is not None for source in (usual, dim) for sample in source.samples)
    assert cell.bias == pytest.approx(bias.tolist(), abs=6e-5)
    assert symmetric(cell.claimed, 6).diagonal()[2] == pytest.approx(1e-6 * 4**0.17, rel=0.1)
    assert cell.spread == pytest.approx(0.0, abs=1e-9)  # that of the usual flight; the dim one is the factor's
    # The dim flight, against the usual one: fewer finds, twice the errors.
    i = np.searchsorted(model.light_stops.edges, -3.0)
    table = DetectionTable(model)
    assert table.probability(a_view(2.5), 0.0, True) == pytest.approx(0.9, abs=0.08)
    assert table.probability(a_view(2.5), -3.0, True) < 0.75
    assert model.light_stops.odds[i] < 0.4
    assert model.light_stops.ratio[i] == pytest.approx(2.0, rel=0.25)
    assert model.correlation < 0.05


def test_the_fit_of_the_estimate_finds_its_covariance_and_its_memory() -> None:
    rng, n, tau_s = np.random.default_rng(4), 6000, 0.8
    keep = math.exp(-0.02 / tau_s)
    x = np.zeros((n, 7))
    for k in range(1, n):
        x[k] = keep * x[k - 1] + math.sqrt(1 - keep * keep) * rng.standard_normal(7)
    sigma = np.array([0.01, 0.02, 0.002, 0.03, 0.03, 0.02, 0.005])
    at = np.arange(n) * 0.02
    model = fit_estimates([Errors(at, np.full(n, 2.5), np.full(n, 0.1), x * sigma)])
    (cell,) = model.cell
    assert np.sqrt(symmetric(cell.error, 7).diagonal()) == pytest.approx(sigma, rel=0.35)
    assert np.median(model.correlation_s) == pytest.approx(tau_s, rel=0.4)
    with pytest.raises(BadInput, match="estimates"):
        fit_estimates([Errors(at[:3], at[:3], at[:3], x[:3])])
    with pytest.raises(BadInput, match="too few"):
        fit_detections([Source(tuple(flown_samples(rng, 20, 0.9, np.eye(6), np.zeros(6))), 0.0)])


def test_a_recorded_flight_without_pictures_is_no_ground_for_a_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = tmp_path / "short.toml"
    scenario.write_text('title = "short"\nbase = "calm"\nduration_limit_s = 1.0\n')
    flown = tmp_path / "flown.mcap"
    main(["simulate", str(scenario), "--perception", "model", "--record", str(flown), "--json"])
    capsys.readouterr()
    with pytest.raises(SystemExit, match="--perception model"):
        fit_files([str(flown), "--output", str(tmp_path / "x.toml")])
    assert not (tmp_path / "x.toml").exists()


STEP_NS = 4_000_000


class WithoutErrors:
    """Stands for the generator of the errors."""

    def standard_normal(self, n: int) -> F64:
        return np.zeros(n)


def test_the_tilt_rates_are_those_of_the_deck_whatever_the_ships_heading() -> None:
    """A rate turned by the ship's heading once more would exchange roll and pitch."""
    scenario = load_scenario("sea_state_4")
    world = World(structs.replace(scenario, vessel=structs.replace(scenario.vessel, heading_deg=100.0)), 3)
    reported = TrueMotion(world, WithoutErrors())  # type: ignore[arg-type]
    differences, rates, size = [], [], []
    for k in range(1, 200):
        world.advance(MonoNs(25 * k * STEP_NS - STEP_NS))
        before = world.truth().R_ned_pad.rpy_rad
        world.advance(MonoNs(25 * k * STEP_NS))
        _, deck = reported.motion(world.at, None)
        after = world.truth().R_ned_pad.rpy_rad
        differences.append([(after[i] - before[i]) / (STEP_NS * 1e-9) for i in (0, 1)])
        rates.append([deck.roll_rate_rad_s, deck.pitch_rate_rad_s])
        size.append(deck.tilt_rad)
    off = np.array(rates) - np.array(differences)
    assert np.abs(off).max() < 2e-3
    assert np.abs(differences).max() > 2e-2, "there is a motion to be told"
    assert max(size) < math.radians(30.0)
