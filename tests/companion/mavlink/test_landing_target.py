"""The target as each autopilot understands it: every field, the receivers' own arithmetic, the pad's velocity, and the lag."""

import itertools
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import Struct

from companion.guidance.flight_memory import KEPT_WAY_S, FlightMemory
from companion.parts.mavlink.make import FORGET_S, DeckVelocity
from companion.parts.mavlink.outputs import (
    TargetTrack,
    distance_sensor,
    effective_lag_s,
    lag_locked,
    landing_target,
    position_at,
    range_along_down,
    target_relative,
)
from drivers.clock import SystemClock
from drivers.mavlink.autopilot import open_autopilot
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.samples import LocalPosition
from drivers.mavlink.take_off import Rested
from drivers.mavlink.vehicle import Stack
from estimator.contracts.commands import Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.companion.mavlink.receivers import ArduPilotReceiver, Euler, Px4Receiver, Vector, ned_to_body
from tests.companion.test_flight_memory import back
from tests.make import ns
from tests.support.waiting import until

HEADINGS_DEG = (0, 45, 90, 135, 180, -135, -90, -45)
TILTS_DEG = ((0.0, 0.0), (15.0, -7.0), (-11.0, 18.0))
D_NED: Vector = (0.83, -1.42, 4.1)
P_NED: Vector = (31.0, -52.0, -17.0)
ARROW_DEG = 25.0
RADIUS_M = 0.39
TIME_US = 1_234_567_890


class Case(Struct, frozen=True):
    """One vector."""

    stack: str
    heading_deg: int
    roll_deg: float
    pitch_deg: float

    @property
    def name(self) -> str:
        return f"{self.stack} heading {self.heading_deg} roll {self.roll_deg:g} pitch {self.pitch_deg:g}"

    @property
    def rpy(self) -> Vector:
        return math.radians(self.roll_deg), math.radians(self.pitch_deg), math.radians(self.heading_deg)


CASES = [Case(stack, h, *tilt) for stack in ("ardupilot", "px4") for h in HEADINGS_DEG for tilt in TILTS_DEG]


ARROW = Rotation.from_rpy(0.0, 0.0, math.radians(ARROW_DEG))


def send(case: Case, R_ned_pad: Rotation | None = None) -> Message:
    body, place = Rotation.from_rpy(*case.rpy), None if case.stack == "ardupilot" else np.array(P_NED)
    message = landing_target(TIME_US, np.array(D_NED), body, place, pad_radius_m=RADIUS_M, R_ned_pad=R_ned_pad)
    assert message is not None
    return message


