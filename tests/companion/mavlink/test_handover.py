"""A landing begun by a mission's end or a return: on both stacks, once, and never against a person or a failsafe."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.base.mission import State
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.parts.mavlink.handover import MISSION, RETURN, Handover
from companion.settings.operator import HandoverOptions
from drivers.mavlink.custody import Hand
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.vehicle import RETURN_MODE, VELOCITY_MODE, Stack
from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import MonoNs
from tests.support.toy_autopilot import PERSONS_MODE, STILL, Flown

STACKS = [Stack.ARDUPILOT, Stack.PX4]
AUTO = {Stack.ARDUPILOT: "auto", Stack.PX4: "auto.mission"}


class Journeyed(Flown):
    """A toy that flies by itself, watched by the handover."""

    def __init__(self, stack: Stack, after: str = "mission or return", **options: Any) -> None:
        super().__init__(stack)
        self.sees, self.v_ned = True, np.zeros(3)
        given: Any = {"after": after, **options}
        self.handover = Handover(HandoverOptions(**given), self.pilot(), self._begin)
        self.begun: list[str] = []
        self.state, self.refuses = State.READY, False
        self.run(1.0)

    def pilot(self) -> Any:
        flown = self

        class Pilot:
            operator = flown.arbiter

            @property
            def state(self) -> State:
                return flown.state if flown.guidance.command is None else State.DESCEND

            def belief(self, now: Any) -> RelativeState | None:
                d = np.array([0.1, 0.2, flown.toy.height_m])
                state = RelativeState(now, "ekf", d, np.zeros(3), 0.0, np.eye(7) * 1e-4, now, True)
                return state if flown.sees else None

        return Pilot()

    def _begin(self, name: str, given_at: MonoNs) -> str | None:
        self.begun.append(name)
        if self.refuses:
            return "refused"
        sender = OrderSender(OrderSource.HANDOVER, name)
        return self.arbiter.take(OperatorOrder.BEGIN, sender, self.now, given_at=given_at).refusal

    def say_to(self, message: Message) -> None:
        """Let the autopilot report this."""
        autopilot: Any = SimpleNamespace(
            is_own=lambda received: True, streams=self.streams, streamer=self.streamer, unclear=None, condition=self.reported,
            positions=(SimpleNamespace(v_body_ned=self.v_ned),),
        )  # fmt: skip
        heard: Any = SimpleNamespace(message=message, received_at=self.now)
        self.handover.on_message(autopilot, heard)

    def step(self) -> None:
        super().step()
        if self.reported is not None:
            self.say_to(mav.MAVLink_heartbeat_message(2, 3, 128, 0, 4, 3))
            self.say_to(mav.MAVLink_local_position_ned_message(0, 0, 0, 0, 0, 0, 0))

    def goes(self, mode: str, seconds: float = 4.0) -> list[str]:
        """Let somebody choose a mode, and return what was begun some seconds later."""
        self.toy.switch(mode)
        self.run(seconds)
        return self.begun

    def mission(self) -> list[str]:
        """Fly a mission of three items to its end."""
        stack = self.toy.stack
        states = {Stack.ARDUPILOT: (5, 3, 3, 5), Stack.PX4: (0, 0, 0, 0)}[stack]
        self.goes(AUTO[stack], 1.5)
        for item, state in zip((2, 0, 2, 2), states, strict=True):
            self.say_to(mav.MAVLink_mission_current_message(item, 3, state))
            self.run(1.5)
        self.say_to(mav.MAVLink_mission_item_reached_message(2))
        return self.goes("auto.loiter" if stack is Stack.PX4 else "auto")


@pytest.mark.hazard("H6")
@pytest.mark.parametrize("stack", STACKS)
def test_a_missions_end_and_a_return_begin_once_and_the_pilot_wins_at_once(stack: Stack) -> None:
    for flown, journey in ((Journeyed(stack), RETURN), (Journeyed(stack), MISSION)):
        assert (flown.goes(RETURN_MODE[stack]) if journey is RETURN else flown.mission()) == [journey]
        flown.until(lambda f=flown: f.hand is Hand.OURS)
        assert flown.toy.mode == VELOCITY_MODE[stack]
        assert str(flown.answers[-1]) == f"handover {journey}: begin: accepted"
        flown.toy.switch(PERSONS_MODE[stack])
        flown.until(lambda f=flown: f.hand is Hand.PERSON)
        flown.guidance.command = None
        since_s = flown.now_s
        assert flown.goes(RETURN_MODE[stack], 10.0) == [journey], "a return by which a person took the vehicle is theirs"
        assert flown.sent(since_s) == []


@pytest.mark.hazard("H6")
@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize(
    "why", ["critical", "late words", "fence", "unseen", "low", "fast", "climbs", "held", "ordered", "begun", "off"]
)
def test_nothing_begins_against_a_failsafe_a_person_or_without_the_pad(stack: Stack, why: str) -> None:
    flown = Journeyed(stack, "mission" if why == "off" else "mission or return")
    flown.sees = why != "unseen"
    if why == "critical":
        flown.toy.failing = "Battery Failsafe"
    if why == "fence":
        flown.say("Polygon fence breached")
    flown.v_ned = np.array({"fast": [2.0, 0.0, 0.0], "climbs": [0.0, 0.0, -1.0]}.get(why, [0.0, 0.0, 0.0]))
    flown.toy.height_m = 1.5 if why == "low" else 5.0
    if why == "held":
        assert flown.order(OperatorOrder.HOLD) is None
        flown.guidance.command = None
    flown.state = State.SEARCH if why == "begun" else State.READY
    if why == "ordered":
        flown.guidance.command = STILL
    flown.goes(RETURN_MODE[stack], 1.5)
    if why == "late words":
        flown.say("GCS Failsafe")
    flown.toy.failing = None  # a failsafe that passes has chosen the return all the same
    assert flown.goes(RETURN_MODE[stack]) == []
    if why in ("critical", "fence"):
        explicit = Journeyed(stack, failsafe=True)
        explicit.toy.failing = "Battery Failsafe"
        assert explicit.goes(RETURN_MODE[stack]) == [RETURN], "the settings say so of a failsafe too"


@pytest.mark.parametrize("stack", STACKS)
def test_a_return_whose_beginning_nobody_saw_and_a_mission_left_by_a_person_begin_nothing(stack: Stack) -> None:
    flown = Journeyed(stack)
    flown.reported, flown.silent = None, True
    flown.toy.switch(RETURN_MODE[stack])
    flown.run(5.0)
    flown.silent = False
    assert flown.goes(RETURN_MODE[stack]) == []
    left = Journeyed(stack)
    left.goes(AUTO[stack])
    left.say_to(mav.MAVLink_mission_current_message(1, 3, 3))
    left.say_to(mav.MAVLink_mission_item_reached_message(1))
    assert left.goes("auto.loiter" if stack is Stack.PX4 else "loiter") == []
    left.goes(AUTO[stack])
    for _ in range(5):  # PX4 repeats the last item, and a person chooses Hold later
        left.say_to(mav.MAVLink_mission_item_reached_message(2))
        left.run(1.0)
    assert left.goes("auto.loiter" if stack is Stack.PX4 else "loiter") == []


def test_a_refused_handover_is_not_repeated() -> None:
    flown = Journeyed(Stack.ARDUPILOT)
    flown.refuses = True
    assert flown.goes(RETURN_MODE[Stack.ARDUPILOT], 8.0) == [RETURN]
