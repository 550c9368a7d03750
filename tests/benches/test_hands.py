"""The bench of who has the vehicle on a program: our stand-in is flown where a real one would be."""

import pytest

from benches import hands


@pytest.mark.parametrize(("option", "stack"), [("--px4", "PX4"), ("--arducopter", "ArduPilot")])
def test_a_program_is_flown_into_a_state_and_obeys_the_cut(option: str, stack: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert hands.main([option, "stand-in", "--runs", "1", "--state", "ours", "--act", "EMERGENCY"]) == 0
    printed = capsys.readouterr().out
    assert "ours x EMERGENCY: 1 x cut" in printed
    assert "disarm forced" in printed
    assert f"{stack}: 0 disobeyed" in printed