def over_the_wire(message: Message) -> Message:
    (got,) = Codec(1, 1).feed(Codec(7, 191).pack(message))
    return got


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_every_field_is_what_one_turn_after_the_other_gives(case: Case) -> None:
    """The fields are computed by the receivers' own turns, not by the geometry under test."""
    x, y, z = ned_to_body(case.rpy, D_NED)
    distance = math.sqrt(x * x + y * y + z * z)
    size = 2 * math.atan(RADIUS_M / distance)
    if case.stack == "ardupilot":
        frame, place = 12, (x, y, z)
    else:
        frame, place = 1, (P_NED[0] + D_NED[0], P_NED[1] + D_NED[1], P_NED[2] + D_NED[2])
    m = over_the_wire(send(case))
    ours = (m.angle_x, m.angle_y, m.distance, m.size_x, m.size_y, m.x, m.y, m.z)
    assert ours == pytest.approx((math.atan(y / z), math.atan(-x / z), distance, size, size, *place), rel=2e-7, abs=2e-7)
    assert (m.time_usec, m.target_num, m.frame, m.type, m.position_valid) == (TIME_US, 0, frame, 3, 1)
    assert list(m.q) == [0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("case", [c for c in CASES if c.stack == "px4"], ids=lambda c: c.name)
def test_px4_takes_the_target_where_it_is(case: Case) -> None:
    m = over_the_wire(send(case, ARROW))
    receiver = Px4Receiver()
    kind, place = receiver.on_message(m) or ("", (0.0, 0.0, 0.0))
    assert kind == "absolute"
    assert place == pytest.approx([p + d for p, d in zip(P_NED, D_NED, strict=True)], abs=1e-5)
    assert (m.frame, m.position_valid, m.type, m.time_usec) == (1, 1, 3, TIME_US)
    assert list(m.q) == pytest.approx(ARROW.quat_wxyz, abs=1e-6)


coordinate = st.floats(-8.0, 8.0)


@settings(max_examples=80)
@given(coordinate, coordinate, st.floats(0.3, 20.0), st.floats(-0.35, 0.35), st.floats(-0.35, 0.35), st.floats(-3.14, 3.14))
def test_angles_position_and_distance_agree_wherever_the_pad_is(x, y, z, roll, pitch, yaw):
    d: Vector = (x, y, z)
    message = landing_target(1, np.array(d), Rotation.from_rpy(roll, pitch, yaw), pad_radius_m=0.39)
    if message is None:
        assert ned_to_body((roll, pitch, yaw), d)[2] < 0.03
        return
    m = over_the_wire(message)
    tolerance_m = 2e-5 * m.distance / max(m.z, 0.02)
    for form in ("position", "angles of 4.0", "angles and a rangefinder"):
        receiver = ArduPilotReceiver(angles_only=form != "position")
        if form == "angles and a rangefinder":
            m.distance, receiver.rangefinder_m = 0.0, ned_to_body((roll, pitch, yaw), d)[2]
        receiver.loop((roll, pitch, yaw))
        assert receiver.on_message(m) == pytest.approx(d, abs=tolerance_m)


def test_the_receivers_drop_what_the_real_ones_drop() -> None:
    """The models of this test against what was measured on the programs themselves."""
    good = over_the_wire(send(CASES[0]))
    receiver = ArduPilotReceiver()
    receiver.loop((0.0, 0.0, 0.0))
    for frame in (1, 8):
        good.frame = frame
        assert receiver.on_message(good) is None
    assert receiver.texts == ["Plnd: Frame not supported"]
    good.frame, good.distance = 12, 0.0
    assert receiver.on_message(good) is None
    px4 = Px4Receiver()
    assert px4.on_message(good) is None
    assert px4.events == ["landing target: unsupported coordinate frame 12"]


def test_target_relative_for_the_vision_target_estimator() -> None:
    body = Rotation.from_rpy(0.1, -0.2, math.radians(90.0))
    cov = np.diag([0.01, 0.04, 0.09])
    m = over_the_wire(target_relative(TIME_US, np.array(D_NED), cov, body, ARROW, 0.05))
    assert (m.timestamp, m.frame, m.type) == (TIME_US, 1, 3)
    expected = ned_to_body((0.1, -0.2, math.radians(90.0)), D_NED)
    assert (m.x, m.y, m.z) == pytest.approx(expected, abs=1e-5)
    # Nose east: forward carries east's sigma, right carries north's
    assert m.pos_std[:2] == pytest.approx((0.2, 0.1), abs=0.02)
    assert sum(s * s for s in m.pos_std) == pytest.approx(0.14, rel=1e-5), "a rotation keeps the trace"
    assert m.yaw_std == pytest.approx(0.05)
    to_ned = Rotation.from_quat(m.q_sensor)
    assert (to_ned @ Rotation.from_quat(m.q_target)).angle_to(ARROW) < 1e-5
    assert to_ned @ np.array([m.x, m.y, m.z]) == pytest.approx(D_NED, abs=1e-5)


def test_distance_sensor_looks_down_and_says_when_it_sees_nothing() -> None:
    m = over_the_wire(distance_sensor(2**32 + 7, 3.456, 0.03, 9))
    assert (m.current_distance, m.orientation, m.covariance, m.id, m.signal_quality) == (346, 25, 9, 9, 0)
    assert m.min_distance < m.current_distance < m.max_distance
    m = over_the_wire(distance_sensor(7, None, 0.03, 9))
    assert m.current_distance > m.max_distance
    assert m.signal_quality == 1


def test_the_range_is_along_the_bodys_down_axis() -> None:
    for roll, pitch in ((0.0, 0.0), (0.3, -0.2), (-0.1, 0.35)):
        body = Rotation.from_rpy(roll, pitch, 1.0)
        reading = range_along_down(np.array([1.0, -2.0, 4.0]), body)
        assert (body @ np.array([0.0, 0.0, reading]))[2] == pytest.approx(4.0)
    assert range_along_down(np.array([0.0, 0.0, -1.0]), Rotation.identity()) is None


HOST = "127.0.0.1"
YAW = math.radians(130.0)


@dataclass
class Scene:
    """A body with its nose to the south-east over a pad that is believed in with some noise."""

    v_pad_ned: F64
    v_body_ned: F64 = field(default_factory=lambda: np.array([0.4, -0.3, 0.2]))
    t_s: float = 1.0
    sighted_s: float | None = None
    """Time when the pad was last seen; None for just now."""
    rested: Rested | None = None
    steered: bool = False
    sigma_m_s: float = 0.1
    p_body_ned: F64 = field(default_factory=lambda: np.zeros(3))
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(4))

    @property
    def now(self) -> MonoNs:
        return MonoNs(round(self.t_s * NS_PER_S))

    @property
    def attitude(self) -> Attitude | None:
        return Attitude(Stamp(self.now, self.now, 0.0, "synced"), Rotation.from_rpy(0.05, -0.1, YAW), np.eye(3) * 1e-4)

    @property
    def positions(self) -> tuple[LocalPosition, ...]:
        return (LocalPosition(Stamp(self.now, self.now, 0.0, "synced"), self.p_body_ned, self.v_body_ned),)

    def believe(self, now: MonoNs) -> RelativeState | None:
        v = Rotation.from_rpy(0.0, 0.0, YAW).inv @ (self.v_pad_ned - self.v_body_ned + self.rng.normal(0.0, 0.1, 3))
        sighted = now if self.sighted_s is None else MonoNs(round(self.sighted_s * NS_PER_S))
        return RelativeState(now, "ekf", np.array([0.1, 0.2, 3.0]), v, 0.3, np.eye(7) * self.sigma_m_s**2, sighted, True)


