"""The AR.Drone's custody, what its arbiter sends, and its velocity loop: the tables, and random orders and losses."""

import math
from collections import deque
from collections.abc import Callable, Iterable
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from msgspec.structs import replace

from drivers.ardrone import at
from drivers.ardrone import navdata as nd
from drivers.ardrone.arbiter import CLEAR_M, HOVER, STAY_UP, CommandArbiter, TimedCommand
from drivers.ardrone.at import REF_BASE, REF_EMERGENCY, REF_TAKE_OFF
from drivers.ardrone.custody import DEAD_OR_CUT, TABLE, Custody, CustodyEvent, CustodyKeeper
from drivers.ardrone.landing_watch import Cause, LandingWatch
from drivers.ardrone.navdata import ControlState, Navdata, NavdataState
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.velocity_loop import RESET, LoopState, Sticks, VelocityLoop, held, lean, step
from estimator.contracts.commands import Command, CutMotors, Hover, Land, Lean, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp, after
from tests.make import tuned

OPTIONS = tuned(ArDroneOptions, take_off_timeout_s=3.0)
PERIOD_S, PERIOD_NS = 0.03, 30_000_000
COMMANDS: dict[str, Command] = {
    "take off": TakeOff(), "land": Land(), "hover": Hover(),
    "hold": Hover(calls_off=True), "cut": CutMotors(), "reset": LeaveEmergency(),
}  # fmt: skip


class ToyDrone:
    """The firmware as far as REF goes: it takes off, flies, lands and toggles, and lands for silence by itself."""

    def __init__(self, *, flies: bool) -> None:
        self.control, self.height_m = (ControlState.HOVERING, 1.5) if flies else (ControlState.LANDED, 0.0)
        self.emergency = self.pressed = False
        self.silent_s = 0.0
        self.lands_for = ""
        self.began: list[str] = []
        """Take-offs, and landings called off with whom they were for."""

    @property
    def in_the_air(self) -> bool:
        return self.control in (ControlState.TAKING_OFF, ControlState.HOVERING, ControlState.LANDING)

    def hears(self, bits: int | None) -> None:
        self.silent_s = 0.0
        if bits is None:
            return
        rises, self.pressed = bool(bits & REF_EMERGENCY) and not self.pressed, bool(bits & REF_EMERGENCY)
        if rises:
            self.toggle()
        elif bits & REF_TAKE_OFF and self.control is ControlState.LANDED and not self.emergency:
            self.control = ControlState.TAKING_OFF
            self.began.append("take-off")
        elif bits & REF_TAKE_OFF and self.control is ControlState.LANDING:
            self.control = ControlState.HOVERING
            self.began.append(f"called off {self.lands_for}")
        elif not bits & REF_TAKE_OFF and self.control in (ControlState.TAKING_OFF, ControlState.HOVERING):
            self.land("us")

    def toggle(self) -> None:
        self.control = ControlState.LANDED if self.emergency else ControlState.DEFAULT
        self.emergency, self.height_m = not self.emergency, 0.0

    def land(self, by: str) -> None:
        self.control, self.lands_for = ControlState.LANDING, by

    def passes(self) -> None:
        self.silent_s += PERIOD_S
        if self.silent_s > 4.0 and self.control is ControlState.HOVERING:
            self.land("silence")
        if self.control is ControlState.TAKING_OFF:
            self.height_m += 1.0 * PERIOD_S
            self.control = ControlState.HOVERING if self.height_m >= 0.8 else self.control
        elif self.control is ControlState.LANDING:
            self.height_m = max(0.0, self.height_m - 0.4 * PERIOD_S)
            self.control = ControlState.LANDED if self.height_m == 0.0 else self.control

    def report(self) -> Navdata:
        state = (NavdataState.FLYING if self.in_the_air else 0) | (NavdataState.EMERGENCY if self.emergency else 0)
        state |= NavdataState.COM_WATCHDOG if self.silent_s > 2.0 else 0
        return Navdata(state, 1, ctrl_state=self.control.word, altitude_mm=round(1000 * self.height_m))


class Wire:
    """A way on which things are lost or late; none overtakes another."""

    def __init__(self) -> None:
        self.under_way: deque[tuple[int, object]] = deque()

    def sends(self, at: int, thing: object, late: int) -> None:
        self.under_way.append((max(at + late, self.under_way[-1][0] if self.under_way else 0), thing))

    def arrives(self, at: int) -> Iterable[object]:
        while self.under_way and self.under_way[0][0] <= at:
            yield self.under_way.popleft()[1]


