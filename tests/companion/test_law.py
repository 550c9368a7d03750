"""The law that follows the deck: its equations, its model of the vehicle, and what it holds on to."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from companion.guidance.controller import Knowledge, Target
from companion.guidance.law.follow_deck import FollowDeck
from companion.guidance.law.gains import exponential, observer, regulator, riccati, tilt_model
from companion.guidance.law.margins import margins
from companion.settings.load import shipped_response
from companion.settings.response import TiltResponse
from estimator.contracts.commands import Hover, Lean
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2, BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs
from estimator.ekf import Forecast

RESPONSE = shipped_response("ardrone2")
T = 0.02


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_the_riccati_solution_solves_its_equation_and_stabilises(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((n, n)), rng.standard_normal((n, 1))
    Q, R = np.eye(n), np.array([[float(rng.uniform(0.1, 10.0))]])
    X = riccati(A, B, Q, R)
    K = regulator(A, B, Q, R)
    again = A.T @ X @ A - A.T @ X @ B @ np.linalg.solve(R + B.T @ X @ B, B.T @ X @ A) + Q
    assert np.allclose(X, again, rtol=1e-6, atol=1e-8 * np.abs(X).max())
    assert np.abs(np.linalg.eigvals(A - B @ K)).max() < 1.0


def test_what_no_input_reaches_has_no_gains() -> None:
    with pytest.raises(ValueError, match="stabilised"):
        regulator(np.array([[1.1]]), np.array([[0.0]]), np.eye(1), np.eye(1))


def test_the_observer_gain_is_that_of_the_scalar_filter() -> None:
    """X' = x + w, z = x + v: P = (q + sqrt(q^2 + 4 q r)) / 2 before the measurement (Anderson & Moore 1979, sec. 4.4)."""
    q, r = 0.04, 0.3
    P = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))
    L = observer(np.eye(1), np.eye(1), np.array([[q]]), np.array([[r]]))
    assert L[0, 0] == pytest.approx(P / (P + r))


def test_the_exponential_turns() -> None:
    for angle in (1e-6, 0.3, 4.0, -11.0):
        e = exponential(np.array([[0.0, -angle], [angle, 0.0]]))
        assert e == pytest.approx(np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]))


@pytest.mark.parametrize("delay_s", [0.0, 0.013, 0.02, 0.05, 0.0731])
@pytest.mark.parametrize("lag_s", [0.0, 0.073])
def test_the_discrete_model_is_the_continuous_one(delay_s: float, lag_s: float) -> None:
    """The model is compared with small steps of the differential equations, for commands that are held for a period each."""
    tilt = TiltResponse(delay_s, 5.0, 0.7, lag_s)
    model = tilt_model(tilt, T)
    u = np.random.default_rng(3).standard_normal(25)
    x = np.zeros(model.A.shape[0])
    for command in u:
        x = model.A @ x + model.B * command
    dt = 1e-5
    p = w = a = rate = f = 0.0
    for k in range(round(25 * T / dt)):
        at = k * dt - delay_s
        given_now = u[int(at / T + 1e-9)] if at >= -1e-12 else 0.0
        f = f + dt * (given_now - f) / lag_s if lag_s else given_now
        p, w, a, rate = p + dt * w, w - dt * a, a + dt * rate, rate + dt * (25.0 * (f - a) - 7.0 * rate)
    assert x[:4] == pytest.approx([p, w, a, rate], rel=2e-3, abs=2e-3)


def test_the_shipped_law_stands_sixty_milliseconds_more_than_it_knows() -> None:
    whole = margins(RESPONSE.tilt)
    assert whole.stable
    assert whole.delay_s >= 0.06
    assert whole.gain[1] >= 2.0
    assert whole.phase_deg >= 25.0
    assert whole.error_m < 0.018
    slower = structs.replace(RESPONSE.tilt, delay_s=RESPONSE.tilt.delay_s + 0.1)
    assert not margins(RESPONSE.tilt, slower).stable or margins(RESPONSE.tilt, slower).sensitivity > 3.0
    assert margins(slower).stable


# --- in flight -------------------------------------------------------------------------------------------------------------