def run_for(way: DeckVelocity, scene: Scene, seconds: float) -> F64:
    found = np.zeros(3)
    for _ in range(round(50 * seconds)):
        scene.t_s += 0.02
        found = way(scene.now)
    return found


def test_a_ship_under_way_is_found_whatever_the_body_does_and_her_heave_is_followed_in_sight() -> None:
    scene = Scene(np.array([1.2, -0.9, 0.0]))
    way = DeckVelocity(scene.believe, scene)
    assert run_for(way, scene, 3.0)[:2] == pytest.approx([1.2, -0.9], abs=0.06)
    scene.v_body_ned = np.array([-2.0, 1.0, 0.5])
    assert run_for(way, scene, 0.1)[:2] == pytest.approx([1.2, -0.9], abs=0.06)
    scene.v_pad_ned = np.array([1.2, -0.9, -0.8])
    assert run_for(way, scene, 0.6)[2] == pytest.approx(-0.8, abs=0.12)
    scene.sighted_s = scene.t_s
    assert run_for(way, scene, 1.0) == pytest.approx([1.2, -0.9, 0.0], abs=0.06)


def test_a_velocity_that_is_hardly_known_is_nobodys_way() -> None:
    """WHY: a hold that goes with a velocity known to 1 m/s leaves the deck."""
    scene = Scene(np.array([1.2, -0.9, 0.0]), sigma_m_s=1.0)
    way = DeckVelocity(scene.believe, scene)
    assert run_for(way, scene, 3.0).tolist() == [0.0, 0.0, 0.0]


def test_it_is_held_without_sight_then_kept_as_the_ship_s_way_and_forgotten_in_the_end() -> None:
    """A vehicle that gave up must not stay over the ground while the ship sails away from under it."""
    scene = Scene(np.array([1.5, 0.0, 0.0]))
    way = DeckVelocity(scene.believe, scene)
    run_for(way, scene, 3.0)
    scene.sighted_s = scene.t_s
    held = run_for(way, scene, 5.0)
    assert held == pytest.approx([1.5, 0.0, 0.0], abs=0.06)
    assert run_for(way, scene, FORGET_S) == pytest.approx([1.5, 0.0, 0.0], abs=0.06)
    scene.t_s += KEPT_WAY_S - FORGET_S - 6.0
    assert run_for(way, scene, 0.1)[0] == pytest.approx(1.5, abs=0.06)
    assert np.all(run_for(way, scene, 2.0) == 0.0)