class Flown(RuleBasedStateMachine):
    """Orders, and periods in which datagrams are lost or up to 90 ms late each way."""

    @initialize(flies=st.booleans())
    def begin(self, flies: bool) -> None:
        self.drone, self.keeper = ToyDrone(flies=flies), CustodyKeeper(OPTIONS)
        self.there, self.back = Wire(), Wire()
        self.k = 0
        self.cut = self.taking = self.others_toggled = False
        self.landed_us: int | None = None
        self.run([(0, 0)] * 5)

    @property
    def now(self) -> MonoNs:
        return MonoNs(10_000_000_000 + self.k * PERIOD_NS)

    def run(self, links: Iterable[tuple[int | None, int | None]]) -> None:
        """Let periods pass; of each, how many periods the datagrams there and back are late, None for lost."""
        for there, back in links:
            self.k += 1
            self.drone.passes()
            ref = self.keeper.ref(self.now)
            if self.cut and not self.others_toggled:
                assert not (ref or 0) & REF_TAKE_OFF, f"take-off bit behind EMERGENCY in {self.keeper.state}"
            if ref == REF_BASE and self.keeper.state is Custody.LANDING:
                self.landed_us = self.k
            if there is not None:
                self.there.sends(self.k, ref, there)
            began = len(self.drone.began)
            for heard in self.there.arrives(self.k):
                self.drone.hears(heard)  # type: ignore[arg-type]
            for deed in self.drone.began[began:]:
                assert deed != "take-off" or self.taking, "motors started that nobody ordered"
                assert deed != "called off others", "another's landing was called off"
            if back is not None:
                self.back.sends(self.k, self.drone.report(), back)
            for report in self.back.arrives(self.k):
                self.keeper.on_report(report, self.now)  # type: ignore[arg-type]

    @rule(name=st.sampled_from(sorted(COMMANDS)))
    def order(self, name: str) -> None:
        command = COMMANDS[name]
        self.keeper.order(command, self.now)
        if isinstance(command, CutMotors):
            self.cut, self.others_toggled = True, False
        elif isinstance(command, LeaveEmergency):
            self.cut = False
        self.taking = (self.taking and name != "cut") or name == "take off"

    @rule(links=st.lists(st.tuples(st.none() | st.integers(0, 3), st.none() | st.integers(0, 3)), min_size=1, max_size=30))
    def passes(self, links: list[tuple[int | None, int | None]]) -> None:
        self.run(links)

    @rule(periods=st.integers(30, 250), hears=st.booleans())
    def link_breaks(self, periods: int, hears: bool) -> None:
        self.run([(None, 0 if hears else None)] * periods)

    # A datagram that is under way knows nothing of the landing that it meets.
    @precondition(lambda self: not self.there.under_way)
    @precondition(lambda self: self.drone.silent_s < 0.1 and (self.landed_us is None or self.k - self.landed_us > 30))
    @rule()
    def another_lands_it(self) -> None:
        if self.drone.control is ControlState.HOVERING:
            # Whoever lands it goes on ordering that until it shows.
            for _ in range(8):
                self.drone.land("others")
                self.drone.began.clear()
                self.run([(None, 0)])

    @rule()
    def another_toggles(self) -> None:
        self.drone.toggle()
        self.others_toggled = True
        self.run([(0, 0)] * 8)

    @rule()
    def emergency_is_obeyed_over_a_link_that_works(self) -> None:
        self.order("cut")
        self.run([(0, 0)] * 80)
        assert self.drone.emergency, f"{self.keeper.state} after EMERGENCY"
        assert self.keeper.state is Custody.DEAD
        self.order("take off")
        self.run([(0, 0)] * 20)
        assert self.drone.emergency

    @rule()
    def a_hold_ends_a_take_off(self) -> None:
        self.order("take off")
        self.order("hold")
        assert self.keeper.state is not Custody.TAKING_OFF

    @rule()
    def a_landing_that_is_renewed_is_flown_to_its_end(self) -> None:
        if self.keeper.state is not Custody.OURS or self.drone.control is not ControlState.HOVERING:
            return
        for _ in range(20):
            self.order("land")
            self.run([(0, 0)] * 10)
        assert self.drone.control is ControlState.LANDED

    @invariant()
    def the_take_off_bit_needs_a_drone_that_is_to_fly(self) -> None:
        if self.k and self.keeper.state in (*DEAD_OR_CUT, Custody.STANDS, Custody.LANDING):
            assert not (self.keeper.ref(self.now) or 0) & REF_TAKE_OFF


