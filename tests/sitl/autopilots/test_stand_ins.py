"""The physics behind an autopilot program, and the stand-ins, which show on a deck what the programs were measured to do."""

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from companion.guidance.law.flown_course import course_of, reported_lean, track
from companion.guidance.law.response_fit import fit_tilt
from companion.settings.load import shipped, shipped_response
from decklander.place import SHIPPED
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.setpoint import level_setpoint, velocity_setpoint
from drivers.mavlink.vehicle import Stack, set_mode
from estimator.contracts.commands import Lean, Velocity
from estimator.contracts.errors import SetupImpossible
from estimator.contracts.geometry import F64, GeoPoint, ned_between
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import MonoNs
from sitl.emulators.autopilots.body import Body, BodyState
from sitl.emulators.autopilots.programs.arducopter import CURVE, JsonBackend, decode
from sitl.emulators.autopilots.programs.px4 import HilBackend, SensorNoise, gnss, motors_of, sensors, serve_hil
from sitl.emulators.autopilots.stand_in.arducopter import CopterStandIn
from sitl.emulators.autopilots.stand_in.base import STEP_S
from sitl.emulators.autopilots.stand_in.cascade import COPTER_GAINS, PX4_GAINS
from sitl.emulators.autopilots.stand_in.px4 import Px4StandIn
from sitl.emulators.autopilots.stand_in.tuning import STABILITY_MARGIN, open_loops, tuned
from sitl.scenario.scenario import Scenario, load, vehicle_model
from sitl.sensors.sensors import ORIGIN
from sitl.vehicle.airframe import VehicleSettings, ardrone2
from sitl.vehicle.airframe import load as load_vehicle
from sitl.world.drives import Motors, wrench

