"""A gamepad at the service: bytes through a descriptor of the kernel's, plugged in, unplugged, and plugged in again."""

import asyncio
import fcntl
import os
import select
import struct
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from companion.base.orders import HandledOrder, OperatorOrder
from companion.guidance.pilot import make_pilot
from companion.parts.gamepad.mapping_file import mapping_of
from companion.parts.gamepad.part import GamepadPart
from companion.settings.load import load
from drivers.gamepad.device import AXES, BUTTONS, EV_ABS, EV_KEY, EV_SYN, EVENT, SYN_DROPPED, AxisRange, gamepads
from estimator.contracts.commands import Hover, Velocity
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import Stamp
from tests.support.clocks import PatientClock
from tests.support.waiting import until, wait_until

THESIS = mapping_of("thesis")


class PipeDevice:
    """A gamepad whose events come through a pipe: its other end is the person."""

    def __init__(self, name: str = "Wireless Controller") -> None:
        self.path, self.name = "/dev/input/event7", name
        self.axes = frozenset(AXES[n] for n in ("ABS_X", "ABS_Y", "ABS_RX", "ABS_RY"))
        self.buttons = frozenset(BUTTONS.values())
        self._out, self.person = os.pipe()
        os.set_blocking(self._out, False)
        self.values = dict.fromkeys(self.axes, 128)
        self.closed = False

    def fileno(self) -> int:
        return self._out

    def read(self) -> bytes:
        try:
            data = os.read(self._out, 1024)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError(19, "No such device")
        return data

    def axis(self, code: int) -> AxisRange:
        return AxisRange(self.values[code], 0, 255)

    def close(self) -> None:
        os.close(self._out)
        self.closed = True

    def say(self, *events: tuple[int, int, int]) -> None:
        os.write(self.person, b"".join(EVENT.pack(0, 0, *event) for event in events))

    def press(self, name: str) -> None:
        self.say((EV_KEY, BUTTONS[name], 1), (EV_SYN, 0, 0), (EV_KEY, BUTTONS[name], 0), (EV_SYN, 0, 0))

    def stick(self, name: str, value: int) -> None:
        self.say((EV_ABS, AXES[name], value), (EV_SYN, 0, 0))


class Rig:
    """A pilot in the air, guidance cycles, and the gamepads that are plugged in."""

    def __init__(self, wanted: str = "any") -> None:
        self.pilot = make_pilot(load("sim"))
        self.clock = PatientClock()
        self.plugged: list[PipeDevice] = []
        self.part = GamepadPart(THESIS, wanted, self.pilot, self.clock, self._find)
        self.orders: list[HandledOrder] = []
        self.pilot.operator.on_order = self.orders.append
        self.command: object = None

    def _find(self) -> Iterator[Any]:
        yield from [d for d in self.plugged if not d.closed]

    async def live(self) -> None:
        while True:
            now = self.clock.now()
            self.pilot.on_sample(VehicleStatus(Stamp(now, now, 0.001, "arrival"), True, "hovering", 0.9, False, True))
            self.command = self.pilot.decide(now).command
            await asyncio.sleep(0.01)


@asynccontextmanager
async def gamepad_rig(monkeypatch: pytest.MonkeyPatch, wanted: str = "any") -> AsyncIterator[Rig]:
    monkeypatch.setattr("companion.parts.gamepad.part._SCAN_S", 0.05)
    made = Rig(wanted)
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(made.live()), group.create_task(made.part.run())]
        yield made
        for task in tasks:
            task.cancel()


async def test_it_flies_by_hand_holds_when_unplugged_and_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    async with gamepad_rig(monkeypatch) as flown:
        pad = PipeDevice()
        flown.plugged.append(pad)
        await until(lambda: flown.part.counted()["plugged"])
        pad.stick("ABS_RY", 0)
        pad.press("BTN_TL")
        await until(lambda: isinstance(flown.command, Velocity))
        assert isinstance(flown.command, Velocity)
        assert flown.command.v_level.tolist() == [1.0, 0.0, 0.0]
        await flown.clock.sleep(0.7)
        assert isinstance(flown.command, Velocity), "a stick that is held still sends no events and is no silence"
        os.close(pad.person)
        await until(lambda: isinstance(flown.command, Hover))
        assert flown.pilot.operator.hand is None
        assert flown.pilot.paused
        assert (flown.orders[-1].order, flown.orders[-1].detail) == (OperatorOrder.HOLD, "(No such device)")
        await until(lambda: pad.closed)
        again = PipeDevice()
        flown.plugged[:] = [again]
        await until(lambda: flown.part.counted()["plugged"])
        again.stick("ABS_RY", 0)
        await asyncio.sleep(0.05)
        assert isinstance(flown.command, Hover), "it does not take the hand back by itself"
        again.press("BTN_TL")
        await until(lambda: isinstance(flown.command, Velocity))
        await asyncio.sleep(0.1)
        again.press("BTN_TL")
        await until(lambda: flown.pilot.operator.hand is None)
        assert [o.order for o in flown.orders[-2:]] == [OperatorOrder.MANUAL, OperatorOrder.RELEASE]


