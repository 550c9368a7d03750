"""The identified response: true to the simulated vehicle's, honest where a flight does not tell, and readable as a file."""

import json
import math
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from companion.base.observer import Decision, ResponseState
from companion.cli.main import main
from companion.guidance.law.gains import tilt_model
from companion.guidance.law.response_fit import STEP_S, FlightCourse, TiltFit, fit_climb, fit_tilt
from companion.guidance.operator.arbiter import BY_HAND
from companion.parts.recorder.setup import about, recorder_to_file
from companion.recording.mcap_file import Attachment
from companion.recording.reading import open_recording
from companion.settings.guidance import TiltResponse, response_from_mapping
from companion.settings.load import camera_model, shipped_response
from companion.tools.calibrate.flight_views import flown_courses
from decklander.place import SHIPPED
from estimator.contracts.commands import Lean, Velocity
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, Imu
from estimator.contracts.time import MonoNs, Stamp
from sitl.vehicle.airframe import load
from tests.fly import recorded, sim_settings
from tests.support.kept import KeptFlights

GIVEN = shipped_response("ardrone2")
SECONDS = 12.0
"""A descent from 6 m."""


def gauss_markov(rng: np.random.Generator, n: int, sigma: float, time_s: float) -> F64:
    keep = math.exp(-STEP_S / time_s)
    noise, out = sigma * math.sqrt(1.0 - keep * keep) * rng.standard_normal(n), np.zeros(n)
    out[0] = sigma * rng.standard_normal()
    for k in range(1, n):
        out[k] = keep * out[k - 1] + noise[k]
    return out


def drawn_flight(seed: int, gusts_m_s2: float) -> tuple[TiltResponse, FlightCourse]:
    """Return a vehicle drawn at random that follows gusts and the swing of a deck, and reports its tilt with errors."""
    rng = np.random.default_rng(seed)
    true = structs.replace(
        GIVEN.tilt,
        delay_s=rng.uniform(0.0, 0.3),
        frequency_rad_s=GIVEN.tilt.frequency_rad_s * math.exp(0.3 * rng.standard_normal()),
        damping=rng.uniform(0.5, 1.2),
    )
    n = round(SECONDS / STEP_S)
    model, t = tilt_model(true, STEP_S), STEP_S * np.arange(n)
    asked, reported = np.zeros((n, 2)), np.zeros((n, 2))
    for axis in range(2):
        swing = 0.3 * gusts_m_s2 * np.sin(math.tau * t / rng.uniform(5.0, 8.0) + rng.uniform(0.0, math.tau))
        u = swing + gauss_markov(rng, n, gusts_m_s2, 1.0)
        x, trim, error = np.zeros(model.A.shape[0]), rng.standard_normal(), 0.09 * rng.standard_normal()
        for k in range(n):
            reported[k, axis] = x[2]
            x = model.A @ x + model.B * u[k]
        asked[:, axis] = u + trim
        reported[:, axis] += trim + error + gauss_markov(rng, n, 0.07, 1.0) + 0.003 * rng.standard_normal(n)
    return true, FlightCourse(asked, reported, np.arange(n) > 60)


def fitted(course: FlightCourse) -> TiltFit:
    fit = fit_tilt(course, GIVEN.tilt)
    assert fit is not None
    assert fit.response.delay_sigma_s is not None
    return fit


def test_a_descent_reports_the_delay_of_any_vehicle_to_40_ms() -> None:
    # Why: softer gains end where the delay is said to be known, so what is said has to be true.
    errors, sigmas = [], []
    for seed in range(60):
        true, course = drawn_flight(seed, 0.5)
        found = fitted(course).response
        errors.append(found.delay_s - true.delay_s)
        sigmas.append(found.delay_sigma_s)
    within = np.abs(errors) < 3.0 * np.array(sigmas)
    assert within.mean() >= 0.95
    assert np.median(sigmas) < 0.025
    assert np.percentile(sigmas, 90) < 0.04
    assert abs(np.mean(errors)) < 0.01