def test_a_deck_measured_by_a_velocity_that_is_refused_moves_as_the_ship_reports_or_as_it_did_at_the_take_off() -> None:
    """WHY: a bias of 4.6 m/s was taken for the way of a moored ship, and a drone that had given up flew after it for a minute."""
    scene, trusted, reported = Scene(np.array([-3.8, 0.0, 0.0])), True, None
    scene.rested = Rested(scene.now, np.array([0.4, 0.1, 0.0]), np.zeros(3))
    way = DeckVelocity(scene.believe, scene, lambda now: reported, lambda: trusted)
    assert run_for(way, scene, 60.0)[0] == pytest.approx(-3.8, abs=0.06)
    trusted = False
    assert run_for(way, scene, 1.0) == pytest.approx([0.4, 0.1, 0.0])
    reported = np.array([1.0, 2.0])
    assert run_for(way, scene, 1.0) == pytest.approx([1.0, 2.0, 0.0])
    trusted = True
    assert run_for(way, scene, 60.0)[0] == pytest.approx(-3.8, abs=0.06)


def test_waves_are_averaged() -> None:
    scene = Scene(np.zeros(3))
    way = DeckVelocity(scene.believe, scene)
    found = []
    for n in range(1000):
        scene.v_pad_ned = np.array([1.5 + 0.6 * math.sin(math.tau * n / 400), 0.0, 0.0])
        scene.t_s += 0.02
        found.append(way(scene.now)[0])
    assert np.mean(found[400:]) == pytest.approx(1.5, abs=0.05)
    assert np.ptp(found[400:]) < 0.75, "of 1.2 m/s"


@pytest.mark.parametrize("lost_s", [20.0, 21.0, 22.0, 23.0, 24.0, 25.0, 26.0])
def test_out_of_sight_the_ship_is_followed_and_not_the_wave_that_she_was_last_seen_on(lost_s: float) -> None:
    """WHY: what is left of a wave is followed for minutes: 0.16 m/s took a drone that had given up 22 m astern."""
    scene = Scene(np.zeros(3))
    way = DeckVelocity(scene.believe, scene)
    while scene.t_s < lost_s:
        scene.v_pad_ned = np.array([1.5 + 0.4 * math.sin(math.tau * scene.t_s / 7.0), 0.0, 0.0])
        run_for(way, scene, 0.02)
    scene.sighted_s = scene.t_s
    assert run_for(way, scene, 15.0) == pytest.approx([1.5, 0.0, 0.0], abs=0.12)
    assert run_for(way, scene, 2.0 * FORGET_S) == pytest.approx([1.5, 0.0, 0.0], abs=0.12)


def test_out_of_sight_a_ship_that_turned_goes_on_as_she_went_last() -> None:
    scene = Scene(np.array([2.0, 0.0, 0.0]))
    way = DeckVelocity(scene.believe, scene)
    run_for(way, scene, 20.0)
    scene.v_pad_ned = np.array([0.0, 2.0, 0.0])
    run_for(way, scene, 5.0)
    scene.sighted_s = scene.t_s
    assert run_for(way, scene, 15.0) == pytest.approx([0.0, 2.0, 0.0], abs=0.2)