Flown.TestCase.settings = settings(max_examples=40, stateful_step_count=25, deadline=None)
TestFlown = Flown.TestCase


def test_nothing_but_a_reset_leads_from_emergency_and_no_order_there_flies() -> None:
    orders = (CustodyEvent.TAKE_OFF, CustodyEvent.LAND, CustodyEvent.STEER, CustodyEvent.CALL_OFF)
    for state, event in product(DEAD_OR_CUT, (*orders, CustodyEvent.SILENT)):
        assert TABLE[state][event] is state
    assert {TABLE[state][CustodyEvent.CUT] for state in Custody} == {Custody.CUT, Custody.DEAD}
    assert set(TABLE[Custody.CUT].values()) == {Custody.CUT, Custody.DEAD, Custody.LEAVING}


def test_no_command_takes_a_landing_from_others() -> None:
    for event in CustodyEvent:
        ends = event in (CustodyEvent.STANDS, CustodyEvent.FLIES, CustodyEvent.DEAD, CustodyEvent.CUT)
        assert (TABLE[Custody.OTHERS][event] is Custody.OTHERS) is not ends


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_toggle_survives_lost_datagrams_and_is_one_toggle(lost: int) -> None:
    drone, keeper = ToyDrone(flies=True), CustodyKeeper(OPTIONS)
    at = 10_000_000_000
    keeper.on_report(drone.report(), MonoNs(at))
    keeper.order(CutMotors(), MonoNs(at))
    for k in range(200):
        now = MonoNs(at + (k + 1) * PERIOD_NS)
        ref = keeper.ref(now)
        if k >= lost:
            drone.hears(ref)
        # The report is as late as a bad Wi-Fi makes it.
        if k >= 12:
            keeper.on_report(drone.report(), now)
    assert drone.emergency
    assert keeper.state is Custody.DEAD


@pytest.mark.hazard("H6")
@pytest.mark.parametrize("what", ["others", "battery", "emergency", "ours", "cut"])
def test_what_the_drone_does_by_nobodys_order_ends_the_orders_before_it_and_is_not_taken_back(what: str) -> None:
    drone, keeper, now = ToyDrone(flies=True), CustodyKeeper(OPTIONS), MonoNs(10_000_000_000)
    low = NavdataState.BATTERY_LOW if what == "battery" else 0

    def report() -> None:
        seen = drone.report()
        keeper.on_report(replace(seen, state=seen.state | low), now)

    report()
    keeper.order(Land() if what == "ours" else CutMotors() if what == "cut" else Hover(), now)
    keeper.ref(now)
    now = after(now, 1.0)
    drone.land("us" if what == "ours" else "others") if what in ("others", "battery", "ours") else drone.toggle()
    report()
    assert keeper.others_at == (None if what in ("ours", "cut") else now)
    keeper.order(Velocity(np.array([0.0, 0.0, -0.5]), 0.0), now)
    assert bool((keeper.ref(now) or 0) & REF_TAKE_OFF) is (what == "ours"), "a go-around takes back our own landing alone"


def test_a_landing_that_guidance_began_is_taken_back_though_its_report_is_late() -> None:
    """WHY: a report from before the landing led back to flight, and the landing that followed counted as another's."""
    drone, keeper = ToyDrone(flies=True), CustodyKeeper(OPTIONS)
    at = MonoNs(10_000_000_000)
    before = drone.report()
    keeper.on_report(before, at)
    keeper.order(Land(), at)
    drone.hears(keeper.ref(at))
    keeper.order(Hover(), MonoNs(at + PERIOD_NS))
    keeper.on_report(before, MonoNs(at + 2 * PERIOD_NS))
    keeper.on_report(drone.report(), MonoNs(at + 3 * PERIOD_NS))
    assert keeper.ref(MonoNs(at + 3 * PERIOD_NS)) == STAY_UP


