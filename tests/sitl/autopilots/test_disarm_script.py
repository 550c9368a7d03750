"""The Lua script for ArduCopter, run by a Lua interpreter aboard the stand-in: it disarms on deck, and never in the air."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.mavlink.vehicle import Stack
from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2
from sitl.emulators.autopilots.body import BodyState, Motors
from sitl.emulators.autopilots.stand_in.arducopter import CopterStandIn
from sitl.emulators.autopilots.stand_in.base import STEP_S
from sitl.vehicle.airframe import Airframe
from tests.sitl.autopilots.test_stand_ins import Deck

lua54 = pytest.importorskip("lupa.lua54", reason="lupa is not installed (requirements/dev.txt)")
SCRIPT = Path(__file__).parents[3] / "configs/autopilot/decklander_disarm.lua"
PERIOD_S = 0.02
_NUMBERS = {"guided": 4, "land": 9, "brake": 17, "loiter": 5, "stabilize": 0}
_HOVER = Airframe().mass_kg * G_M_S2 / Airframe().thrust_max_n


def heartbeat(component: int) -> bytes:
    """Return a received HEARTBEAT as ArduPilot hands it to a script: its own structure, little-endian and packed."""
    return struct.pack("<HBBBBBBB3sBB", 0x1234, 0xFD, 9, 0, 0, 7, 1, component, b"\0\0\0", 0, 0)


class Scripting:
    """Stand-in for ArduPilot's scripting interface, with documented functions alone."""

    def __init__(self, pilot: CopterStandIn, **parameters: float) -> None:
        self.pilot = pilot
        self.parameters = {"MOT_THST_HOVER": _HOVER, **parameters}
        self.tables: dict[int, str] = {}
        self.texts: list[str] = []
        self.received: list[bytes] = []
        self.f_body: F64 = np.array([0.0, 0.0, -G_M_S2])
        self.now_s = 0.0
        runtime = lua54.LuaRuntime(encoding=None)  # messages are bytes
        self._update: Any = None
        give: Callable[..., Any] = runtime.eval(
            b"function(millis, armed, disarm, mode, accel, throttle, get, add_table, add_param, receive, send) "
            b"  _G.millis = function() return { tofloat = function() return millis() end } end "
            b"  _G.arming = { is_armed = function() return armed() end, disarm = function() return disarm() end } "
            b"  _G.vehicle = { get_mode = function() return mode() end } "
            b"  _G.ahrs = { get_accel = function() return { z = function() return accel() end } end } "
            b"  _G.motors = { get_throttle = function() return throttle() end } "
            b"  _G.param = { get = function(_, n) return get(n) end, "
            b"    add_table = function(_, k, p, n) return add_table(k, p) end, "
            b"    add_param = function(_, k, i, n, v) return add_param(k, n, v) end } "
            b"  _G.mavlink = { init = function() end, register_rx_msgid = function(_, id) return id == 0 end, "
            b"    receive_chan = function() return receive() end } "
            b"  _G.gcs = { send_text = function(_, s, t) send(t) end } "
            b"end"
        )
        give(
            lambda: 1000.0 * self.now_s,
            lambda: pilot.armed,
            self._disarm,
            lambda: _NUMBERS[pilot.mode],
            lambda: float(self.f_body[2]),
            lambda: pilot._cascade.thrust_fraction,
            lambda name: self.parameters.get(name.decode()),
            lambda key, prefix: self.tables.setdefault(key, prefix.decode()) == prefix.decode(),
            self._add,
            lambda: self.received.pop(0) if self.received else None,
            lambda text: self.texts.append(text.decode()),
        )
        self._update, period_ms = runtime.execute(SCRIPT.read_bytes())
        assert period_ms == 1000.0 * PERIOD_S

    def run(self, s: BodyState) -> None:
        """Run the script once."""
        self.now_s, self.f_body = s.t_s, s.f_body
        self._update()

    def _add(self, key: int, name: bytes, value: float) -> bool:
        self.parameters.setdefault(self.tables[key] + name.decode(), value)
        return True

    def _disarm(self) -> bool:
        self.pilot._disarm()
        return True


def aboard(deck: Deck, **parameters: float) -> Scripting:
    """Put the script aboard; a companion's message arrives each second until `deck.silent` is set."""
    pilot = deck.pilot
    assert isinstance(pilot, CopterStandIn)
    script, fly, steps, per = Scripting(pilot, **parameters), pilot.fly, [0], round(PERIOD_S / STEP_S)

    def flown(s: BodyState) -> Motors:
        steps[0] += 1
        if steps[0] % per == 0:
            if steps[0] * STEP_S % 1.0 < PERIOD_S:
                script.received += [heartbeat(1), heartbeat(154)]
                if not getattr(deck, "silent", False):
                    script.received.append(heartbeat(191))
            script.run(s)
        return fly(s)

    pilot.fly = flown  # type: ignore[method-assign]
    return script


def on_deck(name: str, silent_at_m: float, seconds: float, **parameters: float) -> tuple[Deck, Scripting]:
    """Follow the deck down; the companion dies at a height, and its last velocity goes on for GUID_TIMEOUT."""
    deck = Deck(name, Stack.ARDUPILOT, {"GUID_TIMEOUT": 1.0})
    script = aboard(deck, **parameters)
    deck.up(1.0)
    while deck.height_m > silent_at_m:
        deck.fly(0.1, float(deck.body.v_pad_ned[2]) + 0.4)
    deck.silent = True  # type: ignore[attr-defined]
    deck.fly(seconds)
    return deck, script


def test_a_copter_that_was_left_on_deck_disarms_there() -> None:
    deck, script = on_deck("moderate", 0.2, 20.0)
    assert not deck.pilot.armed
    assert "Decklander: companion silent, on deck: disarming" in script.texts
    assert deck.body.upright
    assert deck.height_m < 0.3


@pytest.mark.parametrize("parameters", [{"DKL_ENABLE": 0.0}, {"DKL_SILENT_S": 1000.0}])
def test_without_it_the_copter_stays_armed_on_deck(parameters: dict[str, float]) -> None:
    deck, _ = on_deck("moderate", 0.2, 20.0, **parameters)
    assert deck.pilot.armed


def test_in_the_air_it_never_disarms_however_the_copter_is_thrown_about() -> None:
    deck = Deck("moderate", Stack.ARDUPILOT, {"GUID_TIMEOUT": 1.0})
    script = aboard(deck)
    deck.up(4.0)
    deck.silent = True  # type: ignore[attr-defined]
    for down_m_s in (1.5, -2.0, 1.0, -1.0, 1.5, 0.0):
        deck.fly(1.5, down_m_s)
    deck.fly(5.0)
    assert deck.pilot.armed
    assert not any("disarming" in text for text in script.texts)


def test_while_the_companion_is_received_or_somebody_else_flies_it_does_nothing() -> None:
    deck = Deck("moderate", Stack.ARDUPILOT, {"GUID_TIMEOUT": 1.0})
    aboard(deck)
    deck.up(1.0)
    while deck.height_m > 0.15:
        deck.fly(0.1, float(deck.body.v_pad_ned[2]) + 0.4)
    deck.fly(4.0, 1.0)
    assert deck.pilot.armed, "pressed to the deck by a companion that is there"
    deck.silent = True  # type: ignore[attr-defined]
    deck.mode("loiter")
    deck.fly(6.0)
    assert deck.pilot.armed, "a person has it"
