"""The script that flies our velocities on ArduPlane, aboard a stand-in for ArduPilot's documented scripting functions."""

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.setpoint import velocity_setpoint
from estimator.contracts.commands import Lean, Velocity

lua54 = pytest.importorskip("lupa.lua54", reason="lupa is not installed (requirements/dev.txt)")
SCRIPT = Path(__file__).parents[3] / "configs/autopilot/decklander_plane.lua"
GUIDED, QLOITER, STEP_S = 15, 19, 0.01


class Aboard:
    """The script with a vehicle at `at_cm` (north, east and up), in a mode."""

    def __init__(self) -> None:
        self.parameters: dict[str, float] = {"SYSID_THISMAV": 1, "Q_P_JERK_XY": 20, "Q_WP_ACCEL": 500, "Q_TRANS_DECEL": 2}
        self.mode, self.armed, self.now_s, self.at_cm, self.ids = GUIDED, True, 1.0, (0.0, 0.0, 0.0), list[int]()
        self.moved, self.matched, self.override = list[Any](), list[Any](), list[Any]()
        self._received: list[bytes] = []
        of = {
            b"ms": lambda: 1000.0 * self.now_s, b"armed": lambda: self.armed, b"mode": lambda: self.mode,
            b"at": lambda: self.at_cm, b"moved": lambda *to: self.moved.append(to), b"text": lambda t: None,
            b"matched": lambda n, e: self.matched.append((n, e)), b"get": lambda n: self.parameters.get(n.decode()),
            b"add": lambda n, v: self.parameters.setdefault("DKP_" + n.decode(), v) is not None,
            b"registered": self.ids.append, b"receive": lambda: self._received.pop(0) if self._received else None,
            b"override": lambda n, pwm: self.override.append((n, pwm)),
        }  # fmt: skip
        runtime: Any = lua54.LuaRuntime(encoding=None, unpack_returned_tuples=True)  # messages are bytes
        runtime.execute(Path(__file__).with_name("plane_scripting.lua").read_bytes())(runtime.table_from(of))
        self._update, period_ms = runtime.execute(SCRIPT.read_bytes())
        assert period_ms == 1000.0 * STEP_S
        self.run(STEP_S)

    def run(self, seconds: float, message: Message | None = None) -> None:
        """Hand on a message of ours in each period, as ArduPilot does: its structure, whose payload begins after 12 bytes."""
        packed = b"" if message is None else Codec(1, 191).pack(message)
        assert not packed or int.from_bytes(packed[7:10], "little") in self.ids
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self._received += (
                [struct.pack("<H", 0) + packed[:10] + packed[10 : 10 + packed[1]].ljust(255, b"\0")] if packed else []
            )
            self._update()


def setpoint(*v: float, turn: float = 0.0, a: tuple[float, float] | None = None, system: int = 1) -> Message:
    command = Velocity(np.array(v), turn) if a is None else Lean(np.array(a), np.zeros(2), np.array(v), turn)
    return velocity_setpoint(0, (system, 1), command, 0.0)


def test_the_goal_goes_with_the_velocity_on_a_leash_and_an_acceleration_is_a_step_of_velocity() -> None:
    craft, leans, sinks = Aboard(), Aboard(), Aboard()
    craft.run(0.5, setpoint(1.0, -0.5, 0.0))
    assert craft.moved[-1] == pytest.approx((50.0, -25.0, 0.0), abs=2.0)
    assert craft.matched[-1] == pytest.approx((1.0, -0.5))
    craft.run(5.0, setpoint(1.0, -0.5, 0.0))
    assert craft.moved[-1][:2] == pytest.approx((150.0, -150.0), abs=1.0), "1.5 m from a vehicle that does not come"
    leans.run(1.0, setpoint(0.3, 0.0, 0.0, a=(2.0, -1.0)))
    assert leans.matched[-1] == pytest.approx((0.3 + 2.0 * 0.45, -0.45), abs=1e-5), "5 m/s^2 over 20 m/s^3, and 0.2 s"
    assert leans.moved[-1][:2] == pytest.approx((0.0, 0.0), abs=1.0)
    sinks.run(STEP_S, setpoint(0.0, 0.0, 2.0))
    lead, gain, most = -sinks.moved[-1][2] / 100.0 - 2.0 * STEP_S, 1.0, 1.25  # by ArduPlane's defaults
    assert math.sqrt(2.0 * most * (lead - 0.5 * most / gain**2)) == pytest.approx(2.0, abs=0.05), "AC_PosControl's own law"


def test_silence_holds_the_place_where_it_is_and_another_mode_ends_everything() -> None:
    craft = Aboard()
    craft.run(1.0, setpoint(1.0, 0.0, 0.5, turn=0.5))
    craft.at_cm = (70.0, 0.0, -30.0)
    assert craft.override[-1][1] > 1530
    craft.run(1.0)
    assert (craft.moved[-1], craft.matched[-1], craft.override[-1]) == ((70.0, 0.0, -30.0), (0.0, 0.0), (4, 0))
    held = len(craft.moved)
    craft.run(1.0)
    assert len(craft.moved) == held, "once, and then it is GUIDED's own"
    craft.run(0.5, setpoint(1.0, 0.0, 0.0, turn=-0.5))
    steered, craft.mode = len(craft.moved), QLOITER
    assert craft.override[-1][1] < 1470
    craft.run(1.0, setpoint(1.0, 0.0, 0.0))
    assert (len(craft.moved), craft.override[-1]) == (steered, (4, 0)), "the rudder is the pilot's again"


@pytest.mark.parametrize("other", [
    setpoint(1.0, 0.0, 0.0, system=9), setpoint(90.0, 0.0, 0.0),
    mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0x05C7, *[0.0] * 3, math.nan, *[0.0] * 7),
    mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, 9, 0x05C7, *[1.0] * 11),
])  # fmt: skip
def test_what_is_no_velocity_for_it_and_a_vehicle_that_is_not_to_be_steered_move_nothing(other: Message) -> None:
    craft, off, disarmed = Aboard(), Aboard(), Aboard()
    off.parameters["DKP_ENABLE"], disarmed.armed = 0.0, False
    for one, message in ((craft, other), (off, setpoint(1.0, 0.0, 0.0)), (disarmed, setpoint(1.0, 0.0, 0.0))):
        one.run(1.0, message)
        assert one.moved == []