AHEAD = at.Pcmd(at.PCMD_PROGRESSIVE, 0.0, -0.5, 0.0, 0.0)
FLY = at.Ref(at.REF_BASE | at.REF_TAKE_OFF)
GROUND = at.Ref(at.REF_BASE)
CLIMB = at.Pcmd(at.PCMD_PROGRESSIVE, 0.1, -0.2, 1.0, 0.0)
PERIOD_MS = 30


def ms(t: int) -> MonoNs:
    return MonoNs(5_000_000_000 + t * 1_000_000)


def drone_report(control: nd.ControlState | None, altitude_m: float | None = 1.5, bits: int = 0) -> nd.Navdata:
    in_the_air = control not in (nd.ControlState.LANDED, nd.ControlState.INIT)
    word = None if control is None else control.word
    altitude_mm = None if altitude_m is None else round(1000 * altitude_m)
    state = bits | (nd.NavdataState.FLYING if in_the_air else 0)
    return nd.Navdata(state, 1, ctrl_state=word, altitude_mm=altitude_mm)


def test_a_word_is_flown_up_to_its_deadline_and_hover_after_it() -> None:
    arbiter = CommandArbiter(60.0, 2.0)
    assert arbiter.commands(ms(0)) == [], "nothing is said before the service has said something"
    arbiter.take(TimedCommand(ms(120), AHEAD, FLY.bits))
    assert arbiter.commands(ms(0)) == arbiter.commands(ms(120)) == [FLY, AHEAD]
    assert arbiter.commands(ms(121)) == [HOVER], "no order to take off outlives its word"
    arbiter.take(TimedCommand(ms(120), AHEAD, GROUND.bits))
    assert arbiter.commands(ms(5000)) == [HOVER], "it waited in the socket while we, or the service, were stopped"


def test_a_word_of_a_service_that_is_gone_ends_at_once() -> None:
    arbiter = CommandArbiter(60.0, 2.0)
    arbiter.take(TimedCommand(ms(120), AHEAD, FLY.bits))
    arbiter.lost(ms(10))
    assert arbiter.commands(ms(10)) == [HOVER]
    arbiter.lost(ms(50))
    assert arbiter.silent_s(ms(50)) == pytest.approx(0.04), "counted from when it was lost first"


def test_a_drone_in_the_air_is_held_there_and_its_watchdog_answered() -> None:
    arbiter = CommandArbiter(60.0, 2.0)
    arbiter.take(TimedCommand(ms(120), AHEAD, FLY.bits))
    arbiter.on_report(drone_report(nd.ControlState.HOVERING, bits=nd.NavdataState.COM_WATCHDOG), ms(1000))
    assert arbiter.commands(ms(1001)) == [at.ComWdg(), FLY, HOVER]
    assert arbiter.commands(ms(1300)) == [HOVER], "told too late, the wish to fly would start the motors of one that has landed"
    arbiter.on_report(drone_report(nd.ControlState.LANDED), ms(1400))
    assert arbiter.commands(ms(1401)) == [HOVER]
    assert arbiter.on_ground(ms(1401))


def climbed_m(sticks: at.Pcmd, ref: int | None, reports: Callable[[float], nd.Navdata | None], *, died: bool = True) -> float:
    """Return the height that an arbiter climbs in 20 s after its service has died, or fell silent.

    Args:
        reports: the report after a climb of so much, m; None to receive none.
    """
    arbiter, height_m = CommandArbiter(60.0, 2.0), 0.0
    arbiter.take(TimedCommand(ms(120), sticks, ref, climb=CLIMB))
    if died:
        arbiter.lost(ms(0))
    for t in range(0, 20_000, PERIOD_MS):
        if (said := reports(height_m)) is not None:
            arbiter.on_report(said, ms(t))
        *_, flown = arbiter.commands(ms(t))
        assert flown in ((HOVER, CLIMB) if died or t > 1120 else (HOVER, AHEAD))
        height_m += 2e-3 * PERIOD_MS if flown == CLIMB else 0.0
    return height_m