ARM = (mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
DISARM = (mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
FORCED = 21196.0
QUICK = {"EKF2_REQ_GPS_H": 0.5}
SHIP = {**QUICK, "EKF2_GPS_CHECK": 21.0}


class Deck:
    """A stand-in on the pad of a ship, without sockets."""

    def __init__(
        self, name: str, stack: Stack, parameters: dict[str, float] | None = None, speed_m_s: float | None = None,
        wind_m_s: float | None = None, from_deg: float = 30.0, vehicle: VehicleSettings | None = None,
    ) -> None:  # fmt: skip
        scenario = load(name)
        if vehicle is not None:
            scenario = replace(scenario, vehicle=vehicle)
        if wind_m_s is not None:
            scenario = replace(scenario, weather=replace(scenario.weather, wind_m_s=wind_m_s, from_deg=from_deg))
        vessel = scenario.vessel if speed_m_s is None else replace(scenario.vessel, speed_m_s=speed_m_s, moored=False)
        start, wrong = replace(scenario.start, where="pad"), scenario.wrong_model.drawn(3)
        scenario = replace(scenario, start=start, vessel=vessel, wrong_model=wrong)
        self.body = Body(scenario, 3, STEP_S, CURVE if stack is Stack.ARDUPILOT else 0.0)
        frame = None if vehicle is None else vehicle_model(scenario).airframe()
        self.pilot: CopterStandIn | Px4StandIn = (
            CopterStandIn(self, parameters, STEP_S, frame) if stack is Stack.ARDUPILOT else Px4StandIn(self, parameters, frame)
        )
        self.said: list[Message] = []
        self.pilot.send = self.said.append  # type: ignore[method-assign, assignment]
        self.pilot.step(self.body.state())

    def now(self) -> MonoNs:
        return MonoNs(10**12 + round(1e9 * self.body.t_s) if hasattr(self, "body") else 10**12)

    async def sleep(self, seconds: float) -> None:
        raise AssertionError("nothing sleeps here")

    def tell(self, message: Message) -> None:
        """Send a message as a companion would."""
        received: Any = SimpleNamespace(message=message, system=1, component=191, link=0)
        getattr(self.pilot, f"_on_{message.get_type().lower()}")(message, received)

    def order(self, command: int, *params: float) -> int:
        """Return the result of a command."""
        self.tell(mav.MAVLink_command_long_message(1, 1, command, 0, *[*params, *[0.0] * (7 - len(params))]))
        return next(int(m.result) for m in reversed(self.said) if m.get_type() == "COMMAND_ACK")

    def mode(self, name: str) -> None:
        self.tell(set_mode(self.pilot.stack, (1, 1), name))

    def fly(self, seconds: float, down_m_s: float | None = None) -> None:
        """Go on for a while, by setpoints with the deck's velocity at 25 Hz where a vertical speed is given."""
        for k in range(round(seconds / STEP_S)):
            if down_m_s is not None and k % 10 == 0:
                way = np.array([*self.body.v_pad_ned[:2], down_m_s])
                self.tell(velocity_setpoint(0, (1, 1), Velocity(way, 0.0), 0.0))
            self.body.step(self.pilot.step(self.body.state()))

    def armed(self, mode: str, down_m_s: float | None = 0.0) -> None:
        self.fly(2.0, down_m_s)
        self.mode(mode)
        assert self.order(*ARM) == 0

    def up(self, height_m: float = 2.0) -> None:
        """Off the deck in the velocity mode, over it and still."""
        if self.pilot.stack is Stack.PX4:
            self.armed("offboard")
        else:
            self.armed("guided")
            assert self.order(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 3.0) == 0
            self.fly(1.0)
        while self.height_m < height_m:
            self.fly(0.2, -1.0)
        self.fly(1.0, 0.0)
        assert self.body.upright

    @property
    def height_m(self) -> float:
        return float(self.body.pad_motion().p_ned[2] - self.body.state().p_ned[2])

    @property
    def aside_m(self) -> float:
        return math.hypot(*(self.body.state().p_ned - self.body.pad_motion().p_ned)[:2])

    @property
    def texts(self) -> list[Message]:
        return [m for m in self.said if m.get_type() == "STATUSTEXT"]


def test_px4_takes_a_take_off_to_latitude_0_for_a_place_and_only_nan_for_here() -> None:
    away, here = Deck("calm", Stack.PX4, QUICK), Deck("calm", Stack.PX4, QUICK)
    for deck, place, height in ((away, 0.0, 20.0), (here, math.nan, math.nan)):
        deck.armed("auto.loiter", None)
        deck.order(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, place, place, height)
        deck.fly(6.0)
    assert away.aside_m > 3.0 or not away.body.upright
    assert here.aside_m < 0.3
    assert here.height_m > 1.0


def test_px4_by_its_own_take_off_mode_leaves_a_ship_under_way_and_with_her_velocity_does_not() -> None:
    """AUTO.TAKEOFF holds a place over the ground while the rotors spool up."""
    own, ours = Deck("moderate", Stack.PX4, SHIP), Deck("moderate", Stack.PX4, SHIP)
    own.armed("auto.takeoff")
    own.fly(7.0)
    assert not own.body.upright or own.aside_m > 3.0
    ours.armed("offboard")
    ours.fly(6.0, -1.0)
    assert ours.body.upright
    assert ours.height_m > 1.0
    assert ours.aside_m < 2.5, "what the wind makes of a velocity"


@pytest.mark.parametrize(("speed_m_s", "check", "arms"), [(1.5, 245.0, False), (1.5, 21.0, True), (0.0, 245.0, True)])
def test_px4_arms_on_a_ship_under_way_only_without_the_checks_of_drift(speed_m_s: float, check: float, arms: bool) -> None:
    deck = Deck("calm", Stack.PX4, {**QUICK, "EKF2_GPS_CHECK": check}, speed_m_s)
    deck.fly(12.0 if not arms else 3.0)
    assert (deck.order(*ARM) == 0) is arms
    assert deck.pilot.armed is arms


def test_px4_fails_safe_when_the_setpoints_of_an_armed_vehicle_end() -> None:
    deck = Deck("calm", Stack.PX4, QUICK)
    deck.up()
    deck.fly(0.9)
    assert deck.pilot.failsafes == []
    deck.fly(0.3)
    assert len(deck.pilot.failsafes) == 1
    assert deck.pilot.mode == "auto.loiter"
    quiet = Deck("calm", Stack.PX4, QUICK)
    quiet.armed("offboard")
    assert quiet.order(*DISARM) == 0
    quiet.fly(2.0)
    assert quiet.pilot.failsafes == []


@pytest.mark.parametrize("stack", [Stack.ARDUPILOT, Stack.PX4])
def test_the_reported_velocity_is_the_bodys_and_not_the_setpoint(stack: Stack) -> None:
    deck = Deck("calm", stack, QUICK)
    deck.up()
    deck.tell(velocity_setpoint(0, (1, 1), Velocity(np.array([2.0, 0.0, 0.4]), 0.0), 0.0))
    assert deck.pilot.v_ned == pytest.approx(deck.body.state().v_ned, abs=0.05)


@pytest.mark.parametrize("stack", [Stack.PX4, Stack.ARDUPILOT])
def test_motors_stop_in_the_air_only_by_force(stack: Stack) -> None:
    deck = Deck("calm", stack, QUICK)
    deck.up(1.0)
    assert deck.order(*DISARM) == mav.MAV_RESULT_DENIED
    assert deck.pilot.armed
    assert deck.order(*DISARM, FORCED) == 0
    assert not deck.pilot.armed


def test_arducopter_leans_against_the_wind_as_far_as_its_parameter_allows() -> None:
    """WHY: with 30 degrees at most, 3 m/s^2 of them against the wind, it was blown off a ship where ArduCopter keeps up."""
    drifts_m_s = {}
    for most_deg in (30, 45):
        deck = Deck("weather_4", Stack.ARDUPILOT, {"ANGLE_MAX": 100.0 * most_deg}, wind_m_s=15.0)
        deck.up(4.0)
        deck.fly(6.0, 0.0)
        at_m = deck.aside_m
        deck.fly(3.0, 0.0)
        drifts_m_s[most_deg] = (deck.aside_m - at_m) / 3.0
        assert math.degrees(math.acos(float(deck.body.state().R_ned_body.matrix[2, 2]))) < most_deg + 2.0
    assert abs(drifts_m_s[45]) < 0.3 < 1.0 < drifts_m_s[30]


def test_arducopter_leaves_the_ground_by_its_take_off_only_and_brakes_when_setpoints_end() -> None:
    deck = Deck("calm", Stack.ARDUPILOT, {"GUID_TIMEOUT": 3.0})
    deck.armed("guided")
    deck.fly(2.0, -1.0)
    assert deck.height_m < 0.1, "no velocity lifts it off"
    deck.up()
    deck.tell(velocity_setpoint(0, (1, 1), Velocity(np.array([1.0, 0.0, 0.0]), 0.0), 0.0))
    deck.fly(2.8)
    assert deck.body.state().v_ned[0] > 0.7
    deck.fly(2.0)
    assert deck.body.state().v_ned[0] < 0.3


@pytest.mark.parametrize(("timeout", "least_m", "most_m"), [({}, 0.9, 1.6), ({"GUID_TIMEOUT": 3.0}, 2.5, 3.5)])
def test_a_service_that_dies_in_a_descent_costs_the_height_of_guid_timeout(timeout, least_m, most_m):
    deck = Deck("calm", Stack.ARDUPILOT, timeout)
    deck.up(6.0)
    deck.fly(1.2, 0.9)
    from_m = deck.height_m
    deck.fly(5.0)
    assert least_m < from_m - deck.height_m < most_m
    assert abs(float(deck.body.state().v_ned[2])) < 0.1, "it holds"


@pytest.mark.parametrize(("stack", "response", "link_s"), [(Stack.ARDUPILOT, "autopilot", 0.04), (Stack.PX4, "px4", 0.04)])
def test_a_climb_follows_a_velocity_as_late_as_the_shipped_response_says(stack: Stack, response: str, link_s: float) -> None:
    """ArduCopter 4.5.7 in its logs: 0.24 to 0.32 s of delay and 0.15 to 0.25 s of lag, and it overshoots a little."""
    deck = Deck("calm", stack, QUICK if stack is Stack.PX4 else None)
    deck.up(4.0)
    deck.fly(3.0, 0.0)
    speeds = []
    for _ in range(35):
        deck.fly(0.04, 0.5)
        speeds.append(float(deck.body.state().v_ned[2]))
    climb = shipped_response(response).climb
    two_thirds_s = 0.04 * (1 + int(np.argmax(np.array(speeds) > 0.5 * (1.0 - math.exp(-1.0)))))
    assert two_thirds_s + link_s == pytest.approx(climb.delay_s + climb.lag_s, abs=0.16)
    assert 0.45 < speeds[-1] < 0.56


GAINS = {Stack.PX4: PX4_GAINS, Stack.ARDUPILOT: COPTER_GAINS}


def test_every_vehicle_is_tuned_to_its_motors_and_one_whose_defaults_have_margin_keeps_them() -> None:
    """WHY: hexa_7kg by PX4's defaults swung until it turned over (weather_3, seed 7008)."""
    for name in shipped("vehicles"):
        frame = load_vehicle(SHIPPED / "vehicles" / f"{name}.toml").airframe()
        for stack, given in GAINS.items():
            found = tuned(given, frame, STEP_S)
            assert min(open_loops(found, frame, STEP_S).margins()) >= STABILITY_MARGIN, (name, stack)
            assert (found == given) is (name != "hexa_7kg")


def swing_deg(stack: Stack, *, by_defaults: bool) -> float:
    """Return how far a hexacopter's pitch swings three seconds after a step of velocity, by motors slower than its file says."""
    slow = VehicleSettings("hexa_7kg", motor_lag_s=1.7 * 0.09)
    deck = Deck("calm", stack, QUICK if stack is Stack.PX4 else None, speed_m_s=0.0, wind_m_s=0.0, vehicle=slow)
    if by_defaults:
        deck.pilot._cascade.gains = GAINS[stack]
    deck.up(4.0)
    pitches = []
    for _ in range(100):
        deck.tell(velocity_setpoint(0, (1, 1), Velocity(np.array([2.0, 0.0, 0.0]), 0.0), 0.0))
        deck.fly(0.04)
        pitches.append(math.degrees(deck.body.state().R_ned_body.rpy_rad[1]))
    return float(np.ptp(pitches[75:]))


@pytest.mark.parametrize("stack", GAINS)
def test_a_heavy_vehicle_as_it_was_tuned_settles_by_slower_motors_too_and_by_a_stacks_defaults_swings_on(stack: Stack) -> None:
    tuned_deg, default_deg = (swing_deg(stack, by_defaults=by_defaults) for by_defaults in (False, True))
    assert 4.0 * tuned_deg < default_deg


def test_a_tilt_of_px4_follows_an_acceleration_as_its_response_file_says() -> None:
    """WHY: it answered at 11.4 rad/s, and each flight was told that the vehicle is slower (docs/decisions/stand-ins.md)."""
    deck = Deck("calm", Stack.PX4, QUICK)
    deck.up(1.5)
    rng, a, asked, flown = np.random.default_rng(1), np.zeros(2), [], []
    for k in range(7 * 25):
        a = 0.85 * a + 0.35 * rng.standard_normal(2)
        command = Lean(a, np.zeros(2), deck.body.state().v_ned * (1.0, 1.0, 0.0), 0.0)
        deck.tell(velocity_setpoint(0, (1, 1), command, 0.0))
        asked.append((0.04 * k, *a))
        for n in range(10):
            flown.append((0.04 * k + STEP_S * n, *reported_lean(deck.body.state().R_ned_body)))
            deck.fly(STEP_S)
    course, given = course_of(track(asked), track(flown)), shipped_response("px4").tilt
    fit = fit_tilt(course, given)
    assert fit.response.frequency_rad_s == pytest.approx(given.frequency_rad_s, rel=0.12)
    assert fit.response.damping == pytest.approx(given.damping, rel=0.2)


def on_deck() -> Deck:
    """Return an ArduCopter that flew and stands again, its motors turning."""
    deck = Deck("calm", Stack.ARDUPILOT)
    deck.up(0.6)
    while deck.height_m > 0.06:
        deck.fly(0.1, 0.4)
    return deck


def turned_deg(from_deg: float, *, level: bool) -> float:
    """Return how far an ArduCopter turns that comes down in wind, from its first touch until it stands; 0.25 s of it with motors.

    Args:
        level: it is sent the level attitude; otherwise the velocity with an acceleration that takes its lean away.
    """
    deck = Deck("weather_4", Stack.ARDUPILOT, {"PSC_JERK_XY": 20.0}, wind_m_s=11.0, from_deg=from_deg)
    deck.up(1.0)
    before = deck.body.landing
    while (landing := deck.body.landing) == before:
        deck.fly(0.04, 0.35 + deck.body.v_pad_ned[2])
        assert deck.body.t_s < 30.0
    assert landing is not None
    yaw_rad, calm = deck.body.state().R_ned_body.rpy_rad[2], np.zeros(2)
    leans = -deck.body.state().R_ned_body.matrix[:2, 2] * G_M_S2
    for k in range(10):
        turn = 6.0 * (yaw_rad - deck.body.state().R_ned_body.rpy_rad[2])
        if level:
            rpy_rad = deck.body.state().R_ned_body.rpy_rad
            deck.tell(level_setpoint(0, (1, 1), rpy_rad, yaw_rad - rpy_rad[2], turn))
        else:
            lean = Lean(-0.1 * (k + 1) * leans, calm, np.array([*deck.body.v_pad_ned[:2], 1.0]), turn)
            deck.tell(velocity_setpoint(0, (1, 1), lean, 0.0))
        deck.fly(0.025)
    deck.order(*DISARM, FORCED)
    deck.fly(0.5)
    return math.degrees(deck.body.state().R_ned_body.rpy_rad[2] - yaw_rad)


@pytest.mark.parametrize("from_deg", [20.0, 65.0])
def test_arducopter_on_one_foot_turns_less_level_by_an_attitude_than_by_a_velocity(from_deg: float) -> None:
    """WHY: its lean against 11 m/s of wind touched with one foot, about which it turned by 13.7 degrees on its way to level."""
    by_attitude_deg, by_velocity_deg = (abs(turned_deg(from_deg, level=level)) for level in (True, False))
    assert by_attitude_deg < 5.0 < by_velocity_deg


@pytest.mark.parametrize(("mode", "ends_armed"), [("loiter", True), ("land", False)])
def test_arducopter_stays_armed_on_a_deck_in_loiter_and_disarms_in_land(mode: str, ends_armed: bool) -> None:
    deck = on_deck()
    deck.mode(mode)
    deck.fly(6.0)
    assert deck.pilot.armed is ends_armed


@pytest.mark.parametrize(("down_m_s", "notices"), [(None, False), (0.4, True)])
def test_arducopter_notices_that_it_stands_while_it_wants_to_descend_and_else_leaves_by_a_velocity(down_m_s, notices):
    deck = on_deck()
    deck.fly(6.0, down_m_s)
    assert deck.pilot.armed
    accepted = deck.order(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 3.0) == mav.MAV_RESULT_ACCEPTED
    assert accepted is notices
    if not notices:
        deck.fly(2.5, -1.0)
        assert deck.height_m > 1.0


def test_arducopter_follows_a_target_with_the_ship_only_if_its_setting_says_that_it_moves() -> None:
    aside = {}
    for options in (0.0, 1.0):
        deck = Deck("calm", Stack.ARDUPILOT, {"PLND_OPTIONS": options}, 1.5)
        deck.up(3.5)
        deck.mode("land")
        for _ in range(110):
            s = deck.body.state()
            x, y, z = (float(c) for c in s.R_ned_body.inv @ (deck.body.pad_motion().p_ned - s.p_ned))
            target = mav.MAVLink_landing_target_message(
                0, 0, 12, 0, 0, math.sqrt(x * x + y * y + z * z), 0, 0, x, y, z, [1, 0, 0, 0], 3, 1
            )
            deck.tell(target)
            deck.fly(0.05)
        aside[options] = deck.aside_m
    assert aside[0.0] > 0.8
    assert aside[1.0] < 0.4


lua54 = pytest.importorskip("lupa.lua54", reason="lupa is not installed (requirements/dev.txt)")
SCRIPT = Path(__file__).parents[3] / "configs/autopilot/decklander_disarm.lua"
PERIOD_S = 0.02
_NUMBERS = {"guided": 4, "land": 9, "brake": 17, "loiter": 5, "stabilize": 0}
_HOVER = ardrone2().mass_kg * G_M_S2 / ardrone2().thrust_max_n


def heartbeat(component: int) -> bytes:
    """Return a received HEARTBEAT as ArduPilot hands it to a script: its own structure, little-endian and packed."""
    return struct.pack("<HBBBBBBB3sBB", 0x1234, 0xFD, 9, 0, 0, 7, 1, component, b"\0\0\0", 0, 0)


class Scripting:
    """Stand-in for ArduPilot's scripting interface, with documented functions alone."""

    def __init__(self, pilot: CopterStandIn, **parameters: float) -> None:
        self.pilot = pilot
        self.parameters = {"MOT_THST_HOVER": _HOVER, **parameters}
        self.tables: dict[int, str] = {}
        self.texts: list[str] = []
        self.received: list[bytes] = []
        self.f_body: F64 = np.array([0.0, 0.0, -G_M_S2])
        self.now_s = 0.0
        runtime = lua54.LuaRuntime(encoding=None)  # messages are bytes
        self._update: Any = None
        give: Callable[..., Any] = runtime.execute(Path(__file__).with_name("copter_scripting.lua").read_bytes())
        give(
            lambda: 1000.0 * self.now_s, lambda: pilot.armed, self._disarm, lambda: _NUMBERS[pilot.mode],
            lambda: float(self.f_body[2]), lambda: pilot._cascade.thrust_fraction,
            lambda name: self.parameters.get(name.decode()),
            lambda key, prefix: self.tables.setdefault(key, prefix.decode()) == prefix.decode(), self._add,
            lambda: self.received.pop(0) if self.received else None, lambda text: self.texts.append(text.decode()),
        )  # fmt: skip
        self._update, period_ms = runtime.execute(SCRIPT.read_bytes())
        assert period_ms == 1000.0 * PERIOD_S

    def run(self, s: BodyState) -> None:
        """Run the script once."""
        self.now_s, self.f_body = s.t_s, s.f_body
        self._update()

    def _add(self, key: int, name: bytes, value: float) -> bool:
        self.parameters.setdefault(self.tables[key] + name.decode(), value)
        return True

    def _disarm(self) -> bool:
        self.pilot._disarm()
        return True


def aboard(deck: Deck, **parameters: float) -> Scripting:
    """Put the script aboard; a companion's message arrives each second until `deck.silent` is set."""
    pilot = deck.pilot
    assert isinstance(pilot, CopterStandIn)
    script, fly, steps, per = Scripting(pilot, **parameters), pilot.fly, [0], round(PERIOD_S / STEP_S)

    def flown(s: BodyState) -> Motors:
        steps[0] += 1
        if steps[0] % per == 0:
            if steps[0] * STEP_S % 1.0 < PERIOD_S:
                script.received += [heartbeat(1), heartbeat(154)]
                if not getattr(deck, "silent", False):
                    script.received.append(heartbeat(191))
            script.run(s)
        return fly(s)

    pilot.fly = flown  # type: ignore[method-assign]
    return script


def copter_on_deck(name: str, silent_at_m: float, seconds: float, **parameters: float) -> tuple[Deck, Scripting]:
    """Follow the deck down; the companion dies at a height, and its last velocity goes on for GUID_TIMEOUT."""
    deck = Deck(name, Stack.ARDUPILOT, {"GUID_TIMEOUT": 1.0})
    script = aboard(deck, **parameters)
    deck.up(1.0)
    while deck.height_m > silent_at_m:
        deck.fly(0.1, float(deck.body.v_pad_ned[2]) + 0.4)
    deck.silent = True  # type: ignore[attr-defined]
    deck.fly(seconds)
    return deck, script


def test_a_copter_that_was_left_on_deck_disarms_there() -> None:
    deck, script = copter_on_deck("moderate", 0.2, 20.0)
    assert not deck.pilot.armed
    assert "Decklander: companion silent, on deck: disarming" in script.texts
    assert deck.body.upright
    assert deck.height_m < 0.3


@pytest.mark.parametrize("parameters", [{"DKL_ENABLE": 0.0}, {"DKL_SILENT_S": 1000.0}])
def test_without_it_the_copter_stays_armed_on_deck(parameters: dict[str, float]) -> None:
    deck, _ = copter_on_deck("moderate", 0.2, 20.0, **parameters)
    assert deck.pilot.armed


def test_in_the_air_it_never_disarms_however_the_copter_is_thrown_about() -> None:
    deck = Deck("moderate", Stack.ARDUPILOT, {"GUID_TIMEOUT": 1.0})
    script = aboard(deck)
    deck.up(4.0)
    deck.silent = True  # type: ignore[attr-defined]
    for down_m_s in (1.5, -2.0, 1.0, -1.0, 1.5, 0.0):
        deck.fly(1.5, down_m_s)
    deck.fly(5.0)
    assert deck.pilot.armed
    assert not any("disarming" in text for text in script.texts)


def test_while_the_companion_is_received_or_somebody_else_flies_it_does_nothing() -> None:
    deck = Deck("moderate", Stack.ARDUPILOT, {"GUID_TIMEOUT": 1.0})
    aboard(deck)
    deck.up(1.0)
    while deck.height_m > 0.15:
        deck.fly(0.1, float(deck.body.v_pad_ned[2]) + 0.4)
    deck.fly(4.0, 1.0)
    assert deck.pilot.armed, "pressed to the deck by a companion that is there"
    deck.silent = True  # type: ignore[attr-defined]
    deck.mode("loiter")
    deck.fly(6.0)
    assert deck.pilot.armed, "a person has it"


HOST = "127.0.0.1"
REST = (0.0, 0.0, 0.0, 0.0)


def on_the_pad(name: str = "calm") -> Scenario:
    scenario = load(name)
    return replace(scenario, start=replace(scenario.start, where="pad"))


def servo_packet(frame: int, motors: tuple[float, ...], rate_hz: int = 400, channels: int = 16) -> bytes:
    pwm = [round(1000 + 1000 * m) for m in motors] + [1500] * (channels - 4)
    return struct.pack(f"<HHI{channels}H", 18458 if channels == 16 else 29569, rate_hz, frame, *pwm)


# Motors


def test_each_motor_turns_the_body_the_way_the_autopilots_expect() -> None:
    f = ardrone2()
    turns = [wrench(f, [1.0 if n == m else 0.0 for n in range(4)], 0.0)[1] for m in range(4)]
    signs = [tuple(int(math.copysign(1, t)) for t in turn) for turn in turns]
    # roll right, nose up, nose clockwise
    assert signs == [(-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1)], "front right, rear left, front left, rear right"
    thrust, torque = wrench(f, [1.0] * 4, 0.0)
    assert thrust == pytest.approx(f.thrust_max_n)
    assert torque == pytest.approx((0.0, 0.0, 0.0))


def test_a_body_stands_on_a_moving_deck_and_goes_with_it() -> None:
    body = Body(on_the_pad("sea_state_4"), 1, 0.0025)
    for _ in range(2000):
        body.step(REST)
    state = body.state()
    assert np.linalg.norm(state.p_ned - body.pad_motion().p_ned) < 0.1
    assert np.linalg.norm(state.v_ned - body.v_pad_ned) < 0.1
    assert state.range_m < 0.1
    assert np.linalg.norm(state.f_body) == pytest.approx(9.81, abs=1.5)


# ArduPilot


def test_packets_of_both_sizes_and_what_is_none() -> None:
    for channels in (16, 32):
        servos = decode(servo_packet(7, (0.1, 0.2, 0.3, 0.4), channels=channels))
        assert (servos.rate_hz, servos.frame, len(servos.pwm_us)) == (400, 7, channels)
        assert servos.motors == pytest.approx((0.1, 0.2, 0.3, 0.4))
    whole = servo_packet(7, REST)
    for bad in (b"", whole[:-1], whole + b"\0", b"\0" * len(whole), servo_packet(7, REST, rate_hz=0)):
        assert decode(bad) is None


def test_a_lost_answer_is_repeated_and_a_restart_begins_again() -> None:
    backend = JsonBackend(lambda step_s: Body(on_the_pad(), 1, step_s, CURVE))
    first = backend.on_packet(servo_packet(1, REST))
    assert backend.on_packet(servo_packet(1, REST)) == first
    for n in range(2, 50):
        later = backend.on_packet(servo_packet(n, REST))
    assert json.loads(later)["timestamp"] == pytest.approx(49 / 400)
    again = backend.on_packet(servo_packet(0, REST))
    assert json.loads(again)["timestamp"] == pytest.approx(1 / 400)
    assert backend.restarts == 1
    assert backend.on_packet(b"rubbish") is None
    assert backend.refused == 1


# PX4


def test_sensors_say_what_the_state_is() -> None:
    body = Body(on_the_pad(), 1, 0.004)
    for _ in range(100):
        body.step(REST)
    state = body.state()
    rng = np.random.default_rng(1)
    still = SensorNoise(0.0, 0.0, 0.0, 0.0, 0.0)
    m = sensors(state, still, rng)
    assert m.time_usec == 400_000
    assert m.fields_updated == 0x1FFF
    assert (m.xacc, m.yacc, m.zacc) == pytest.approx(tuple(state.f_body))
    assert math.hypot(m.xmag, m.ymag, m.zmag) == pytest.approx(0.515, abs=0.01)
    assert m.pressure_alt == pytest.approx(-state.p_ned[2])
    assert 990 < m.abs_pressure < 1014
    g = gnss(state, still, rng)
    seen = ned_between(ORIGIN, GeoPoint.of_degrees(1e-7 * g.lat, 1e-7 * g.lon, 1e-3 * g.alt))
    assert seen == pytest.approx(state.p_ned, abs=0.02), "the ship's receiver has the same origin"
    assert g.alt == pytest.approx(-1000 * state.p_ned[2], abs=1)
    assert (g.fix_type, g.satellites_visible) == (3, 14)


def actuators(motors: tuple[float, ...], armed: bool = True) -> Any:
    return mav.MAVLink_hil_actuator_controls_message(0, [*motors, *[math.nan] * 12], 129 if armed else 1, 0)


def test_motors_rest_while_not_armed_or_not_a_number() -> None:
    assert motors_of(actuators((0.1, 0.2, 0.3, 0.4))) == pytest.approx((0.1, 0.2, 0.3, 0.4))
    assert motors_of(actuators((0.1, 0.2, 0.3, 0.4), armed=False)) == REST
    assert motors_of(actuators((math.nan, 2.0, -1.0, 0.4))) == (0.0, 1.0, 0.0, pytest.approx(0.4))


async def test_a_second_flight_beside_px4_s_simulator_is_reported() -> None:
    backend = HilBackend(Body(on_the_pad(), 1, 0.004), seed=1)
    async with serve_hil(backend, HOST, 0) as port:
        with pytest.raises(SetupImpossible, match="another flight or simulator"):
            async with serve_hil(backend, HOST, port):
                pass