async def test_velocities_go_to_the_autopilot_with_the_decks_way_on_top() -> None:
    clock = SystemClock()
    fake = MiniatureAutopilot(Stack.ARDUPILOT, mode="guided")
    fake.armed, fake.landed_state = True, 2
    fake.rpy = lambda t: (0.0, 0.0, YAW)
    options = AutopilotOptions(f"udpin://{HOST}:0", command_period_s=0.02)

    def told() -> list[Message]:
        return fake.of("SET_POSITION_TARGET_LOCAL_NED")

    async with open_autopilot(options, clock) as autopilot:
        await until(lambda: autopilot.links.all[0].local is not None)
        host, port = autopilot.links.all[0].local or ("", 0)
        async with fake.talking_to(f"udpout://{host}:{port}"):
            await until(lambda: autopilot.attitude is not None)
            autopilot.deck_velocity = lambda now: np.array([1.5, -0.5, 0.0])
            forward = Rotation.from_rpy(0.0, 0.0, YAW) @ np.array([0.3, 0.0, 0.0])

            def arrived() -> bool:
                autopilot.command(Velocity(np.array([0.3, 0.0, 0.2]), 0.0))
                return bool(told()) and told()[-1].vz > 0.1

            await until(arrived)
    last = next(m for m in reversed(told()) if m.vz > 0.1)
    assert (last.vx, last.vy, last.vz) == pytest.approx((forward[0] + 1.5, forward[1] - 0.5, 0.2), abs=1e-3)


def test_the_ship_s_report_stands_for_it_where_the_pad_was_never_seen_and_gives_way_to_sight() -> None:
    scene = Scene(np.array([1.2, -0.9, 0.0]))
    seen = False
    way = DeckVelocity(lambda now: scene.believe(now) if seen else None, scene, lambda now: np.array([3.0, 1.0]))
    assert run_for(way, scene, 1.0) == pytest.approx([3.0, 1.0, 0.0])
    seen = True
    assert run_for(way, scene, 3.0)[:2] == pytest.approx([1.2, -0.9], abs=0.06)
    seen = False
    assert run_for(way, scene, 5.0)[:2] == pytest.approx([1.2, -0.9], abs=0.06)
    assert run_for(way, scene, FORGET_S) == pytest.approx([3.0, 1.0, 0.0])


def test_the_way_of_the_deck_from_which_it_took_off_is_kept_until_the_pad_is_seen() -> None:
    scene, seen = Scene(np.array([1.2, -0.9, 0.0])), False
    scene.rested = Rested(scene.now, np.array([1.1, -0.8, 0.0]), np.zeros(3))
    way = DeckVelocity(lambda now: scene.believe(now) if seen else None, scene)
    assert run_for(way, scene, 0.9 * KEPT_WAY_S) == pytest.approx([1.1, -0.8, 0.0])
    seen = True
    assert run_for(way, scene, 3.0)[:2] == pytest.approx([1.2, -0.9], abs=0.06)


def test_half_a_second_of_a_wrong_sight_does_not_stand_for_the_ship_s_way() -> None:
    """WHY: a camera that was mirrored for a moment made her 0.45 m/s faster, and a drone that gave up left her by 44 m."""
    scene = Scene(np.array([2.1, 0.0, 0.0]))
    scene.rested = Rested(scene.now, np.array([1.5, 0.0, 0.0]), np.zeros(3))
    seen = True
    way = DeckVelocity(lambda now: scene.believe(now) if seen else None, scene)
    assert run_for(way, scene, 0.5)[0] < 1.66
    seen = False
    assert run_for(way, scene, FORGET_S + 5.0)[0] < 1.66
    seen = True
    assert run_for(way, scene, 8.0)[0] == pytest.approx(2.1, abs=0.06), "a sight that lasts counts"


@pytest.mark.parametrize(("beside_m", "found"), [(2.0, [1.25, -0.9, 0.0]), (40.0, [1.5, -0.6, 0.0])])
def test_the_way_since_the_take_off_is_the_ship_s_for_a_vehicle_back_over_her(beside_m: float, found: list[float]) -> None:
    """WHY: the deck's velocity over 3 s before it took off was that of a wave as well, and a search left the pad by 0.25 m/s."""
    scene = Scene(np.zeros(3))
    scene.rested = Rested(scene.now, np.array([1.5, -0.6, 0.0]), np.array([5.0, 6.0, 0.0]))
    way = DeckVelocity(lambda now: None, scene)
    for n in range(800):
        scene.t_s += 0.05
        scene.p_body_ned = np.array([5.0 + beside_m, 6.0, -7.0]) + 0.05 * (n + 1) * np.array([1.2, -0.9, 0.0])
        known = way(scene.now)
    assert known == pytest.approx(found, abs=0.01)
    scene.steered = True
    scene.p_body_ned = scene.p_body_ned + 10.0
    assert run_for(way, scene, 5.0) == pytest.approx(found, abs=0.01), "its own search says nothing of the ship"