@pytest.mark.hazard("H5")
@pytest.mark.parametrize("died", [True, False])
@pytest.mark.parametrize("sticks", [AHEAD, HOVER])
def test_a_drone_without_a_service_climbs_out_of_the_reach_of_the_deck(sticks: at.Pcmd, died: bool) -> None:
    near = climbed_m(sticks, FLY.bits, lambda by_m: drone_report(nd.ControlState.FLYING, 0.3 + by_m), died=died)
    assert 0.3 + near == pytest.approx(CLEAR_M, abs=0.1)
    assert climbed_m(sticks, FLY.bits, lambda _: drone_report(nd.ControlState.FLYING, 2.1), died=died) == 0.0, "it is high enough"
    for mute in (None, drone_report(nd.ControlState.FLYING, None), drone_report(nd.ControlState.HOVERING, 0.0)):
        by_time = climbed_m(sticks, FLY.bits, lambda _, said=mute: said, died=died)
        assert by_time == pytest.approx(CLEAR_M if sticks is AHEAD else 0.0, abs=0.15), "without a height by time, if it steered"
    stuck = climbed_m(sticks, FLY.bits, lambda _: drone_report(nd.ControlState.FLYING, 0.3), died=died)
    assert stuck == pytest.approx(2.0 * CLEAR_M, abs=0.15), "an ultrasound that never changes is not believed for ever"


def test_nothing_climbs_that_does_not_fly_or_that_a_person_lands_or_cut() -> None:
    for control in (nd.ControlState.LANDED, nd.ControlState.TAKING_OFF, nd.ControlState.LANDING):
        said = drone_report(control, 0.3)
        assert climbed_m(AHEAD, FLY.bits, lambda _, said=said: said) == 0.0
    assert climbed_m(AHEAD, GROUND.bits, lambda _: drone_report(nd.ControlState.FLYING, 0.3)) == 0.0


def test_a_service_that_speaks_again_ends_the_climb() -> None:
    arbiter = CommandArbiter(60.0, 2.0)
    for t in (0, 5000):
        arbiter.take(TimedCommand(ms(t + 120), AHEAD, FLY.bits, climb=CLIMB))
        assert arbiter.commands(ms(t)) == [FLY, AHEAD]
        assert arbiter.commands(ms(t + 121)) == [HOVER], "a pause is not the end"
        arbiter.lost(ms(t + 130))
        assert arbiter.commands(ms(t + 130)) == [CLIMB]


def test_it_is_held_for_a_bounded_time() -> None:
    arbiter = CommandArbiter(2.0, 2.0)
    arbiter.take(TimedCommand(ms(120), AHEAD, FLY.bits))
    assert arbiter.commands(ms(2110)) == [HOVER]
    assert arbiter.commands(ms(2130)) == []


@pytest.mark.parametrize("flying", [False, True])
@pytest.mark.parametrize("control", [None, *nd.ControlState])
def test_it_stands_where_state_and_control_both_say_so(control: nd.ControlState | None, flying: bool) -> None:
    on_ground = not flying and control in (None, nd.ControlState.LANDED, nd.ControlState.INIT, nd.ControlState.DEFAULT)
    arbiter = CommandArbiter(60.0, 2.0)
    assert not arbiter.on_ground(ms(200)), "nobody has said so"
    arbiter.on_report(replace(drone_report(control), state=nd.NavdataState.FLYING if flying else 0), ms(200))
    assert arbiter.on_ground(ms(300)) is on_ground
    assert not arbiter.on_ground(ms(1300)), "said too long ago"


@pytest.mark.parametrize(("landing", "altitude_m", "called_off"), [(True, 1.0, True), (True, 0.3, False), (False, 1.0, False)])
def test_a_landing_nobody_renews_is_called_off_unless_it_is_about_to_end(landing, altitude_m, called_off):
    """The landing of a person, which is not to be renewed, goes on."""
    arbiter = CommandArbiter(60.0, 2.0)
    arbiter.take(TimedCommand(ms(120), HOVER, GROUND.bits, landing=landing))
    arbiter.on_report(drone_report(nd.ControlState.LANDING, altitude_m), ms(300))
    assert arbiter.commands(ms(301)) == ([FLY, HOVER] if called_off else [HOVER])


SILENT = nd.NavdataState.COM_WATCHDOG | nd.NavdataState.COMMUNICATION_LOST


