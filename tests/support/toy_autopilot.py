"""A toy autopilot of each stack in virtual time, and it flown by the arbiter of people's orders and the driver together.

The toy obeys as ArduCopter and PX4 were measured to: GUIDED lifts off by NAV_TAKEOFF alone, OFFBOARD wants a stream and falls
into Hold without one, a plain disarm is refused in the air, and PX4 beats once a second whatever is asked, but answers each
request for a HEARTBEAT. What our messages ask for is logged.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from random import Random
from typing import Any

import numpy as np

from companion.base.mission import FlightOutcome
from companion.base.orders import HandledOrder, OperatorOrder, OrderSender, OrderSource
from companion.guidance.operator.arbiter import OperatorArbiter
from drivers.mavlink.custody import Hand
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.failsafe import FailsafeWatch
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.requests import RATES_HZ, Streams
from drivers.mavlink.setpoint_streamer import FORCE, SetpointStreamer
from drivers.mavlink.vehicle import ARMED, LAND_MODE, VELOCITY_MODE, Condition, Identity, Stack, custom_mode, mode_name
from estimator.contracts.commands import Command, Hover, Land, Velocity
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp

STEP_S = 0.04
BEAT_S = 1.0
"""Interval of the HEARTBEATs, s, until another is accepted."""
SPOOL_S = 1.0
PERSONS_MODE = {Stack.ARDUPILOT: "loiter", Stack.PX4: "posctl"}
MANUAL_MODE = {Stack.ARDUPILOT: "stabilize", Stack.PX4: "stabilized"}
STILL = Velocity(np.zeros(3), 0.0)
SINKS = Velocity(np.array([0.0, 0.0, 0.4]), 0.0)
_STREAM_LOST_S, _PX4_WANTS_S = 1.0, 1.0


class Toy:
    """An autopilot: `receive` our messages, `step` the time, `switch` and `disarm` as a person would by remote control."""

    def __init__(self, stack: Stack, *, height_m: float = 5.0) -> None:
        self.stack, self.mode, self.height_m = stack, PERSONS_MODE[stack], height_m
        self.armed = self.flying = height_m > 0.0
        self.velocity_mode = VELOCITY_MODE[stack]
        self.refuses_modes = self.refuses_disarm = self.others_stream = False
        self.log: list[tuple[float, str]] = []
        """Requests of our messages, with their times, s: `mode NAME`, `arm`, `disarm`, `disarm forced`, `take off`."""
        self.setpoints: list[tuple[float, float]] = []
        """Times of the setpoints, and their velocities down in flight, m/s."""
        self.answers: list[tuple[int, bool]] = []
        self.failing: str | None = None
        """The words of the failsafe in force, which HEARTBEAT calls CRITICAL; None without one."""
        self.each_s, self.beats = BEAT_S, False
        """The interval of its HEARTBEATs, s; True once one was requested."""
        self.now_s = 0.0
        self._down_m_s, self._wanted_s, self._stream_s = 0.0, -math.inf, math.inf
        self._lifts_to_m: float | None = None
        self._spun_s = self._stood_s = 0.0

    def switch(self, mode: str) -> None:
        """Enter a mode."""
        if mode != self.mode:
            self.mode, self._lifts_to_m, self._down_m_s = mode, None, 0.0

    def fail(self, mode: str | None, words: str = "Battery Failsafe") -> None:
        """Let a failsafe act by a mode, be it the one that it is in; None for one that leaves the mode."""
        self.failing = words
        self.switch(mode or self.mode)

    def disarm(self) -> None:
        """Stop the motors; in the air it falls."""
        self.armed, self._lifts_to_m, self._spun_s = False, None, 0.0

    def receive(self, m: Message) -> None:
        """Obey a message of ours."""
        kind = m.get_type()
        if kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._stream_s = self.now_s if self.now_s - self._wanted_s > 0.5 else self._stream_s
            self._wanted_s, self._down_m_s = self.now_s, m.vz
            self.setpoints.append((self.now_s, m.vz if self.flying else 0.0))
            return
        if kind == "COMMAND_INT":
            self.log.append((self.now_s, "reposition"))
            self.switch("guided" if self.stack is Stack.ARDUPILOT else "auto.loiter")
            return
        obeyed = {
            mav.MAV_CMD_DO_SET_MODE: self._on_set_mode,
            mav.MAV_CMD_COMPONENT_ARM_DISARM: self._on_arm,
            mav.MAV_CMD_NAV_TAKEOFF: self._on_take_off,
            mav.MAV_CMD_SET_MESSAGE_INTERVAL: self._on_interval,
            mav.MAV_CMD_REQUEST_MESSAGE: self._on_request,
        }[m.command](m)
        self.answers.append((m.command, obeyed))

    def _on_interval(self, m: Message) -> bool:
        if self.stack is Stack.ARDUPILOT:
            self.each_s = 1e-6 * m.param2
        return self.stack is Stack.ARDUPILOT

    def _on_request(self, m: Message) -> bool:
        self.beats = True
        return True

    def _on_set_mode(self, m: Message) -> bool:
        number = int(m.param2) if self.stack is Stack.ARDUPILOT else int(m.param2) << 16 | int(m.param3) << 24
        name = mode_name(self.stack, number)
        assert custom_mode(self.stack, name) == number
        self.log.append((self.now_s, f"mode {name}"))
        streams = self.now_s - self._wanted_s <= 0.5 and self.now_s - self._stream_s >= _PX4_WANTS_S
        if self.refuses_modes or (name == "offboard" and not streams):
            return False
        self.switch(name)
        return True

    def _on_arm(self, m: Message) -> bool:
        forced = m.param2 == FORCE
        self.log.append((self.now_s, "arm" if m.param1 else "disarm forced" if forced else "disarm"))
        if m.param1:
            self.armed = True
        elif self.refuses_disarm or (self.flying and not forced):
            return False
        else:
            self.disarm()
        return True

    def _on_take_off(self, m: Message) -> bool:
        self.log.append((self.now_s, "take off"))
        if not self.armed or self.mode != "guided" or self.flying:
            return False
        self._lifts_to_m = m.param7
        return True

    def step(self, now_s: float) -> None:
        """Go on by one step."""
        self.now_s = now_s
        if self.mode == "offboard" and now_s - self._wanted_s > _STREAM_LOST_S and not self.others_stream:
            self.switch("auto.loiter")
        down_m_s = self._sinks_m_s()
        self._spun_s = self._spun_s + STEP_S if self.armed else 0.0
        if self.armed and not self.flying and down_m_s < 0.0 and self._spun_s > SPOOL_S:
            self.flying = True
        if self.flying:
            self.height_m = max(0.0, self.height_m - down_m_s * STEP_S)
        self._stood_s = self._stood_s + STEP_S if self.height_m == 0.0 and (down_m_s > 0.0 or not self.armed) else 0.0
        if self._stood_s > (0.5 if self.armed else 0.0):
            self.flying = False
            if self.armed and self.mode == LAND_MODE[self.stack]:
                self.disarm()

    def _sinks_m_s(self) -> float:
        if not self.armed:
            return 5.0
        if self.mode == self.velocity_mode and self._lifts_to_m is not None:
            return -1.0 if self.height_m < self._lifts_to_m else 0.0
        if self.mode == self.velocity_mode:
            lifts = self.flying or self.stack is Stack.PX4
            return self._down_m_s if lifts and self.now_s - self._wanted_s <= 3.0 else 0.0
        return 0.5 if self.mode == LAND_MODE[self.stack] else 0.0


@dataclass
class Guidance:
    """Guidance as the arbiter needs it; its command is set from outside."""

    command: Command | None = None
    vehicle: VehicleStatus | None = None
    outcome: Enum | None = None
    paused: bool = False
    lands_here: bool = False
    engage: Callable[[], None] = lambda: None
    resumed: Command | None = None
    """The command after an order to begin."""
    calls: list[str] = field(default_factory=list)

    @property
    def may_begin(self) -> bool:
        return self.vehicle is not None and self.vehicle.flying is not False

    def begin(self, at: MonoNs) -> None:
        self.outcome, self.paused, self.lands_here, self.command = None, False, False, self.resumed
        self.engage()

    def stay(self, at: MonoNs) -> None:
        self.begin(at)

    def land(self, at: MonoNs) -> None:
        self.begin(at)
        self.lands_here, self.command = True, SINKS

    def hold(self, why: object = None) -> None:
        self.paused, self.lands_here, self.command = True, False, Hover()

    def abort(self) -> None:
        self.outcome, self.lands_here, self.command = FlightOutcome.ABORTED, False, Hover()

    def barred(self) -> tuple[str, bool]:
        return "a crate", True

    def overrule(self) -> None:
        self.calls.append("overrule")


_BEAT, _FAILED = mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3), int(mav.MAV_RESULT_FAILED)
PAGE = OrderSender(OrderSource.PAGE, "1")


class OrderedFlight(ABC):
    """A flight under the arbiter and the driver, 25 steps a second; its heirs step it and know who holds the vehicle."""

    patience_s, begins_after_s = 20.0, 0.5
    toy: Any
    """The autopilot."""
    guidance: Guidance
    arbiter: OperatorArbiter
    answers: list[HandledOrder]
    """Answers of the arbiter, oldest first."""
    chosen = ""
    """The mode that a person or a failsafe chose last."""
    requested = ""
    """The mode that we are requesting in this moment."""

    @property
    @abstractmethod
    def hand(self) -> Hand:
        """The holder of the vehicle by the driver."""

    @property
    @abstractmethod
    def now(self) -> MonoNs: ...

    @abstractmethod
    def step(self) -> None:
        """Run one cycle."""

    @abstractmethod
    def reach_deck(self) -> None:
        """Come to stand on the deck."""

    def order(self, order: OperatorOrder) -> str | None:
        """Give an order at the computer; return why it is refused."""
        return self.arbiter.take(order, PAGE, self.now).refusal

    def run(self, seconds: float) -> None:
        """Run that long."""
        for _ in range(round(seconds / STEP_S)):
            self.step()

    def until(self, what: Callable[[], bool]) -> None:
        """Run until something is true.

        Raises:
            TimeoutError: it does not become true.
        """
        for _ in range(round(self.patience_s / STEP_S)):
            if what():
                return
            self.step()
        raise TimeoutError(f"{self.hand}, {self.toy.mode}: it does not come about")

    def bring_to(self, hand: Hand) -> None:
        """Bring it into a state on the natural way; a take-off is only ordered."""
        guidance, toy = self.guidance, self.toy
        self.run(self.begins_after_s)
        if hand is Hand.TAKING_OFF:
            assert self.order(OperatorOrder.TAKE_OFF) is None
        if hand in (Hand.NOBODY, Hand.TAKING_OFF):
            self.until(lambda: self.hand is hand)
            return
        toy.refuses_modes = hand is Hand.TAKING
        guidance.command = STILL
        self.until(lambda: self.hand is (Hand.TAKING if hand is Hand.TAKING else Hand.OURS))
        toy.refuses_disarm = hand is Hand.STANDING
        if hand is Hand.STANDING:
            self.reach_deck()
        if hand is Hand.PERSON:
            toy.switch(PERSONS_MODE[toy.stack])
        if hand is Hand.CUT:
            assert self.order(OperatorOrder.EMERGENCY) is None
        commands = {
            Hand.LANDING: Land(), Hand.STANDING: Land(on_deck=True), Hand.HOLDING: None, Hand.LEAVING: Hover(returns=True),
        }  # fmt: skip
        guidance.command = commands.get(hand, guidance.command)
        self.until(lambda: self.hand is hand)


class Flown(OrderedFlight):
    """A toy, the driver and the arbiter, 25 steps a second.

    Args:
        late_s: time that a report is under way.
        seed: draws the phase of the HEARTBEATs, and losses.
        lost: share of our messages that do not arrive.
    """

    def __init__(
        self, stack: Stack, *, height_m: float = 5.0, late_s: float = 0.05, seed: int = 0, lost: float = 0.0, **options: object
    ) -> None:
        self.rng, self.late_s, self.lost, self.silent = Random(seed), late_s, lost, False
        self.toy: Toy = Toy(stack, height_m=height_m)
        self.streamer = SetpointStreamer(Identity(1, 1, stack, 2), AutopilotOptions("udpin://127.0.0.1:0", **options))  # type: ignore[arg-type]
        self.guidance = Guidance(engage=self.streamer.engage, resumed=STILL)
        self.arbiter = OperatorArbiter(self.guidance)
        self.answers: list[HandledOrder] = []
        self.arbiter.on_order = self.answers.append
        self.now_s = 10.0
        self.streams = Streams({"HEARTBEAT": RATES_HZ[stack]["HEARTBEAT"]})
        self._beat_s = self.now_s + BEAT_S * self.rng.random()
        self.reported: Condition | None = None
        """The newest condition that the driver has been given."""
        self.failsafes = FailsafeWatch()
        self._failing: str | None = None
        self._under_way: list[tuple[float, Condition, bool]] = []
        """Reports, each with the time at which it arrives, and whether it is a HEARTBEAT."""

    @property
    def hand(self) -> Hand:
        """The holder of the vehicle by the driver."""
        return self.streamer.hand

    @property
    def now(self) -> MonoNs:
        return MonoNs(round(1e9 * self.now_s))

    def step(self) -> None:
        """Run one cycle: reports, arbiter, driver, autopilot."""
        self.now_s += STEP_S
        toy, now, streamer = self.toy, self.now, self.streamer
        if self.now_s >= self._beat_s or toy.beats:
            self._beat_s, toy.beats = self._beat_s if toy.beats else self._beat_s + toy.each_s, False
            self._report()
        if toy.failing != self._failing:
            self._words()
        level, stamp = Rotation.identity(), Stamp(now, now, 0.001, "synced")
        streamer.on_attitude(Attitude(stamp, level, 1e-4 * np.eye(3)))
        streamer.on_position(-toy.height_m)
        while self._under_way and self._under_way[0][0] <= self.now_s and not self.silent:
            _, condition, beat = self._under_way.pop(0)
            streamer.on_condition(condition, now, beat=beat)
            self.streams.on_message(_BEAT, now)
            self.reported = condition
            taken = condition.mode if streamer.hand is Hand.PERSON and condition.armed else None
            self.guidance.vehicle = VehicleStatus(
                stamp, condition.flying, condition.mode, 0.9, streamer.motors_cut, link_ok=True, taken=taken,
                others_at=streamer.others_at,
            )  # fmt: skip
        self.arbiter.tick(now)
        command = self.arbiter.choose(now, self.guidance.command).command
        if command is not None:
            streamer.take(command, now)
        for message in (*streamer.period(now), *self.streams.due(now, (1, 1))):
            if self.rng.random() >= self.lost:
                toy.receive(message)
        for number, accepted in toy.answers:
            streamer.on_answer(number, accepted=accepted)
            self.streams.on_message(mav.MAVLink_command_ack_message(number, 0 if accepted else _FAILED), now)
        toy.answers.clear()
        toy.step(self.now_s)

    def _report(self) -> None:
        """Send a HEARTBEAT."""
        toy = self.toy
        state = mav.MAV_STATE_ACTIVE if toy.failing is None else mav.MAV_STATE_CRITICAL
        self.failsafes.on_heartbeat(mav.MAVLink_heartbeat_message(2, 3, ARMED if toy.armed else 0, 0, state, 3), self.now)
        condition = Condition(toy.mode, toy.armed, toy.flying, failsafe=self.failsafes.now)
        self._under_way.append((self.now_s + self.late_s, condition, True))

    def _words(self) -> None:
        """Name a failsafe that came: ArduCopter reports its state and mode before, and PX4 behind the text."""
        self._failing, toy = self.toy.failing, self.toy
        if toy.failing is None:
            return
        if toy.stack is Stack.ARDUPILOT:
            self._report()
        self.say(toy.failing if toy.stack is Stack.ARDUPILOT else "Failsafe activated")

    def say(self, text: str) -> None:
        """Let the autopilot send a text."""
        self.failsafes.on_text(text, self.now)
        known = self._under_way[-1][1] if self._under_way else self.reported
        if known is not None:
            self._under_way.append((self.now_s + self.late_s, replace(known, failsafe=self.failsafes.now), False))

    def sent(self, since_s: float) -> list[str]:
        """Return what our messages have asked for since then."""
        return [what for at, what in self.toy.log if at > since_s]

    def reach_deck(self) -> None:
        """Stand on the deck at once."""
        self.toy.height_m = 0.0