async def test_lost_events_are_read_again_and_the_wanted_gamepad_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    async with gamepad_rig(monkeypatch, "wireless") as flown:
        other, pad = PipeDevice("Other"), PipeDevice()
        flown.plugged += [other, pad]
        await until(lambda: flown.part.counted()["plugged"])
        assert other.closed
        pad.press("BTN_TL")
        await until(lambda: flown.pilot.operator.hand is not None)
        pad.values[AXES["ABS_RX"]] = 255
        pad.say((EV_SYN, SYN_DROPPED, 0), (EV_KEY, BUTTONS["BTN_TR"], 1), (EV_SYN, 0, 0))
        await until(lambda: isinstance(flown.command, Velocity))
        assert isinstance(flown.command, Velocity)
        assert flown.command.v_level.tolist() == [0.0, 1.0, 0.0]
        assert OperatorOrder.EMERGENCY not in [o.order for o in flown.orders]
        os.write(pad.person, b"\xff" * 240)
        for name, order in (("BTN_EAST", OperatorOrder.LAND), ("BTN_TR", OperatorOrder.EMERGENCY)):
            pad.press(name)
            await until(lambda order=order: flown.orders[-1].order is order)
            assert (flown.orders[-1].refusal or "").startswith("press it again within")
            await flown.clock.sleep(0.1)
            pad.press(name)
            await until(lambda order=order: flown.orders[-1].order is order and flown.orders[-1].accepted)
        assert "press it again within 2 s: lands where no pad is known" in str(flown.orders)


UINPUT = Path("/dev/uinput")
_UI_SET_EVBIT, _UI_SET_KEYBIT, _UI_SET_ABSBIT = 0x40045564, 0x40045565, 0x40045567
_UI_DEV_SETUP, _UI_ABS_SETUP, _UI_DEV_CREATE = 0x405C5503, 0x401C5504, 0x5501


@pytest.mark.skipif(not os.access(UINPUT, os.W_OK), reason="this machine has no /dev/uinput to make a gamepad with")
def test_a_gamepad_of_the_kernels_is_found_and_read() -> None:
    made = os.open(UINPUT, os.O_WRONLY | os.O_NONBLOCK)
    try:
        for kind in (EV_KEY, EV_ABS):
            fcntl.ioctl(made, _UI_SET_EVBIT, kind)
        for button in ("BTN_SOUTH", "BTN_TL"):
            fcntl.ioctl(made, _UI_SET_KEYBIT, BUTTONS[button])
        for axis in ("ABS_X", "ABS_Y"):
            fcntl.ioctl(made, _UI_SET_ABSBIT, AXES[axis])
            fcntl.ioctl(made, _UI_ABS_SETUP, struct.pack("Hxx6i", AXES[axis], 7, -100, 100, 0, 0, 0))
        fcntl.ioctl(made, _UI_DEV_SETUP, struct.pack("4H80sI", 3, 1, 1, 1, b"decklander test pad", 0))
        fcntl.ioctl(made, _UI_DEV_CREATE)
        wait_until(lambda: any(d.name == "decklander test pad" for d in gamepads()))
        (pad,) = [d for d in gamepads() if d.name == "decklander test pad"]
        assert pad.axis(AXES["ABS_X"])[:3] == (7, -100, 100)
        assert {AXES["ABS_X"], AXES["ABS_Y"]} == pad.axes
        os.write(made, EVENT.pack(0, 0, EV_KEY, BUTTONS["BTN_TL"], 1) + EVENT.pack(0, 0, EV_SYN, 0, 0))
        wait_until(lambda: select.select([pad], [], [], 0)[0])
        assert EVENT.unpack_from(pad.read())[2:] == (EV_KEY, BUTTONS["BTN_TL"], 1)
        os.close(made)
        made = -1
        wait_until(lambda: select.select([pad], [], [], 0)[0])
        with pytest.raises(OSError, match="No such device"):
            pad.read()
        pad.close()
    finally:
        if made >= 0:
            os.close(made)