@pytest.mark.parametrize(
    ("bits", "first_at", "cause"),
    [
        (SILENT, None, Cause.SILENCE),
        (nd.NavdataState.COM_WATCHDOG, None, Cause.SILENCE),
        (SILENT, 9000, Cause.OTHERS),
        (0, None, Cause.OTHERS),
        (SILENT | nd.NavdataState.BATTERY_LOW, None, Cause.OTHERS),
        (SILENT | nd.NavdataState.USER_EMERGENCY, None, Cause.OTHERS),
    ],
)
def test_whose_landing_it_is(bits: int, first_at: int | None, cause: Cause) -> None:
    """A landing is attributed to our silence only if it began in a gap of navdata; never if a battery or a person began it."""
    watch = LandingWatch()
    if first_at is not None:
        watch.on_report(drone_report(nd.ControlState.HOVERING), ms(first_at), ordered=False)
    watch.on_report(drone_report(nd.ControlState.LANDING, 1.5, bits), ms(9500), ordered=False)
    assert watch.cause is cause
    assert watch.calls_off(ms(9510)) is (cause is Cause.SILENCE)
    assert not watch.calls_off(ms(9800)), "known too long ago"
    watch.on_report(drone_report(nd.ControlState.LANDING, 0.4), ms(9900), ordered=False)
    assert not watch.calls_off(ms(9901)), "too near the ground"
    watch.on_report(drone_report(nd.ControlState.HOVERING), ms(9950), ordered=False)
    assert watch.cause is None


LOOP_OPTIONS = ArDroneOptions()
STILL = np.zeros(3)


def wanted(forward: float = 0.0, right: float = 0.0, down: float = 0.0, yaw_rate_rad_s: float = 0.0) -> Velocity:
    return Velocity(np.array([forward, right, down]), yaw_rate_rad_s)


def sticks(command: Velocity, v_level: F64 = STILL, state: LoopState = RESET) -> Sticks:
    return step(state, command, v_level, None, 0.0, LOOP_OPTIONS)[1]


def forward_speed(
    target: float, *, speed_rad_s: float = 3.16, damping: float = 0.79, delay_s: float = 0.09, reads: float = 1.0,
    wind_m_s: float = 0.0, kick_m_s: float = 0.0,
) -> F64:  # fmt: skip
    """Forward speed over 12 s at 200 Hz of a point mass with drag, a second-order tilt and a late velocity sensor.

    Args:
        delay_s: of motors, link and sensor together; half of it is the sensor's, a tilt is read as late.
    """
    dt, v, tilt, rate = 0.005, kick_m_s, 0.0, 0.0
    seen, asked = deque([(v, 0.0)] * round(0.5 * delay_s / dt)), deque([0.0] * round(0.5 * delay_s / dt))
    state, out, stick = RESET, [], 0.0
    for k in range(2400):
        if k % 6 == 0:
            read, a_level = np.array([seen[0][0] * reads, 0.0, 0.0]), np.array([seen[0][1], 0.0])
            state, s = step(state, wanted(target), read, a_level, 0.03, LOOP_OPTIONS)
            stick = -s.pitch * LOOP_OPTIONS.euler_angle_max_rad
        asked.append(stick)
        rate += (speed_rad_s**2 * (asked.popleft() - tilt) - 2.0 * damping * speed_rad_s * rate) * dt
        tilt += rate * dt
        v += (9.80665 * math.tan(tilt) - 0.43 * (v - wind_m_s)) * dt
        seen.append((v, 9.80665 * math.tan(tilt)))
        seen.popleft()
        out.append(v)
    return np.array(out)


def test_signs() -> None:
    assert sticks(wanted(forward=0.5)).pitch < 0
    assert sticks(wanted(right=0.5)).roll > 0
    assert sticks(wanted(down=0.5)).gaz == pytest.approx(-0.5 / LOOP_OPTIONS.vz_max_m_s)
    assert sticks(wanted(yaw_rate_rad_s=LOOP_OPTIONS.yaw_rate_max_rad_s / 4)).yaw == pytest.approx(0.25)
    back = sticks(wanted(), np.array([0.3, -0.3, 9.0]))
    assert back.pitch > 0
    assert back.roll > 0
    assert back.gaz == 0.0


@pytest.mark.parametrize("target", [0.2, 0.4, 1.0, -0.4])
def test_a_step_is_reached_quickly_and_held(target: float) -> None:
    v = forward_speed(target) / target
    assert np.argmax(v > 0.9) * 0.005 < 1.2
    assert v.max() < 1.35
    assert v[-200:] == pytest.approx(np.ones(200), abs=0.02)