def _forecast(at: MonoNs, rate: float, slope: float) -> Forecast:
    h = np.array([0.0, 0.5, 1.0])
    v = np.stack([np.zeros(3), np.zeros(3), np.zeros(3)])
    v[:, 2] = rate + slope * h
    z, eye = np.zeros(3), np.zeros((3, 3, 3))
    return Forecast(at, h, np.zeros((3, 3)), eye, v, z, z, -v[:, 2], z, z, z, z, z)


def _known(k: int, d: F64, v: F64, *, lean: tuple[float, float] = (0.0, 0.0), a: F64 | None = None, yaw: float = 0.0,
           deck_down: float = 0.0, deck_a: float = 0.0, forecast: Forecast | None = None) -> Knowledge:  # fmt: skip
    now = MonoNs(k * round(T * 1e9))
    pitch, roll = -math.atan(lean[0] / G_M_S2), math.atan(lean[1] / math.hypot(G_M_S2, lean[0]))
    relative = RelativeState(now, "ekf", d, v, 0.0, 1e-4 * np.eye(7), now, True)
    reported = Rotation.from_rpy(roll, pitch, yaw)
    body = BodyMotion(now, yaw, np.zeros(3) if a is None else a, 1e-4 * np.eye(3), np.zeros(3), reported, 1e-4 * np.eye(3))
    deck = DeckMotion(
        now, np.array([0.0, 0.0, deck_down]), np.array([0.0, 0.0, deck_a]), 1e-4 * np.eye(6), 0.0, 0.0, 0.0, 0.0, np.zeros((4, 4))
    )
    return Knowledge(now, relative, body, deck, forecast)


OVER = np.array([0.0, 0.0, 1.0])
HOLD = Target(OVER)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_the_reported_tilt_is_read_as_the_acceleration_that_it_gives(forward: float, right: float) -> None:
    body = _known(0, OVER, np.zeros(3), lean=(forward, right)).body
    assert body is not None
    assert body.lean_m_s2 == pytest.approx((forward, right), abs=1e-9)


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_a_wind_that_was_learned_in_hover_is_leant_against_from_the_first_step(yaw: float) -> None:
    """Somebody else commands for two seconds in a wind; whoever takes over would otherwise be blown off."""
    law = FollowDeck(RESPONSE, T)
    memory = law.start()
    for k in range(100):
        known = _known(k, OVER, np.zeros(3), lean=(0.9, -0.4), yaw=yaw)
        memory, command = law.step(memory, known.at, known, None)
        assert isinstance(command, Hover)
    known = _known(100, OVER, np.zeros(3), lean=(0.9, -0.4), yaw=yaw)
    _, command = law.step(memory, known.at, known, HOLD)
    assert isinstance(command, Lean)
    assert command.a_level + command.trim_level == pytest.approx([0.9, -0.4], abs=0.05)
    assert command.trim_level == pytest.approx([0.9, -0.4], abs=0.05)


def test_the_tilt_never_exceeds_the_limit_of_vehicle_and_target() -> None:
    rng = np.random.default_rng(1)
    law = FollowDeck(RESPONSE, T)
    memory = law.start()
    for k in range(300):
        d = np.array([*rng.uniform(-6.0, 6.0, 2), rng.uniform(0.1, 8.0)])
        known = _known(k, d, rng.uniform(-2.0, 2.0, 3), lean=tuple(rng.uniform(-3.0, 3.0, 2)), a=rng.uniform(-3.0, 3.0, 3))
        most = None if k % 2 else 0.1
        memory, command = law.step(memory, known.at, known, Target(OVER, lean_max_rad=most))
        assert isinstance(command, Lean)
        lean = math.atan(float(np.hypot(*(command.a_level + command.trim_level))) / G_M_S2)
        assert lean <= (RESPONSE.tilt.max_deg * math.pi / 180.0 if most is None else most) + 1e-9
        assert abs(command.v_level[2]) <= RESPONSE.climb.max_m_s