S = 1_000_000_000
START = 100 * S
TRANSIT_S = 0.004


def instant(t: float) -> MonoNs:
    return MonoNs(START + round(t * S))


def rpy(t: float) -> Euler:
    """Twenty degrees of roll and some pitch, turning slowly."""
    return (math.radians(20) * math.sin(2 * math.pi * 0.7 * t), math.radians(6) * math.sin(2 * math.pi * 0.45 * t + 1), 0.2 * t)


def d_ned(t: float) -> F64:
    """Return the pad from a body at 5 m that swings as its roll makes it."""
    return np.array([0.4 + 0.2 * math.sin(1.1 * t), -0.3 + 0.18 * math.sin(2 * math.pi * 0.7 * t), 5.0])


def v_ned(t: float) -> F64:
    return (d_ned(t + 1e-4) - d_ned(t - 1e-4)) / 2e-4


def estimate_at(t: float, d: F64 | None = None) -> RelativeState:
    to_level = Rotation.from_rpy(0, 0, rpy(t)[2]).inv
    return RelativeState(
        instant(t), "dead_reckoning", to_level @ (d_ned(t) if d is None else d), to_level @ v_ned(t), 0.3, np.eye(7) * 1e-4,
        instant(t), True,
    )  # fmt: skip


def attitude_at(t: float) -> Attitude:
    return Attitude(Stamp(instant(t), instant(t), 0.0005, "synced"), Rotation.from_rpy(*rpy(t)), np.eye(3) * 1e-6)


def errors_m(lag_s: float, sends: list[tuple[float, Callable[[], object | None]]], seconds: float) -> list[float]:
    """Horizontal error of what a receiver with that lag makes of each message, against the pad at the lagged instant.

    `sends` are (when the message is taken up, what makes it).
    """
    receiver = ArduPilotReceiver(lag_s=lag_s)
    out: list[Any] = []
    queue = deque(sorted(sends, key=lambda s: s[0]))
    period = 1.0 / receiver.loop_rate_hz
    for n in itertools.count():
        t = n * period
        if t > seconds:
            return out
        receiver.loop(rpy(t))
        while queue and queue[0][0] <= t:
            message = queue.popleft()[1]()
            found = receiver.on_message(message) if message is not None else None
            if found is not None and t > 1.0:
                truth = d_ned(t - effective_lag_s(lag_s))
                out.append(math.hypot(found[0] - truth[0], found[1] - truth[1]))
    return out


@pytest.mark.parametrize("lag_s", [0.02, 0.1, 0.25])
def test_what_is_locked_to_the_lag_is_right_to_two_centimetres(lag_s: float) -> None:
    rng = np.random.default_rng(5)
    seconds = 12.0
    locked: list[tuple[float, Callable[[], object | None]]] = []
    track = TargetTrack()
    attitudes = deque(k / 100 for k in range(round(seconds * 100)))
    beliefs = deque(k / 50 for k in range(round(seconds * 50)))
    for n in range(round(seconds * 25)):
        now = n / 25 + 0.003
        while attitudes and attitudes[0] + 0.006 <= now:
            track.on_attitude(attitude_at(attitudes.popleft()))
        while beliefs and beliefs[0] <= now - 0.002:
            at = beliefs.popleft()
            # What the estimator knows is good to a centimetre
            track.believe(estimate_at(at, d_ned(at) + rng.normal(0.0, 0.003, 3)))
        seen = lag_locked(track, instant(now), lag_s, TRANSIT_S)
        if seen is not None:
            message = landing_target(0, seen.d_body_pad_ned, seen.R_ned_body, pad_radius_m=0.39)
            locked.append((now + TRANSIT_S, lambda m=message: m))  # type: ignore[misc]
    assert len(locked) > 0.95 * 25 * seconds
    errors = errors_m(lag_s, locked, seconds)
    assert len(errors) > 200
    assert max(errors) < 0.02


