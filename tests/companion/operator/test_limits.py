"""Limits of commands: nothing crosses the fence, nothing climbs too high, and no limit makes the vehicle descend."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.orders import HandledOrder, OperatorOrder, OrderSender, OrderSource, StickPositions
from companion.guidance.controller import Knowledge
from companion.guidance.operator.command_limits import Limit, PlaceMemory, Unmeasured, limited, place_step, without_velocity
from companion.guidance.operator.fence import margin, within
from companion.guidance.pilot import make_pilot
from companion.settings.load import load
from companion.settings.operator import LimitOptions
from estimator.contracts.commands import Hover, Lean, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Range, VehicleStatus
from estimator.contracts.time import MonoNs, after
from tests.make import stamp_at

NOW = MonoNs(10**9)
L_SHAPE = ((-10.0, -10.0), (10.0, -10.0), (10.0, 0.0), (0.0, 0.0), (0.0, 10.0), (-10.0, 10.0))


def known_place(
    p: tuple[float, float] = (0.0, 0.0),
    yaw_deg: float = 0.0,
    baro_m: float = 5.0,
    range_m: float | None = None,
    charge: float = 0.9,
) -> PlaceMemory:
    return PlaceMemory(
        np.array(p),
        BodyVelocity(stamp_at(NOW), np.zeros(3), np.eye(3)),
        Attitude(stamp_at(NOW), Rotation.from_rpy(0.0, 0.0, math.radians(yaw_deg)), np.eye(3)),
        flying=True,
        baro=Baro(stamp_at(NOW), baro_m, 0.5),
        ground_baro_m=0.0,
        range=None if range_m is None else Range(stamp_at(NOW), range_m, 0.02),
        charge=charge,
    )


def pad_at(d: tuple[float, float, float], v: tuple[float, float, float] = (0.0, 0.0, 0.0), yaw_deg: float = 0.0) -> RelativeState:
    return RelativeState(NOW, "ekf", np.array(d), np.array(v), math.radians(yaw_deg), 0.01 * np.eye(7), NOW, True)


def ordered(v: tuple[float, float, float], yaw_rate: float = 0.0) -> Velocity:
    return Velocity(np.array(v), yaw_rate)


def passed(
    v: tuple[float, float, float], o: LimitOptions, where: PlaceMemory, pad: RelativeState | None = None, *, manual: bool = False
) -> tuple[F64, tuple[Limit, ...]]:
    command, hit = limited(ordered(v), o, where, pad, NOW, manual=manual)
    assert isinstance(command, Velocity)
    return command.v_level, hit


@pytest.mark.hazard("H7")
@settings(max_examples=40)
@given(
    st.sampled_from([(), L_SHAPE]),
    st.lists(st.tuples(st.floats(-8, 8), st.floats(-8, 8), st.integers(1, 60)), min_size=1, max_size=6),
)
def test_no_velocity_leads_out_of_a_fence(corners: tuple[tuple[float, float], ...], legs: list[tuple[float, float, int]]) -> None:
    p, dt = np.array([-5.0, -5.0]), 0.05
    for vx, vy, steps in legs:
        for _ in range(steps):
            v = within(np.array([vx, vy]), p, 12.0, corners, 2.0)
            assert math.hypot(*v) <= math.hypot(vx, vy) + 1e-9
            p = p + dt * v
            assert margin(p, 12.0, corners)[0] >= -1e-3


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(-5, 5), st.floats(-5, 5), st.sampled_from([(), L_SHAPE]))
def test_outside_a_fence_nothing_leads_farther_and_the_way_back_is_free(x, y, vx, vy, corners):
    p = np.array([x, y])
    inside_m, n = margin(p, 12.0, corners)
    kept = within(np.array([vx, vy]), p, 12.0, corners, 2.0)
    if inside_m < -1e-3:
        assert float(kept @ n) <= 1e-9
        back = -2.0 * n
        assert within(back, p, 12.0, corners, 2.0) == pytest.approx(back)


@pytest.mark.hazard("H7")
@given(
    st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3)),
    st.tuples(st.floats(-80, 80), st.floats(-80, 80)),
    st.floats(-180, 180),
    st.floats(-5, 90),
    st.one_of(st.none(), st.floats(0, 6)),
    st.floats(0, 1),
    st.sampled_from(["off", "start", "ship"]),
    st.booleans(),
    st.booleans(),
    st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.just(0.0)),
)
def test_no_limit_ever_makes_it_descend_or_fly_faster(v, p, yaw_deg, baro_m, range_m, charge, fence, manual, leans, sails):
    options = LimitOptions(fence=fence, fence_radius_m=30.0)  # type: ignore[arg-type]
    belief = pad_at((p[0], p[1], 4.0), sails, yaw_deg)
    asked: Velocity | Lean = ordered(v)
    if leans:
        asked = Lean(np.array([0.5, -0.5]), np.zeros(2), np.array(v), 0.1)
    where = known_place(p, yaw_deg, baro_m=baro_m, range_m=range_m, charge=charge)
    command, hit = limited(asked, options, where, belief, NOW, manual=manual)
    assert isinstance(command, Velocity | Lean)
    down, before = float(command.v_level[2]), v[2]
    assert (before <= down <= 0.0) if before <= 0.0 else (0.0 <= down <= before)
    assert math.hypot(*command.v_level[:2]) <= math.hypot(*v[:2]) + 1e-9
    assert command.yaw_rate_rad_s == asked.yaw_rate_rad_s
    assert (command is asked) == (not hit)


def test_the_fence_around_the_start_is_in_north_and_east_and_the_command_in_forward_and_right() -> None:
    options = LimitOptions(fence="start", fence_radius_m=10.0)
    east_edge = known_place((0.0, 10.0), yaw_deg=90.0)
    v, hit = passed((1.0, 0.5, 0.0), options, east_edge)
    assert hit == (Limit.FENCE,)
    assert v == pytest.approx([0.0, 0.5, 0.0], abs=0.01)
    assert not passed((-1.0, 0.0, 0.0), options, east_edge)[1]


def test_the_fence_around_a_ship_sails_with_it() -> None:
    """The fence moves at 2 m/s: flying with it is free, outrunning it is not, and it drags nobody along."""
    options = LimitOptions(fence="ship", fence_radius_m=10.0)
    ahead, behind = pad_at((-10.0, 0.0, 3.0), (2.0, 0.0, 0.0)), pad_at((10.0, 0.0, 3.0), (2.0, 0.0, 0.0))
    assert not passed((2.0, 0.0, 0.0), options, known_place(), ahead)[1]
    v, hit = passed((3.0, 0.5, 0.0), options, known_place(), ahead)
    assert hit == (Limit.FENCE,)
    assert v[:2] == pytest.approx([2.0, 0.5], abs=0.01)
    assert passed((0.0, 0.5, 0.0), options, known_place(), behind)[0][:2] == pytest.approx([0.0, 0.5], abs=0.01)
    assert passed((-1.0, 0.0, 0.0), options, known_place(), behind)[0][:2] == pytest.approx([0.0, 0.0])
    unknown = RelativeState(NOW, "ekf", np.array([10.0, 0.0, 3.0]), np.zeros(3), 0.0, 100.0 * np.eye(7), NOW, True)
    assert passed((-1.0, 0.0, 0.0), options, known_place(), unknown)[1] == ()


@pytest.mark.hazard("H7", "H10")
def test_heights_and_battery() -> None:
    options = LimitOptions(height_max_m=20.0, manual_height_min_m=0.5)
    up = (0.0, 0.0, -2.0)
    v, hit = passed(up, options, known_place(baro_m=19.5))
    assert (v[2], hit) == (pytest.approx(-0.5), (Limit.HEIGHT_MAX,))
    for near in (known_place(baro_m=400.0, range_m=0.3), known_place(baro_m=400.0)):
        hit = passed(up, options, near, pad_at((0.0, 0.0, 0.4)))[1]
        assert not hit, "a barometer that lies keeps no drone low over a deck"
    for manual, hits in ((True, (Limit.HEIGHT_MAX,)), (False, ())):
        hit = passed(up, options, known_place(baro_m=30.0, range_m=0.3), manual=manual)[1]
        assert hit == hits, "a range sensor that lies lifts no limit from a hand"
    for manual, down_m_s in ((True, 0.1), (False, 0.5)):
        v, _ = passed((0.0, 0.0, 0.5), options, known_place(range_m=0.6), manual=manual)
        assert v[2] == pytest.approx(down_m_s), "guidance lands, a hand does not touch the deck by its sticks"
    low = known_place((5.0, 0.0), charge=0.1)
    for manual, forward_m_s in ((True, 0.0), (False, 1.0)):
        assert passed((1.0, 0.0, 0.0), options, low, manual=manual)[0][0] == pytest.approx(forward_m_s)
    assert not passed((1.0, 0.0, 0.0), options, low, pad_at((3.0, 0.0, 2.0)), manual=True)[1]


def test_a_barometer_that_has_died_bars_no_climb() -> None:
    """WHY: nothing could take back the height that it reported last."""
    options, climb = LimitOptions(height_max_m=20.0), ordered((0.0, 0.0, -2.0))
    for later_s, hits in ((2.0, (Limit.HEIGHT_MAX,)), (3.0, ())):
        assert limited(climb, options, known_place(baro_m=30.0), None, after(NOW, later_s), manual=False)[1] == hits


def test_a_polygon_is_checked() -> None:
    assert LimitOptions(fence_polygon="0 0, 10 0, 10 10.5").corners() == ((0.0, 0.0), (10.0, 0.0), (10.0, 10.5))
    wrongs = {"0 0, 1 1": "three corners", "0 0, 1, 2 2": "'1' is not a corner", "0 0, 1 nan, 2 2": "too far away"}
    for wrong, why in wrongs.items():
        with pytest.raises(ValueError, match=why):
            LimitOptions(fence_polygon=wrong)


def test_the_place_is_the_integral_of_the_velocity_since_the_start() -> None:
    memory = PlaceMemory()
    now = NOW
    for n in range(201):
        now = after(now, 0.02)
        memory = place_step(memory, [Attitude(stamp_at(now), Rotation.from_rpy(0.0, 0.0, math.radians(90.0)), np.eye(3))])
        memory = place_step(memory, [Baro(stamp_at(now), 100.0 if n < 100 else 103.0, 0.5)])
        memory = place_step(memory, [VehicleStatus(stamp_at(now), n >= 100, "", 0.5, False, True)])
        memory = place_step(memory, [BodyVelocity(stamp_at(now), np.array([1.0, 0.0, 0.0]), np.eye(3))])
    assert memory.p_start_ned == pytest.approx([0.0, 2.02])
    assert memory.ground_baro_m == 100.0
    assert limited(ordered((0.0, 0.0, -9.0)), LimitOptions(height_max_m=4.0), memory, None, now, manual=False)[1] == (
        Limit.HEIGHT_MAX,
    )


def test_the_service_flies_by_hand_to_the_fence_and_no_farther_and_refuses_a_take_off_on_an_empty_battery() -> None:
    shipped = load("sim")
    limits = LimitOptions(fence="start", fence_radius_m=5.0)
    pilot = make_pilot(msgspec.structs.replace(shipped, limits=limits))
    sender, now, v, p = OrderSender(OrderSource.GAMEPAD), NOW, np.zeros(3), np.zeros(3)
    pilot.on_sample(VehicleStatus(stamp_at(now), False, "landed", 0.1, False, True))
    refusal = pilot.operator.take(OperatorOrder.TAKE_OFF, sender, now).refusal
    assert refusal == "the battery is at 10 %, and a take-off needs 20 %"
    reasons = set()
    for n in range(1500):
        now = after(now, 0.02)
        p = p + 0.02 * v
        pilot.on_sample(Attitude(stamp_at(now), Rotation.from_rpy(0.0, 0.0, 0.0), 1e-5 * np.eye(3)))
        noise = 1e-3 * np.array([(-1) ** n, 0.0, 0.0])
        pilot.on_sample(BodyVelocity(stamp_at(now), v + noise, 0.01 * np.eye(3)))
        pilot.on_sample(VehicleStatus(stamp_at(now), True, "flying", 0.9, False, True))
        if n == 10:
            assert pilot.operator.take(OperatorOrder.MANUAL, sender, now).accepted
        pilot.operator.move(sender, StickPositions(forward=1.0), now)
        decision = pilot.decide(now)
        reasons.add(decision.limit)
        v = decision.command.v_level if isinstance(decision.command, Velocity) else np.zeros(3)
    # By the velocity alone the place becomes less sure, and the fence nearer.
    assert 4.0 < p[0] <= 5.05
    assert reasons == {"", "limited by the geofence"}
    assert pilot.operator.hand == sender, "the hand stays with the person"


@given(*[st.floats(-3.0, 3.0)] * 3, st.floats(-4.0, 4.0), st.booleans(), st.booleans())
def test_without_a_trusted_velocity_guidance_flies_nowhere_along_an_unseen_deck_and_never_lower(
    vx, vy, vz, trim, over_ground, guided
):
    command, trims = ordered((vx, vy, vz)), np.array([trim, 0.0])
    blind = without_velocity(command, Unmeasured(trims, 0.35, None, over_ground), guided=guided)
    kind = Velocity if over_ground else Lean
    if guided and vz >= 0.0:
        assert blind == Hover()
    else:
        assert isinstance(blind, kind)
        assert blind.v_level == pytest.approx([0.0, 0.0, vz] if guided else command.v_level)
        assert not isinstance(blind, Lean) or blind.a_level == pytest.approx(0.35 * blind.v_level[:2])
    seen = without_velocity(command, Unmeasured(trims, 0.35, command.v_level - (1.0, 0.0, 0.0), over_ground), guided=guided)
    assert isinstance(seen, kind)
    assert seen.v_level == pytest.approx(command.v_level)
    assert not isinstance(seen, Lean) or seen.a_level[0] > 0.35 * vx, "it is slower than it is to be"


def test_a_climb_that_is_flown_by_tilt_counts_as_the_one_that_was_ordered() -> None:
    """WHY: a go-around by a frozen velocity counted no climb, and went on to 9 m."""
    guidance, command = make_pilot(load("sim")).landing, ordered((0.0, 0.0, -0.5))
    guidance._ordered, guidance.mission = command, msgspec.structs.replace(guidance.mission, climbs_m_s=0.5)
    guidance.on_command(NOW, guidance.without_velocity(command, Knowledge(NOW, None), guided=True))
    assert guidance.mission.climbs_m_s == 0.5
    guidance.on_command(NOW, Hover())
    assert guidance.mission.climbs_m_s == 0.0


def test_a_hand_flies_on_by_tilt_while_the_velocity_repeats_itself() -> None:
    pilot, now, kinds = make_pilot(load("sim")), NOW, list[type]()
    sender = OrderSender(OrderSource.GAMEPAD)
    for n in range(150):
        now = after(now, 0.02)
        v = np.array([0.5 if 50 <= n < 100 else 0.5 + 1e-3 * n, 0.0, 0.0])
        pilot.on_sample(Attitude(stamp_at(now), Rotation.from_rpy(1e-4 * n, 0.0, 0.0), 1e-5 * np.eye(3)))
        pilot.on_sample(BodyVelocity(stamp_at(now), v, 0.01 * np.eye(3)))
        pilot.on_sample(VehicleStatus(stamp_at(now), True, "flying", 0.9, False, True))
        if n == 0:
            assert pilot.operator.take(OperatorOrder.MANUAL, sender, now).accepted
        pilot.operator.move(sender, StickPositions(forward=1.0), now)
        decision = pilot.decide(now)
        kinds.append(type(decision.command))
        assert n != 95 or "the velocity repeats its readings" in (decision.reason + "".join(pilot.estimator.guard.lost))
    assert set(kinds[:50]) == {Velocity}
    assert kinds[95:99] == [Lean] * 4
    assert kinds[-1] is Velocity


def test_a_fence_that_holds_guidance_back_ends_the_landing_and_reports_it() -> None:
    """The pad lies outside: guidance flies at the fence for `fence_ends_s`, then the drone holds; a person may begin again."""
    pilot = make_pilot(msgspec.structs.replace(load("sim"), limits=LimitOptions(fence="start", fence_radius_m=5.0)))
    orders: list[HandledOrder] = []
    pilot.operator.on_order = orders.append
    pilot.on_sample(Attitude(stamp_at(NOW), Rotation.from_rpy(0.0, 0.0, 0.0), 1e-5 * np.eye(3)))
    pilot.on_sample(VehicleStatus(stamp_at(NOW), True, "flying", 0.9, False, True))
    pilot.operator._place = known_place((4.9, 0.0))
    now, output = NOW, list[str]()
    for _ in range(250):
        now = after(now, 0.02)
        pilot.operator.tick(now)
        chosen = pilot.operator.choose(now, Hover() if pilot.paused else ordered((1.0, 0.0, 0.0)))
        output += [chosen.limit] if not output or output[-1] != chosen.limit else []
    assert output == ["limited by the geofence", "landing ended: the geofence held guidance back for 3 s"]
    assert chosen.command == Hover()
    assert [(o.sender.source, o.order) for o in orders] == [(OrderSource.LIMITS, OperatorOrder.HOLD)]
    pilot.on_sample(VehicleStatus(stamp_at(now), True, "flying", 0.9, False, True))
    assert pilot.operator.take(OperatorOrder.BEGIN, OrderSender(OrderSource.MQTT), now).accepted
    assert isinstance(pilot.operator.choose(after(now, 0.02), ordered((-1.0, 0.0, 0.0))).command, Velocity)
