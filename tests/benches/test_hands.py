"""The bench of who has the vehicle on a program: our stand-in is flown where a real one would be."""

import pytest

from benches import hands
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
