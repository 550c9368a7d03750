"""The vehicle's custody: the table, to whom a mode is attributed, and random flights of arbiter, driver and toy autopilots."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from companion.base.orders import OperatorOrder
from drivers.mavlink.custody import LAPSES_S, TABLE, Hand, HandEvent, ModeRequests, markdown, whole
from drivers.mavlink.vehicle import HOLD_MODE, LAND_MODE, RETURN_MODE, VELOCITY_MODE, Condition, Stack
from estimator.contracts.commands import Command, Hover, Land, Velocity
from tests.make import ns
from tests.support.toy_autopilot import MANUAL_MODE, PERSONS_MODE, STEP_S, STILL, Flown

PAGE = Path(__file__).parents[3] / "docs/mavlink.md"
STACKS = (Stack.ARDUPILOT, Stack.PX4)


def test_the_table_is_total_and_a_wrong_one_is_refused() -> None:
    assert all(set(row) == set(HandEvent) for row in TABLE.values())
    rows = {hand: {e: t for e, t in row.items() if t is not hand} for hand, row in TABLE.items()}
    assert whole(rows) == TABLE
    for hand, wrong, why in (
        (Hand.OURS, {HandEvent.LAND: Hand.OURS}, "leads nowhere else"),
        (Hand.STANDING, {HandEvent.OTHER_MODE: Hand.NOBODY}, "must be a person's"),
        (Hand.PERSON, {HandEvent.CUT: Hand.NOBODY}, "must be cut"),
        (Hand.LANDING, {HandEvent.FAILSAFE: Hand.TAKING}, "must have the vehicle"),
    ):
        with pytest.raises(ValueError, match=why):
            whole({**rows, hand: {**rows[hand], **wrong}})
    with pytest.raises(ValueError, match="no row"):
        whole({hand: row for hand, row in rows.items() if hand is not Hand.CUT})


def test_the_page_shows_the_table() -> None:
    shown = PAGE.read_text().partition("<!-- custody -->\n")[2].partition("<!-- /custody -->")[0]
    assert shown == markdown(), "copy what python -m drivers.mavlink.custody prints"


@pytest.mark.parametrize(("modes", "ours"), [
    ("loiter !guided guided", True), ("loiter guided", False), ("loiter !guided guided loiter", False),
    ("loiter !guided guided loiter guided", False), ("loiter !guided loiter", None), ("loiter !guided +4 guided", False),
    ("guided !land !guided land", True), ("guided !land !guided land guided", True), ("guided !land !guided yes yes land", False),
    ("loiter !guided no guided", False), ("loiter !land yes loiter", None), ("loiter !land yes loiter loiter", False),
    ("loiter !land yes land", True), ("loiter !land yes loiter land", True), ("land !land yes land land land", None),
    ("guided !land yes !guided guided guided", None),
])  # fmt: skip
def test_a_mode_is_ours_once_for_each_request_and_anothers_otherwise(modes: str, ours: bool | None) -> None:
    """`!` requests a mode, `+` waits, yes and no are answers; what is said of the last report is compared."""
    requests, seconds, said = ModeRequests(), 0.0, None
    for word in modes.split():
        seconds += 0.2
        if word[0] == "!":
            requests.ask(word[1:], ns(seconds))
        elif word[0] == "+":
            seconds += float(word)
        elif word in ("yes", "no"):
            requests.on_answer(accepted=word == "yes")
        else:
            said = requests.on_mode(word, ns(seconds))
    assert said is ours


COMMANDS = (
    STILL, Velocity(np.array([0.0, 0.0, 0.4]), 0.0), Land(), Land(on_deck=True), Hover(), Hover(returns=True), None,
)  # fmt: skip
OWN_MODES = {stack: {VELOCITY_MODE[stack], LAND_MODE[stack]} for stack in STACKS}
ENDS = (OperatorOrder.HOLD, OperatorOrder.ABORT, OperatorOrder.LAND, OperatorOrder.EMERGENCY)
TAKES = (OperatorOrder.BEGIN, OperatorOrder.STAY, OperatorOrder.LAND, OperatorOrder.TAKE_OFF)


class RandomHands(RuleBasedStateMachine):
    """People, guidance and reports in any order; every message of ours is compared with what people have done."""

    @initialize(
        stack=st.sampled_from(STACKS), on_deck=st.booleans(), late_s=st.sampled_from([0.0, 0.05, 0.25]), seed=st.integers(0, 99),
        lost=st.sampled_from([0.0, 0.3]),
    )  # fmt: skip
    def begin(self, stack: Stack, on_deck: bool, late_s: float, seed: int, lost: float) -> None:
        self.flown = Flown(stack, height_m=0.0 if on_deck else 8.0, late_s=late_s, seed=seed, lost=lost)
        self.stack, self.read, self.begun = stack, 0, not on_deck
        self.mode: str | None = None
        """The mode that the person has chosen, while the vehicle is in it."""
        self.his = self.off = self.disarms = self.cut = self.climbs = False
        """He has it, and that was reported; he disarmed it, and that was reported; orders in force."""
        self.cut_s = 0.0
        self.wait(0.4)

    @rule(seconds=st.sampled_from([STEP_S, 0.2, 0.6, 2.0]))
    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            before, toy, hand = self.flown.reported, self.flown.toy, self.flown.hand
            self.flown.step()
            ours = {what for _, what in toy.log[self.read :]}
            if not self.his and (toy.mode != self.mode or f"mode {self.mode}" in ours):
                self.mode = None  # a request of ours crossed his choice
            if self.flown.reported is not before and self.flown.reported is not None:
                self._report(self.flown.reported, hand)
            self._judge()

    def _report(self, condition: Condition, hand: Hand) -> None:
        down = condition.flying is False and condition.armed is False
        if condition.mode == self.mode and hand is Hand.NOBODY:
            self.mode = None  # there was nothing to take
        self.his = (self.his or (self.mode is not None and condition.mode == self.mode)) and not down
        self.off |= self.disarms and condition.armed is False
        self.climbs &= not (self.his or self.off)
        if condition.flying is False and not self.climbs:
            self.begun, self.flown.guidance.command = False, None

    def _judge(self) -> None:
        toy, guidance = self.flown.toy, self.flown.guidance
        new, self.read = [what for _, what in toy.log[self.read :]], len(toy.log)
        if self.cut:
            assert set(new) <= {"disarm forced"}
            assert not toy.armed or self.flown.now_s - self.cut_s < (2.0 if self.flown.lost else 0.3)
            return
        assert not (self.his and new), "he has it"
        assert not self.off or not any(what in ("arm", "take off") or what.startswith("mode") for what in new)
        assert self.climbs or not {"arm", "take off"} & set(new)
        if "disarm forced" in new:
            assert guidance.command == Land(on_deck=True)
            assert self.flown.reported.mode in OWN_MODES[self.stack]

    @precondition(lambda self: self.begun and not self.flown.guidance.paused and self.flown.guidance.outcome is None)
    @rule(command=st.sampled_from(COMMANDS))
    def guide(self, command: Command | None) -> None:
        self.flown.guidance.command = command
        self.wait(0.2)

    @rule(order=st.sampled_from([*ENDS, *TAKES, OperatorOrder.RESET]))
    def order(self, order: OperatorOrder) -> None:
        if self.flown.order(order) is not None:
            return
        self.climbs = order is OperatorOrder.TAKE_OFF or (self.climbs and order not in ENDS)
        if order is OperatorOrder.EMERGENCY:
            self.cut, self.cut_s = True, self.flown.now_s
        elif order is OperatorOrder.RESET:
            self.cut, self.his = False, True
        elif order in TAKES:
            self.his = self.off = self.disarms = False
            self.mode = None
            self.begun |= order in (OperatorOrder.BEGIN, OperatorOrder.STAY)
        self.wait(STEP_S)

    @rule(modes=st.sampled_from([PERSONS_MODE, MANUAL_MODE, HOLD_MODE, LAND_MODE, RETURN_MODE, VELOCITY_MODE]))
    def switch(self, modes: dict[Stack, str]) -> None:
        mode, toy = modes[self.stack], self.flown.toy
        # The velocity mode, which no failsafe chooses, is ours while we request it.
        asked = {what for at_s, what in toy.log if self.flown.now_s - at_s < LAPSES_S + 0.5}
        ours = mode == VELOCITY_MODE[self.stack] and (f"mode {mode}" in asked or self.flown.hand is Hand.TAKING)
        if self.flown.reported is not None and mode != toy.mode and not ours:
            toy.switch(mode)
            self.mode, toy.others_stream = mode, True

    @precondition(lambda self: self.flown.toy.armed and not self.cut)
    @rule(modes=st.sampled_from([HOLD_MODE, LAND_MODE, RETURN_MODE, None]))
    def fail(self, modes: dict[Stack, str] | None) -> None:
        """A failsafe acts, also by the mode that the vehicle is in, or leaves the mode; it lasts until it is over."""
        toy = self.flown.toy
        mode = toy.mode if modes is None else modes[self.stack]
        toy.fail(mode, f"Failsafe {self.flown.now_s:.2f}")
        if mode != VELOCITY_MODE[self.stack]:
            self.mode, toy.others_stream = mode, True
        self.wait(0.6)

    @rule()
    def recover(self) -> None:
        self.flown.toy.failing = None

    @rule()
    def disarm(self) -> None:
        self.disarms |= self.flown.toy.armed
        self.flown.toy.disarm()

    @rule(refuses=st.booleans())
    def refuse(self, refuses: bool) -> None:
        self.flown.toy.refuses_modes = refuses

    @precondition(lambda self: not self.flown.silent)
    @rule(seconds=st.sampled_from([0.5, 4.0]))
    def fall_silent(self, seconds: float) -> None:
        self.flown.silent = True
        self.wait(seconds)
        self.flown.silent = False


RandomHands.TestCase.settings = settings(
    max_examples=25, stateful_step_count=20, deadline=None, suppress_health_check=list(HealthCheck)
)
TestRandomHands = pytest.mark.hazard("H4", "H6", "A7", "A8")(RandomHands.TestCase)