def filled(rate_hz: float = 50.0, seconds: float = 1.0) -> TargetTrack:
    track = TargetTrack()
    for k in range(round(seconds * 100) + 5):
        track.on_attitude(attitude_at(k / 100))
    for k in range(round(seconds * rate_hz) + 1):
        track.believe(estimate_at(k / rate_hz))
    return track


def test_between_beliefs_and_a_little_beyond() -> None:
    track = filled()
    for t in (0.333, 0.777, 1.0, 1.03):
        seen = track.at(instant(t))
        assert seen.d_body_pad_ned == pytest.approx(d_ned(t), abs=0.003)
        assert seen.R_ned_body.angle_to(Rotation.from_rpy(*rpy(t))) < 0.003
        # The arrow stands at the body's heading less the heading against it
        assert seen.R_ned_pad.rpy_rad[2] == pytest.approx(rpy(t)[2] - 0.3, abs=0.01)


def test_nothing_is_reported_where_nothing_is_known() -> None:
    track = filled()
    assert track.at(instant(1.5)) is None, "too far ahead"
    assert track.at(instant(-0.1)) is None, "before the first"
    track.believe(None)
    assert track.at(instant(0.9)) is None, "the pad was lost"
    slow = filled(rate_hz=2.0)
    assert slow.at(instant(0.75)) is None, "a gap is not bridged"
    assert TargetTrack().at(instant(0.0)) is None


def test_an_ambiguous_heading_is_not_passed_on() -> None:
    track = filled()
    state = estimate_at(1.02)
    ambiguous = RelativeState(
        state.at, "dead_reckoning", state.d_body_pad_level, state.v_pad_level, 0.3, state.cov, state.sighted, True,
        (("yaw_ambiguous", 1.0),),
    )  # fmt: skip
    track.believe(ambiguous)
    seen = track.at(instant(1.02))
    assert seen.R_ned_pad is None


def position(t: float) -> LocalPosition:
    return LocalPosition(Stamp(instant(t), instant(t), 0.001, "synced"), np.array([t, 2 * t, -t]), np.array([1.0, 2.0, -1.0]))


def test_local_position_at_an_instant() -> None:
    reports = tuple(position(k / 20) for k in range(10))
    for t in (0.0, 0.13, 0.45, 0.6):
        assert position_at(reports, instant(t)) == pytest.approx((t, 2 * t, -t), abs=1e-9)
    assert position_at(reports, instant(2.0)) is None
    assert position_at(reports, instant(-2.0)) is None
    assert position_at((), instant(0.0)) is None


@pytest.mark.hazard("H9")
def test_a_service_that_comes_back_follows_the_ship_by_the_way_that_the_one_before_measured() -> None:
    """WHY: beside an autopilot, which holds over the ground, a ship under way left the drone 287 m behind (weather_3, 908044)."""
    scene = Scene(np.array([1.2, -0.9, 0.0]))
    before = back(None).pilot.landing
    way = DeckVelocity(scene.believe, scene, before.reported_way)
    assert before.reported_way(scene.now) is None
    run_for(way, scene, 3.0)
    known = way.way(scene.now)
    assert known == pytest.approx((1.2, -0.9), abs=0.06)
    kept = msgspec.json.decode(msgspec.json.encode(FlightMemory(ns(100.0), "COMMIT", True, way_ned=known)), type=FlightMemory)
    after = back(kept).pilot.landing
    unseen = DeckVelocity(lambda now: None, scene, after.reported_way)
    scene.t_s = 102.0
    assert run_for(unseen, scene, 1.0) == pytest.approx([*known, 0.0])
    scene.t_s += KEPT_WAY_S
    assert run_for(unseen, scene, 1.0).tolist() == [0.0, 0.0, 0.0]
    untrusted = DeckVelocity(scene.believe, scene, before.reported_way, lambda: False)
    assert untrusted.way(scene.now) is None, "what a refused velocity measured is nobody's way"
