import numpy as np
import pytest

from companion.base.observer import Decision
from companion.facts import encode
from companion.recording import decode
from estimator.contracts.commands import Command, Hover, Land, Lean, TakeOff, Velocity
from estimator.contracts.time import MonoNs

LEAN = Lean(np.array([0.5, -0.25]), np.array([1.0, 2.0]), np.array([0.1, 0.2, 0.3]), 0.4)


@pytest.mark.parametrize("command", [Velocity(np.array([0.1, 0.2, 0.3]), 0.4), LEAN, Hover(), Land(), TakeOff(), None])
def test_every_kind_of_command_is_recorded_whole(command: Command | None) -> None:
    read = decode.command(encode.decision(Decision(MonoNs(7), "descend", command, None)))
    assert type(read) is type(command)
    if isinstance(command, Velocity | Lean) and isinstance(read, Velocity | Lean):
        assert read.v_level.tolist() == command.v_level.tolist()
        assert read.yaw_rate_rad_s == command.yaw_rate_rad_s
    if isinstance(command, Lean) and isinstance(read, Lean):
        assert read.a_level.tolist() == command.a_level.tolist()
        assert read.trim_level.tolist() == command.trim_level.tolist()


def test_a_recorded_tilt_that_lacks_a_part_is_refused() -> None:
    record = encode.decision(Decision(MonoNs(7), "descend", LEAN, None))
    record = type(record)(record.at_ns, record.phase, command=record.command, v_level=record.v_level)
    with pytest.raises(ValueError, match="lean"):
        decode.command(record)