@settings(max_examples=40, derandomize=True)
@given(st.integers(0, 1_000_000), st.floats(0.0, 0.2))
def test_little_motion_is_never_a_wrong_delay_that_is_sure(seed: int, gusts_m_s2: float) -> None:
    true, course = drawn_flight(seed, gusts_m_s2)
    found = fitted(course).response
    assert abs(found.delay_s - true.delay_s) < max(0.04, 4.0 * found.delay_sigma_s)
    if gusts_m_s2 < 0.01:
        assert found.delay_sigma_s > 0.06


def test_lag_and_delay_of_the_climb_are_distinguished() -> None:
    n, delay, lag = 600, 9, 0.5
    u = np.repeat([0.0, 0.5, 0.9, 0.2, -0.4, 0.5], 100)
    v, rng = np.zeros(n), np.random.default_rng(4)
    for k in range(1, n):
        v[k] = v[k - 1] + (1.0 - math.exp(-STEP_S / lag)) * (u[max(0, k - 1 - delay)] - v[k - 1])
    drift = 0.2 * (STEP_S * np.arange(n)) / 12.0
    fit = fit_climb(
        FlightCourse(u[:, None], (v + drift + gauss_markov(rng, n, 0.02, 1.0))[:, None], np.arange(n) > 60, 0.0, 2), GIVEN.climb
    )
    assert abs(fit.response.delay_s - delay * STEP_S) < 3.0 * fit.response.delay_sigma_s < 0.1
    assert abs(fit.response.lag_s - lag) < 3.0 * fit.response.lag_sigma_s < 0.3


@pytest.fixture(scope="module")
def recordings(kept: KeptFlights) -> dict[str, Path]:
    """Flights of the simulated AR.Drone: as shipped, with another controller, and with nothing that moves."""
    flights: dict[str, list[str]] = {
        "rough": ["sea_state_4", "--seed", "902"],
        "longer": ["sea_state_4", "--seed", "903"],
        "late": ["faults/commands_late_0_1_s", "--seed", "902"],
        "pid": ["sea_state_4", "--seed", "902", "--set", "guidance.controller=pid", "--set", "duration_limit_s=8"],
    }
    return {name: kept(f"identify {name}", recorded(*args, "--perception", "truth")) for name, args in flights.items()}


def truth() -> tuple[float, float, float]:
    """Delay, frequency and damping of the simulated AR.Drone: the slow poles of its attitude loop with the motors' lag in it.

    Half a period of the command datagrams, 30 ms, is waited for the next one, less half a guidance cycle that is held.
    """
    vehicle = load(SHIPPED / "vehicles/ardrone2.toml")
    poles = np.roots([vehicle.motor_lag_s, 1.0, vehicle.loops.tilt_d, vehicle.loops.tilt_p])
    slow = poles[np.argmax(poles.imag)]
    return vehicle.command_delay_s + 0.01, float(abs(slow)), float(-slow.real / abs(slow))


def test_a_recorded_flight_gives_the_response_of_the_simulated_vehicle(recordings, tmp_path, capsys):
    out, plot = tmp_path / "mine.toml", tmp_path / "mine.png"
    assert main(["calibrate", "vehicle", str(recordings["rough"]), "--out", str(out), "--plot", str(plot)]) == 0
    output = capsys.readouterr().out
    assert "tilt   delay" in output
    assert "climb  delay" in output
    assert "does not contradict the given tilt" in output
    sigma_ms = int(re.search(r"tilt   delay \d+ \+- (\d+) ms", output)[1])  # type: ignore[index]
    assert ("begins with softer gains, until the delay is known to 40 ms" in output) == (sigma_ms > 40)
    assert str(out) in output
    found = response_from_mapping(tomllib.loads(out.read_text()), str(out))
    delay_s, frequency_rad_s, damping = truth()
    t = found.tilt
    assert abs(t.delay_s - delay_s) < 3.0 * t.delay_sigma_s < 0.15
    assert abs(t.frequency_rad_s - frequency_rad_s) < 3.0 * t.frequency_sigma_rad_s
    assert abs(t.damping - damping) < 3.0 * t.damping_sigma
    assert found.climb.cov_delay_lag is not None
    assert t.delay_sigma_s**2 == pytest.approx(t.cov_delay_frequency_damping[0][0])
    assert found.climb.delay_s == pytest.approx(GIVEN.climb.delay_s, abs=0.04)
    assert found.climb.lag_s == pytest.approx(GIVEN.climb.lag_s, rel=0.25)
    image = cv2.imread(str(plot))
    assert image.shape[0] > 500
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 50