@pytest.mark.parametrize("speed_rad_s", [2.5, 3.16, 3.8])
@pytest.mark.parametrize("damping", [0.6, 0.79, 1.0])
@pytest.mark.parametrize("delay_s", [0.09, 0.14])
def test_a_drone_unlike_its_file_comes_to_rest(speed_rad_s: float, damping: float, delay_s: float) -> None:
    """Two standard deviations of what an owner's identification leaves."""
    v = forward_speed(0.0, speed_rad_s=speed_rad_s, damping=damping, delay_s=delay_s, kick_m_s=0.5)
    assert np.abs(v[-200:]).max() < 0.1


@pytest.mark.parametrize(("speed_rad_s", "damping"), [(8.0, 0.6), (11.5, 0.65), (14.0, 0.5), (20.0, 0.7)])
def test_commands_that_come_late_make_no_quadcopter_swing(speed_rad_s: float, damping: float) -> None:
    """A lead of 1.2 and commands .12 s late made one lean by 67 degrees, and its firmware cut the motors."""
    v = forward_speed(0.0, speed_rad_s=speed_rad_s, damping=damping, delay_s=0.24, kick_m_s=0.8, wind_m_s=-6.0)
    assert np.ptp(v[-400:]) < 0.07, "what is left is the integral's"


@settings(max_examples=200)
@given(*[st.floats(-20, 20)] * 5, st.floats(0, 1))
def test_sticks_stay_inside_and_tilt_keeps_its_direction(vx, vy, vz, mx, my, dt_s):
    state = RESET
    for _ in range(5):
        state, s = step(state, wanted(vx, vy, vz, 50.0), np.array([mx, my, 0.0]), None, dt_s, LOOP_OPTIONS)
        assert math.hypot(s.roll, s.pitch) <= 1.0 + 1e-9
        assert max(abs(s.gaz), abs(s.yaw)) <= 1.0
        assert math.hypot(state.forward_m_s2, state.right_m_s2) <= 9.80665 * math.tan(LOOP_OPTIONS.euler_angle_max_rad) + 1e-9
    first = sticks(wanted(vx, vy), np.array([mx, my, 0.0]))
    push = LOOP_OPTIONS.velocity_gain_1_s * np.array([vx - mx, vy - my]) + LOOP_OPTIONS.velocity_drag_1_s * np.array([vx, vy])
    assert -first.pitch * push[1] == pytest.approx(first.roll * push[0], abs=1e-6)


