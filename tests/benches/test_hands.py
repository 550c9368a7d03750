"""Whoever takes the vehicle is obeyed: the bench's table with one instant for each cell, and one cell on each stand-in."""

from types import SimpleNamespace
from typing import Any

import pytest

from benches import hands
from drivers.mavlink.custody import Hand
from drivers.mavlink.vehicle import Stack


@pytest.mark.parametrize(("option", "stack"), [("--px4", "PX4"), ("--arducopter", "ArduPilot")])
def test_a_program_is_flown_into_a_state_and_obeys_the_cut(option: str, stack: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert hands.main([option, "stand-in", "--runs", "1", "--state", "ours", "--act", "EMERGENCY"]) == 0
    printed = capsys.readouterr().out
    assert "ours x EMERGENCY: 1 x cut" in printed
    assert "disarm forced" in printed
    assert f"{stack}: 0 disobeyed" in printed


@pytest.mark.hazard("H4", "H6")
@pytest.mark.parametrize("stack", [Stack.ARDUPILOT, Stack.PX4])
@pytest.mark.parametrize("state", hands.STATES)
def test_in_no_state_is_a_person_disobeyed(stack: Stack, state: str) -> None:
    """The bench's table with one instant for each cell; it draws twenty."""
    flown = {name: hands.toy(stack, state, act, 7) for name, act in hands.ACTS.items()}
    bad = {name: run for name, run in flown.items() if run is not None and not run.obeyed}
    assert bad == {}
    assert sum(run is not None for run in flown.values()) >= 5


@pytest.mark.parametrize(
    ("sent", "mode", "obeyed"),
    [
        ([(1.2, "mode guided")], "loiter", True),
        ([(1.5, "mode guided")], "loiter", False),
        ([(1.5, "disarm forced")], "loiter", True),
        ([], "guided", False),
    ],
)
def test_a_message_that_comes_too_late_or_a_mode_that_is_lost_is_disobedience(sent: Any, mode: str, obeyed: bool) -> None:
    toy = SimpleNamespace(log=sent, setpoints=[], armed=True, mode=mode)
    flown: Any = SimpleNamespace(toy=toy, hand=Hand.PERSON, chosen="loiter")
    assert hands.judged(flown, hands.ACTS["hold mode"], 1.0).obeyed is obeyed