def test_a_longer_delay_of_the_commands_is_found(recordings: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "vehicle", str(recordings["late"]), "--json"]) == 0
    noted = json.loads(capsys.readouterr().out)
    tilt, loop = noted["tilt"], noted["loop"]
    assert abs(tilt["delay_s"] - truth()[0] - 0.1) < 3.0 * tilt["delay_sigma_s"] < 0.12
    assert loop["by_the_identified"]["delay_s"] >= 0.06, "the law by what was found stands what it should"
    assert loop["by_the_given"]["delay_s"] < 0.06, "and by the file's 50 ms it does not"
    assert noted["chi2_of_given"] > 7.81
    assert np.linalg.eigvalsh(np.array(tilt["cov_delay_frequency_damping"])).min() > 0.0
    assert 0.0 <= noted["cost_was_cm"] < 8.0, "stiffer gains than are due cost centimetres: the margin is nearly used up"
    assert 0.1 < noted["cost_sigma_cm"] < 2.0
    assert noted["climb"]["delay_s"] == pytest.approx(GIVEN.climb.delay_s + 0.1, abs=0.05), "the climb is 100 ms later as well"
    assert main(["calibrate", "vehicle", str(recordings["late"])]) == 0
    output = capsys.readouterr().out.splitlines()
    assert "ms of further delay, less than 60;" in next(line for line in output if "by the given response" in line)


def test_the_flight_itself_found_the_longer_delay_and_flew_by_it(recordings: dict[str, Path]) -> None:
    noted = [e.response for e in open_recording([recordings["late"]]).events() if isinstance(e, Decision) and e.response]
    assert [one.state for one in noted] == [ResponseState.ASSUMED, ResponseState.IDENTIFIED]
    assert noted[-1].delay_s == pytest.approx(truth()[0] + 0.1, abs=0.04)
    noted = [e.response for e in open_recording([recordings["longer"]]).events() if isinstance(e, Decision) and e.response]
    assert [one.state for one in noted] == [ResponseState.ASSUMED, ResponseState.KNOWN]


def test_what_cannot_be_identified_is_reported_in_one_line(recordings, tmp_path, capsys):
    rough, pid = str(recordings["rough"]), str(recordings["pid"])
    for args, output in (
        (
            [pid],
            "as the controller pid and a flight by hand do, and none for a tilt; record a landing with guidance.controller =",
        ),
        ([rough, "--response", "nonesuch"], "shipped ones are ardrone2, autopilot, hexa_7kg, px4, quad_1_5kg)"),
        ([str(tmp_path / "none.mcap")], "No such file"),
        ([rough, "--out", rough], "must end in .toml"),
        ([rough, "--out", f"{rough}/mine.toml"], "--out"),
        ([str(Path(__file__).parents[1] / "golden/approach.mcap"), "--response", "ardrone2"], "holds no commands of guidance"),
    ):
        assert main(["calibrate", "vehicle", *args]) == 2
        received = capsys.readouterr()
        assert output in received.err
        assert received.err.count("decklander: ") == 1, "beside lines of progress, on a busy machine"
        assert received.out == ""