@given(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_a_tilt_follows_from_its_acceleration_and_never_exceeds_the_limit(forward, right, trim_forward, trim_right):
    wanted = Lean(np.array([forward, right]), np.array([trim_forward, trim_right]), np.zeros(3), 0.0)
    _, s = lean(wanted, None, LOOP_OPTIONS)
    tilt = math.hypot(s.roll, s.pitch) * LOOP_OPTIONS.euler_angle_max_rad
    size = math.hypot(forward + trim_forward, right + trim_right)
    assert tilt == pytest.approx(min(math.atan(size / 9.80665), LOOP_OPTIONS.euler_angle_max_rad), abs=1e-9)
    assert s.pitch * (forward + trim_forward) <= 1e-12
    assert s.roll * (right + trim_right) >= -1e-12


@pytest.mark.parametrize(("heading", "forward", "right"), [(0.0, 1.2, 0.4), (math.pi / 2, 0.4, -1.2), (math.pi, -1.2, -0.4)])
def test_a_velocity_after_a_tilt_begins_with_its_trim_wherever_the_nose_has_turned(heading, forward, right):
    """Otherwise the wind carries the drone off for as long as an integral takes to come back."""
    state, _ = lean(Lean(np.zeros(2), np.array([1.2, 0.4]), np.zeros(3), 0.0), 0.0, LOOP_OPTIONS)
    _, s = step(state.at_heading(heading), wanted(), STILL, None, 0.0, LOOP_OPTIONS)
    size = math.hypot(1.2, 0.4)
    share = math.atan(size / 9.80665) / LOOP_OPTIONS.euler_angle_max_rad / size
    assert (-s.pitch, s.roll) == pytest.approx((forward * share, right * share))


_AXIS = st.floats(-3.5, 3.5)


@given(_AXIS, _AXIS, st.floats(-1.5, 1.5), st.floats(2.0, 8.0), st.integers(0, 2**32 - 1))
def test_a_velocity_after_a_hover_begins_with_the_tilt_that_held_against_the_wind(forward, right, moves_m_s, for_s, seed):
    """An integral that begins with nothing takes seconds, and the drone is metres to lee by then."""
    against, dt, noise = np.array([forward, right]), 0.03, np.random.default_rng(seed)
    state, before = RESET, np.array([moves_m_s, 0.0])
    for k in range(round(for_s / dt)):
        v = np.array([moves_m_s * math.exp(-k * dt), 0.0])
        swings = 0.3 * math.sin(4.0 * k * dt) + noise.normal(0.0, 0.1, 2)
        tilt = against + LOOP_OPTIONS.velocity_drag_1_s * v + (v - before) / dt + swings
        state = held(state, v, before, tilt, min(2.0, (k + 1) * dt), dt, LOOP_OPTIONS)
        before = v
    assert (state.forward_m_s2, state.right_m_s2) == pytest.approx(against.tolist(), abs=0.2)
    _, s = step(state, wanted(), before, None, 0.0, LOOP_OPTIONS)
    assert math.hypot(s.roll, s.pitch) * LOOP_OPTIONS.euler_angle_max_rad >= math.atan(math.hypot(*against) / 9.80665) - 0.12


@given(_AXIS, _AXIS, st.floats(-8.0, 8.0), st.floats(-8.0, 8.0))
def test_at_the_limit_the_tilt_against_the_wind_is_kept(trim_forward: float, trim_right: float, vx: float, vy: float) -> None:
    _, s = step(LoopState(trim_forward, trim_right), wanted(), np.array([vx, vy, 0.0]), None, 0.03, LOOP_OPTIONS)
    tilt = math.hypot(s.roll, s.pitch) * LOOP_OPTIONS.euler_angle_max_rad
    flown = 9.80665 * math.tan(tilt) * np.array([-s.pitch, s.roll]) / max(1e-9, math.hypot(s.roll, s.pitch))
    more = flown - np.array([trim_forward, trim_right])
    assert float(more @ np.array([-vx, -vy])) >= -1e-3, "what is left brakes, and takes nothing from the trim"


def test_a_climb_without_a_service_leans_as_the_wind_asked_for_and_not_as_feet_on_a_deck_did() -> None:
    loop, at = VelocityLoop(LOOP_OPTIONS), 0
    for trim, cycles in (2.0, 100), (6.0, 5):
        for _ in range(cycles):
            at += 30_000_000
            now = MonoNs(at)
            loop.on_sample(Attitude(Stamp(now, now, 0.001, "navdata"), Rotation.from_rpy(0.0, 0.0, 0.0), 1e-4 * np.eye(3)))
            loop.fly(Lean(np.zeros(2), np.array([trim, 0.0]), np.zeros(3), 0.0), now)
    leans = -loop.climb().pitch * LOOP_OPTIONS.euler_angle_max_rad
    assert math.atan(2.0 / 9.80665) <= leans < math.atan(2.5 / 9.80665)


@given(st.floats(0.0, 1.0), st.floats(0.0, 40.0), st.floats(-math.pi, math.pi), st.floats(-2.0, 2.0))
def test_a_drone_that_leans_far_against_its_order_turns_level_before_it_climbs(ordered, leans_deg, off_rad, down):
    """A rotor at 70 % and a go-around with all thrust: 4 of 8 tipped over within .5 s, .2 m over the deck."""
    now, leans = MonoNs(10**9), math.radians(leans_deg)
    R = Rotation.from_rpy(leans * math.sin(off_rad), -leans * math.cos(off_rad), 0.0)
    loop = VelocityLoop(LOOP_OPTIONS)
    loop.on_sample(Attitude(Stamp(now, now, 0.001, "navdata"), R, 1e-4 * np.eye(3)))
    order = Lean(np.array([3.0 * ordered, 0.0]), np.zeros(2), np.array([0.0, 0.0, down]), 0.0)
    found, plain = loop.fly(order, now), lean(order, 0.0, LOOP_OPTIONS)[1]
    assert (found.roll, found.pitch) == (plain.roll, plain.pitch)
    far, against = leans_deg > 22.0, ordered > 0.01 and math.cos(off_rad) < -0.1
    if far and against and down < -0.5:
        assert 0.0 < found.gaz < plain.gaz / 1.5
    elif leans_deg < 18.0 or not (ordered > 0.0 and math.cos(off_rad) < 0.1) or down >= 0.0:
        assert found.gaz == plain.gaz