def test_far_from_the_pad_it_flies_no_faster_than_it_is_reported() -> None:
    """A body that answers its tilt at once, from six metres away."""
    law, p, v = FollowDeck(RESPONSE, T), 6.0, 0.0
    memory, lean, fastest = law.start(), 0.0, 0.0
    for k in range(800):
        known = _known(k, np.array([p, 0.0, 3.0]), np.array([-v, 0.0, 0.0]), lean=(lean, 0.0), a=np.array([lean, 0.0, 0.0]))
        memory, command = law.step(memory, known.at, known, Target(np.array([0.0, 0.0, 3.0]), speed_max_m_s=1.0))
        assert isinstance(command, Lean)
        lean += 0.2 * (float(command.a_level[0] + command.trim_level[0]) - lean)
        v += T * lean
        p -= T * v
        fastest = max(fastest, v)
    assert fastest < 1.25
    assert abs(p) < 0.1


def test_the_deck_is_followed_ahead_of_time() -> None:
    """The first command knows the forecast: the deck that begins to sink is followed before it has sunk."""

    def first(forecast: Forecast | None) -> float:
        law = FollowDeck(RESPONSE, T)
        known = _known(0, OVER, np.zeros(3), forecast=forecast)
        _, command = law.step(law.start(), known.at, known, HOLD)
        assert isinstance(command, Lean)
        return float(command.v_level[2])

    assert first(None) == pytest.approx(0.0)
    assert first(_forecast(MonoNs(0), 0.0, 1.0)) > 0.3
    assert first(_forecast(MonoNs(0), 5.0, 0.0)) == pytest.approx(0.0), "only what changes in a forecast counts"


def descended(target: Target, h: float, push: float) -> list[tuple[float, float]]:
    """Return the course of a vehicle with the shipped response under a push for six seconds: heights and vertical speeds."""
    law, climb = FollowDeck(RESPONSE, T), RESPONSE.climb
    memory, v, course = law.start(), 0.0, []
    waiting = [0.0] * max(1, round(climb.delay_s / T))
    for k in range(300):
        a = (waiting.pop(0) - v) / climb.lag_s + push
        known = _known(k, np.array([0.0, 0.0, h]), np.array([0.0, 0.0, -v]), a=np.array([0.0, 0.0, a]))
        memory, command = law.step(memory, known.at, known, target)
        assert isinstance(command, Lean)
        waiting.append(float(command.v_level[2]))
        v += T * a
        h -= T * v
        course.append((h, v))
    return course


@pytest.mark.parametrize("rate", [0.45, -0.3])
@pytest.mark.parametrize("push", [0.0, 0.3, -0.3])
def test_a_wanted_rate_is_reached_within_a_second_whatever_pushes(rate: float, push: float) -> None:
    course = descended(Target(OVER, rate), 6.0, push)
    assert max(abs(v - rate) for _, v in course[75:]) < 0.03


def test_a_wanted_height_is_flown_to_no_faster_than_allowed_and_held() -> None:
    course = descended(Target(OVER, vertical_rate_max_m_s=0.6), 3.0, 0.0)
    assert max(v for _, v in course) < 0.65
    assert min(h for h, _ in course) > 0.98
    assert course[-1] == pytest.approx((1.0, 0.0), abs=0.02)


def test_the_velocity_of_a_tilt_is_the_one_that_the_body_will_have() -> None:
    """An autopilot that ignores the acceleration still flies towards the pad."""
    law = FollowDeck(RESPONSE, T)
    known = _known(0, np.array([1.0, 0.0, 1.0]), np.array([-0.2, 0.0, 0.0]))
    _, command = law.step(law.start(), known.at, known, HOLD)
    assert isinstance(command, Lean)
    assert command.a_level[0] > 0.1
    assert command.v_level[0] == pytest.approx(0.2 + RESPONSE.tilt.slowness_s * command.a_level[0])


def test_a_vehicle_with_a_velocity_loop_gets_its_own_velocity_and_the_tilt_less_its_own_part() -> None:
    """Otherwise its loop would add a gain of its own to every acceleration, and its integral would count twice."""
    law = FollowDeck(RESPONSE, T, over_ground=True)
    known = _known(0, np.array([1.0, 0.0, 1.0]), np.array([-0.2, 0.0, 0.0]))
    _, command = law.step(law.start(), known.at, known, HOLD)
    assert isinstance(command, Lean)
    assert command.v_level[0] == pytest.approx(0.2)
    plain = FollowDeck(RESPONSE, T)
    _, whole = plain.step(plain.start(), known.at, known, HOLD)
    assert isinstance(whole, Lean)
    assert command.a_level + command.trim_level == pytest.approx(whole.a_level + whole.trim_level)