def still_flight(path: Path, seconds: float, kept: dict[str, bytes] | None = None) -> None:
    """Record a vehicle that is asked to tilt by the same angle all the time, and reports it with the noise of its sensors.

    `kept` are the files that the recording holds instead of its own settings, camera and pad.
    """
    scenario = sim_settings()
    rng, cov = np.random.default_rng(2), 1e-4 * np.eye(3)
    described = about(scenario, {"kind": "test"})
    if kept is not None:
        described = replace(described, attachments=[Attachment(name, "application/toml", data) for name, data in kept.items()])
    with recorder_to_file(path, camera_model(scenario), described, frames="none") as recorder:
        for k in range(round(seconds / STEP_S)):
            at = MonoNs(round(1e9 * STEP_S * k) + 1_000_000_000)
            roll, pitch = 0.1 + 0.002 * rng.standard_normal(2)
            recorder.on_sample(Attitude(Stamp(at, at, 0.001, "sim"), Rotation.from_rpy(roll, pitch, 0.0), cov))
            recorder.on_decision(Decision(at, "descend", Lean(np.array([-0.98, 0.98]), np.zeros(2), np.zeros(3), 0.0), None))


def landing_after_a_flight_by_hand(path: Path, by_hand_s: float) -> None:
    """Record a descent in steps that is followed after 60 ms with a lag of 0.4 s, by an accelerometer with a bias."""
    scenario, rng, cov, v = sim_settings(), np.random.default_rng(3), 1e-4 * np.eye(3), 0.0
    n, still = round((by_hand_s + 14.0) / STEP_S), round(by_hand_s / STEP_S)
    leans = 0.6 * np.repeat(rng.normal(size=(n // 25 + 1, 2)), 25, axis=0)
    descents = np.where(np.arange(n) < still, 0.0, np.repeat(rng.uniform(0.0, 0.8, n // 40 + 1), 40)[:n])
    with recorder_to_file(path, camera_model(scenario), about(scenario, {"kind": "test"}), frames="none") as recorder:
        for k in range(n):
            at = MonoNs(round(1e9 * STEP_S * k) + 1_000_000_000)
            stamp = Stamp(at, at, 0.001, "sim")
            a = (descents[max(0, k - 3)] - v) / 0.4
            v += STEP_S * a
            recorder.on_sample(Attitude(stamp, Rotation.from_rpy(0.002 * rng.standard_normal(), 0.0, 0.0), cov))
            recorder.on_sample(Imu(stamp, np.zeros(3), np.array([0.0, 0.0, a - G_M_S2 + 0.4])))
            lean = Lean(leans[k], np.zeros(2), np.array([0.0, 0.0, descents[k]]), 0.0)
            by_hand = k < still
            command = Velocity(np.zeros(3), 0.0) if by_hand else lean
            recorder.on_decision(Decision(at, BY_HAND if by_hand else "descend", command, None))


@pytest.mark.parametrize("by_hand_s", [0.0, 40.0])
def test_the_climb_of_a_landing_is_found_after_a_flight_by_hand(by_hand_s: float, tmp_path: Path) -> None:
    # Why: one recording of a flight by hand and a landing serves every calibration, and an accelerometer drifts meanwhile.
    landing_after_a_flight_by_hand(tmp_path / "a.mcap", by_hand_s)
    courses = flown_courses(open_recording([tmp_path / "a.mcap"]))
    found = fit_climb(courses.climb, GIVEN.climb)
    assert (found.response.delay_s, found.response.lag_s, found.gain) == pytest.approx((0.06, 0.4, 1.0), abs=0.03)
    assert (courses.velocities > 0) is (by_hand_s > 0.0)


@pytest.mark.parametrize(("seconds", "code", "said"), [(20.0, 1, "too little motion"), (4.0, 2, "overlap by less than 4 s")])
def test_a_flight_without_information_writes_no_file(seconds, code, said, tmp_path, capsys):
    still, out = tmp_path / "still.mcap", tmp_path / "mine.toml"
    still_flight(still, seconds)
    assert main(["calibrate", "vehicle", str(still), "--out", str(out)]) == code
    received = capsys.readouterr()
    assert said in received.err
    assert received.err.count("decklander: ") == 1
    assert not out.exists()
