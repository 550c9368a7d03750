"""Choice of the autopilot, with the setting that resolves each conflict; several behind one router, over real sockets."""

import asyncio
import logging
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from drivers.clock import SystemClock
from drivers.endpoint import Address
from drivers.mavlink import autopilot as autopilot_module
from drivers.mavlink import origins
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.origins import Origins
from drivers.mavlink.roster import FIRST_S, MOVED_S, Bound, Roster
from estimator.contracts.commands import Velocity
from estimator.contracts.errors import Recoverable
from estimator.contracts.time import NS_PER_S, MonoNs
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.make import ns
from tests.support.waiting import until

OURS = (1, 191)
SEVEN = Bound(7, silent_s=0.1, lost=False, commanded=False, several=False)


def beat(
    system: int, seconds: float, *, flies: bool = False, component: int = 1, kind: int = 2, mode: int = 5
) -> ReceivedMessage:
    message = mav.MAVLink_heartbeat_message(kind, 3, 129 if flies else 1, mode, 4 if flies else 3, 3)
    return ReceivedMessage(message, 0, ns(seconds), system, component, ("10.0.0.2", 14550 + system))


def roster_of(system_id: int = 0, vessel_id: int = 0) -> Roster:
    return Roster(AutopilotOptions("udpin://127.0.0.1:14550", system_id=system_id, vessel_id=vessel_id))


def receive(roster: Roster, until_s: float, *flying: int, since_s: float = 0.0, systems: tuple[int, ...] = (1, 7)) -> None:
    for second in range(round(since_s), round(until_s) + 1):
        for system in systems:
            roster.on_heartbeat(beat(system, float(second), flies=system in flying))


def roster_names(roster: Roster, bound: Bound | None, seconds: float) -> dict[str, bool]:
    return {one.name: one.blocks for one in roster.conflicts(bound, OURS, ns(seconds))}


@pytest.mark.hazard("H8")
@pytest.mark.parametrize("flying", [(), (1, 7)])
def test_of_two_that_fly_or_stand_nobody_is_commanded(flying: tuple[int, ...]) -> None:
    roster = roster_of()
    receive(roster, 3.0, *flying)
    (conflict,) = roster.conflicts(SEVEN, OURS, ns(3.0))
    assert conflict.blocks
    assert "system 1 " in conflict.what
    assert "system 7 " in conflict.what
    assert "vehicle.system_id (1 or 7)" in conflict.fix
    assert not roster.chosen(1, SEVEN, ns(3.0))
    assert roster_names(roster, SEVEN, 9.0) == {}, "the others are gone"


def test_the_first_that_flies_is_meant_and_not_the_first_that_is_received() -> None:
    roster = roster_of()
    assert roster.chosen(7, None, ns(0.0)), "one that is heard is listened to"
    receive(roster, 2.0, 1)
    assert roster.chosen(1, SEVEN, ns(2.0))
    one = replace(SEVEN, system=1)
    assert roster_names(roster, one, 2.0) == {"several-autopilots": False}
    receive(roster, 2.0 + FIRST_S, 1, since_s=3.0)
    receive(roster, 12.0, 1, 7, since_s=8.0)
    assert roster_names(roster, one, 12.0) == {"several-autopilots": False}, "the second to fly changes nothing"
    assert not roster.chosen(7, one, ns(12.0))
    receive(roster, 16.0, 7, since_s=13.0)
    assert not roster.chosen(7, one, ns(16.0)), "nor that the first has landed"


def test_one_that_follows_our_commands_stays_the_one_that_is_meant() -> None:
    roster = roster_of()
    flown = replace(SEVEN, commanded=True)
    roster.commanded(7)
    receive(roster, 3.0, 1, 7)
    assert roster_names(roster, flown, 3.0) == {"several-autopilots": False}
    receive(roster, 30.0, 1, since_s=4.0, systems=(1,))
    silent = replace(flown, lost=True, silent_s=27.0)
    assert not roster.chosen(1, silent, ns(30.0))
    (conflict,) = roster.conflicts(silent, OURS, ns(30.0))
    assert "vehicle.system_id (1)" in conflict.fix


def test_another_id_is_taken_when_the_autopilot_has_been_silent() -> None:
    roster = roster_of()
    receive(roster, 20.0, systems=(1,))
    early = replace(SEVEN, lost=True, silent_s=4.0)
    late = replace(early, silent_s=3.0 + MOVED_S + 0.1)
    assert not roster.chosen(1, early, ns(20.0))
    assert roster.chosen(1, late, ns(20.0))
    assert roster_names(roster, late, 20.0) == {"autopilot-id-changed": True}
    roster.on_heartbeat(beat(3, 20.0))
    assert not roster.chosen(1, late, ns(20.0)), "which of the two is its new id?"


@pytest.mark.hazard("H8")
def test_two_of_one_id_are_named_and_nobody_is_commanded() -> None:
    roster = roster_of(system_id=7)
    (conflict,) = roster.conflicts(replace(SEVEN, several=True), OURS, ns(0.0))
    assert (conflict.name, conflict.blocks) == ("autopilot-id-twice", True)
    assert "system 7" in conflict.what
    for seconds, uid in ((0.0, 0xAB), (0.0, 0xCD), (1.0, 0xAB)):
        roster.note_uid(uid, ns(seconds))
    assert roster_names(roster, SEVEN, 1.0) == {}, "one odd answer is none"
    roster.note_uid(0xCD, ns(3.0))
    (conflict,) = roster.conflicts(SEVEN, OURS, ns(3.0))
    assert "ab and cd" in conflict.what
    assert roster_names(roster, SEVEN, 30.0) == {}


def test_one_of_our_autopilots_id_elsewhere_is_named_when_it_does_other_things() -> None:
    roster = roster_of(system_id=7)
    roster.on_own_heartbeat(beat(7, 0.0, flies=True).message)
    for second in range(4):  # another path to the same one
        roster.on_elsewhere(beat(7, float(second), flies=True))
    assert roster_names(roster, SEVEN, 3.0) == {}
    for second in range(4, 7):
        roster.on_elsewhere(beat(7, float(second), mode=0))
    assert roster_names(roster, SEVEN, 7.0) == {"autopilot-id-elsewhere": False}, "it is not sent our commands"


def test_another_program_with_our_component_id_is_named() -> None:
    roster = roster_of()
    for second in (0.0, 20.0, 21.0):
        roster.on_namesake(ns(second))
    assert roster_names(roster, None, 21.0) == {}
    roster.on_namesake(ns(22.0))
    (conflict,) = roster.conflicts(None, OURS, ns(22.0))
    assert "system 1, component 191" in conflict.what
    assert "vehicle.component_id" in conflict.fix
    assert not conflict.blocks


# A case of some seconds of messages is not made smaller: its numbers say enough.
BRIEF = settings(max_examples=25, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate))


@dataclass
class Craft:
    """An autopilot that sends a heartbeat each second, an attitude 50 times and its landed state 5 times a second."""

    booted_s: float
    """Time since boot at our time 0, s."""
    landed: bool = False
    begins_s: float = 0.0
    ends_s: float = 1e9
    sequence: int = 0

    def messages(self, seconds: float) -> list[tuple[float, bytes]]:
        codec, out = Codec(1, 1, datagrams=True), []
        codec._spoken[1] = self.sequence
        for n in range(round(self.begins_s * 50), round(min(self.ends_s, seconds) * 50)):
            t = n / 50.0
            boot_ms = round(1000 * (t + self.booted_s))
            batch = [mav.MAVLink_attitude_quaternion_message(boot_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)]
            if n % 50 == round(self.begins_s * 50) % 50:
                batch.insert(0, mav.MAVLink_heartbeat_message(2, 3, 0 if self.landed else 128, 5, 3 if self.landed else 4, 3))
            if n % 10 == 0:
                batch.append(mav.MAVLink_extended_sys_state_message(0, 1 if self.landed else 2))
            out += [(t, codec.pack(message)) for message in batch]
        return out


def passed(origins: Origins, wire: list[tuple[float, bytes]], seconds: float) -> list[tuple[float, Message]]:
    """Return the messages that are passed on, with their times; waiting ones are polled as the service does."""
    codec, out = Codec(255, 1, datagrams=True), []
    ticks = [(n * 0.04, b"") for n in range(round(seconds / 0.04))]
    for t, data in sorted(wire + ticks, key=lambda one: one[0]):
        at = MonoNs(round((1000.0 + t) * NS_PER_S))
        messages = [m for got in codec.feed(data) for m in origins.sort(got, at)] if data else origins.due(at)
        out += [(t, m) for m in messages]
    return out


def kinds(messages: list[tuple[float, Message]]) -> list[str]:
    return [m.get_type() for _, m in messages]


@BRIEF
@given(
    other_s=st.floats(2.0, 4e6) | st.floats(-90.0, -2.0),
    begins_s=st.floats(0.5, 3.0),
    sequence=st.integers(0, 255),
    seed=st.integers(0, 99),
    loss=st.floats(0.0, 0.1),
)
def test_of_two_autopilots_with_one_id_only_the_first_is_passed(other_s, begins_s, sequence, seed, loss):
    flying = Craft(100.0)
    standing = Craft(100.0 + other_s, landed=True, begins_s=begins_s, sequence=sequence)
    rng, origins, seconds = np.random.default_rng(seed), Origins(), 6.0
    wire = [one for craft in (flying, standing) for one in craft.messages(seconds) if rng.random() >= loss]
    out = passed(origins, wire, seconds)
    boots_s = [1e-3 * m.time_boot_ms - t for t, m in out if m.get_type() == "ATTITUDE_QUATERNION"]
    assert np.allclose(boots_s, 100.0, atol=0.01)
    assert len(boots_s) > (1.0 - loss) * 45 * seconds
    # Its first HEARTBEAT may come with a count that continues the other's by chance; its landed state comes behind a time.
    assert all(m.landed_state == 2 for _, m in out if m.get_type() == "EXTENDED_SYS_STATE")
    assert sum(m.system_status == 3 for _, m in out if m.get_type() == "HEARTBEAT") <= 1
    assert origins.several(MonoNs(round(1006.0 * NS_PER_S)))
    assert origins.changes == 0


@pytest.mark.parametrize("gap_s", [0.0, 4.0, 30.0])
def test_one_that_boots_is_the_same_one(gap_s: float) -> None:
    origins, seconds = Origins(), 10.0 + gap_s
    wire = Craft(500.0, ends_s=3.0).messages(seconds) + Craft(-3.0 - gap_s + 2.0, begins_s=3.0 + gap_s).messages(seconds)
    out = passed(origins, wire, seconds)
    assert origins.changes == 1
    assert not origins.several(MonoNs(round((1000.0 + seconds) * NS_PER_S)))
    after = [t for t, m in out if m.get_type() == "ATTITUDE_QUATERNION" and t >= 3.0 + gap_s]
    assert after[0] <= 3.0 + gap_s + (1.1 if gap_s < 1.0 else 0.1)
    assert "HEARTBEAT" in kinds([one for one in out if one[0] >= 3.0 + gap_s])


def test_one_that_takes_the_others_place_is_accepted_late() -> None:
    """The followed one of two autopilots is switched off; the other one is no reboot of it."""
    origins = Origins()
    wire = Craft(100.0, ends_s=5.0).messages(20.0) + Craft(700.0, landed=True, begins_s=1.0).messages(20.0)
    out = passed(origins, wire, 20.0)
    taken = [t for t, m in out if m.get_type() == "ATTITUDE_QUATERNION" and m.time_boot_ms > 600_000]
    assert 14.9 < taken[0] < 15.2
    assert origins.changes == 1


@BRIEF
@given(seed=st.integers(0, 999), loss=st.floats(0.0, 0.2), late_s=st.floats(0.0, 0.1), doubled=st.booleans())
def test_one_alone_is_passed_whatever_the_network_does(seed: int, loss: float, late_s: float, doubled: bool) -> None:
    rng, origins, seconds = np.random.default_rng(seed), Origins(), 4.0
    sent = [one for one in Craft(50.0, sequence=250).messages(seconds) if rng.random() >= loss]
    wire = [(t + late_s * rng.random(), data) for t, data in sent]
    if doubled:
        wire += [(t + 2.5, data) for t, data in sent]  # by a second path that is slow
    out = passed(origins, wire, seconds + 8.0)
    assert {
        m.get_msgbuf()[4:].tobytes() if hasattr(m.get_msgbuf(), "tobytes") else bytes(m.get_msgbuf()[4:]) for _, m in out
    } == {data[4:] for _, data in sent}
    assert not origins.several(MonoNs(round((1000.0 + seconds) * NS_PER_S)))
    assert origins.changes == 0


def test_values_that_are_made_up_are_no_second_autopilot() -> None:
    origins, codec = Origins(), Codec(1, 1, datagrams=True)
    garbage = []
    for n in range(300):
        boot_ms = (0, 1, 2**31, 2**32 - 1, n * 7_919_317 % 2**32)[n % 5]
        garbage.append((3.0 + n / 100.0, codec.pack(mav.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))))
    out = passed(origins, Craft(100.0).messages(8.0) + garbage, 8.0)
    assert not origins.several(MonoNs(round(1008.0 * NS_PER_S)))
    assert sum(kind == "ATTITUDE_QUATERNION" for kind in kinds(out)) == 400


def test_heartbeats_alone_tell_a_second_autopilot() -> None:
    """One without requests sends no times: its HEARTBEATs count on their own, and lost messages clear nothing."""
    codec, origins, beats = Codec(1, 1, datagrams=True), Origins(), []
    codec._spoken[1] = 77
    for n in range(6):
        codec._spoken[1] += 20 if n == 5 else 0
        beats.append((2.0 + n, codec.pack(mav.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3))))
    out = passed(origins, Craft(100.0).messages(8.0) + beats, 8.0)
    assert sum(m.system_status == 3 for _, m in out if m.get_type() == "HEARTBEAT") <= 1
    assert origins.several(MonoNs(round(1008.0 * NS_PER_S)))
    assert not origins.several(MonoNs(round(1020.0 * NS_PER_S)))


HOST = "127.0.0.1"
AHEAD = Velocity(np.array([1.0, 0.0, 0.0]), 0.0)


class Router(asyncio.DatagramProtocol):
    """Passes datagrams from anybody to one address, and what comes from there to everybody."""

    def __init__(self, to: Address) -> None:
        self._to = to
        self._clients: set[Any] = set()
        self._transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        if addr == self._to:
            for client in self._clients:
                self._transport.sendto(data, client)
        else:
            self._clients.add(addr)
            self._transport.sendto(data, self._to)

    def send(self, data: bytes) -> None:
        """Send as one of its clients."""
        self._transport.sendto(data, self._to)


@asynccontextmanager
async def routed(kind: type[Router] = Router, **options: Any) -> AsyncIterator[tuple[Autopilot, Router, str]]:
    """Yield the service's side, a router in front of it, and the router's address for autopilots."""
    quick = {"silence_s": 0.6, "command_period_s": 0.02, "restart_first_s": 0.02, "restart_most_s": 0.1}
    async with open_autopilot(AutopilotOptions(f"udpin://{HOST}:0", **(quick | options)), SystemClock()) as autopilot:
        await until(lambda: autopilot.links.all[0].local is not None)
        local = autopilot.links.all[0].local
        assert local is not None
        loop = asyncio.get_running_loop()
        transport, router = await loop.create_datagram_endpoint(lambda: kind(local), local_addr=(HOST, 0))
        try:
            yield autopilot, router, "udpout://{}:{}".format(*transport.get_extra_info("sockname"))
        finally:
            transport.close()


class Moving(Router):
    """A router that goes on from another port when it is told to."""

    _moved: Any = None

    async def move(self) -> None:
        self._moved, _ = await asyncio.get_running_loop().create_datagram_endpoint(lambda: _Back(self), local_addr=(HOST, 0))

    def connection_lost(self, exc: Exception | None) -> None:
        if self._moved is not None:
            self._moved.close()

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        if self._moved is None:
            super().datagram_received(data, addr)
        elif addr != self._to:
            self._moved.sendto(data, self._to)

    def back(self, data: bytes) -> None:
        for client in () if self._transport.is_closing() else self._clients:
            self._transport.sendto(data, client)


class _Back(asyncio.DatagramProtocol):
    def __init__(self, router: Moving) -> None:
        self._router = router

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self._router.back(data)


def who_names(autopilot: Autopilot) -> dict[str, bool]:
    return {conflict.name: conflict.blocks for conflict in autopilot.id_conflicts}


async def test_commands_follow_an_autopilot_whose_port_moves(caplog: pytest.LogCaptureFixture) -> None:
    """The port moves as by a router's new address; a loss would need a silence of three seconds."""
    flying = MiniatureAutopilot(mode="guided")
    async with routed(Moving, silence_s=3.0) as (autopilot, router, url), flying.talking_to(url):
        assert isinstance(router, Moving)
        await until(lambda: autopilot.attitude is not None and autopilot.condition.flying is True)
        autopilot.command(AHEAD)
        await until(lambda: bool(flying.setpoints))
        await router.move()
        await until(lambda: "moved to another port" in caplog.text)
        before = len(flying.setpoints)
        autopilot.command(AHEAD)
        await until(lambda: len(flying.setpoints) > before)
        assert autopilot.connects == 1
    assert "silent for" not in caplog.text


async def test_of_two_with_one_id_the_first_is_listened_to_and_nobody_commanded(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    flying = MiniatureAutopilot(mode="guided")
    standing = MiniatureAutopilot(epoch_ns=900_000_000_000, armed=False, landed_state=1)
    async with routed() as (autopilot, _, url), AsyncExitStack() as stack:
        await stack.enter_async_context(flying.talking_to(url))
        await until(lambda: autopilot.attitude is not None and autopilot.condition.flying is True)
        autopilot.command(AHEAD)
        await until(lambda: bool(flying.setpoints))
        standing.intervals = dict(flying.intervals)  # its count alone, near the other's by chance, tells nobody apart
        time.sleep(0.7)  # noqa: ASYNC251 - the whole process stands still, which is no silence of the autopilot
        await stack.enter_async_context(standing.talking_to(url))
        await until(lambda: who_names(autopilot) == {"autopilot-id-twice": True})
        with pytest.raises(Recoverable, match=r"two autopilots have one id.*vehicle\.system_id"):
            autopilot.command(AHEAD)
        autopilot.links.send(mav.MAVLink_statustext_message(6, b"all setpoints before have arrived"))
        await until(lambda: bool(flying.of("STATUSTEXT")))
        sent, asked = len(flying.setpoints), flying.commands[511] + len(flying.of("PARAM_REQUEST_READ"))
        flights, began = set(), time.monotonic()
        for _ in range(40):
            await asyncio.sleep(0.02)
            flights.add(autopilot.condition.flying)
        assert flights == {True}
        assert len(flying.setpoints) == sent
        more = flying.commands[511] + len(flying.of("PARAM_REQUEST_READ")) - asked
        assert more <= 12.5 * (time.monotonic() - began)
        assert autopilot.connected
    assert sum("two autopilots have one id" in line for line in caplog.messages) == 1
    assert sum("connected again" in line for line in caplog.messages) == 0


async def test_of_two_that_fly_the_chosen_one_is_commanded() -> None:
    one, other = MiniatureAutopilot(system=1, mode="guided"), MiniatureAutopilot(system=2, mode="guided")
    async with routed() as (autopilot, _, url), one.talking_to(url), other.talking_to(url):
        await until(lambda: who_names(autopilot) == {"several-autopilots": True})
        with pytest.raises(Recoverable, match=r"system 1 .* system 2 .*vehicle\.system_id \(1 or 2\)"):
            autopilot.command(AHEAD)
        await asyncio.sleep(0.1)
        assert not one.setpoints
        assert not other.setpoints
    async with routed(system_id=2) as (autopilot, _, url), one.talking_to(url), other.talking_to(url):
        await until(lambda: autopilot.attitude is not None)
        assert autopilot.identity.system == 2
        autopilot.command(AHEAD)
        await until(lambda: bool(other.setpoints))
        assert not autopilot.id_conflicts


async def test_another_program_with_our_ids_is_named_and_an_echo_is_none() -> None:
    fake = MiniatureAutopilot()
    async with routed() as (autopilot, router, url), fake.talking_to(url):
        await until(lambda: autopilot.connected and autopilot.links.identity == (7, 191))
        sent = [m for m in fake.messages if m.get_srcComponent() == 191]
        for message in sent[:5]:
            router.send(bytes(message.get_msgbuf()))
        await asyncio.sleep(0.3)
        assert not autopilot.id_conflicts, "what comes back is our own"
        codec = Codec(7, 191, datagrams=True)
        codec._spoken[191] = 100
        for _ in range(4):
            router.send(codec.pack(mav.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)))
        await until(lambda: who_names(autopilot) == {"component-id-twice": False})
        autopilot.command(AHEAD)  # it is clear who is meant


async def test_requests_are_few_however_often_an_autopilot_boots(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(origins, "_REBOOT_S", 0.02)
    monkeypatch.setattr(autopilot_module, "_AGAIN_S", 0.3)
    fake = MiniatureAutopilot()
    async with routed() as (autopilot, _, url), fake.talking_to(url):
        await until(lambda: autopilot.streams is not None and autopilot.streams.settled)
        asked, rounds, began_s = fake.commands[511], autopilot.connects, fake.now_s
        for _ in range(12):
            fake.epoch_ns -= 3_000_000_000
            await asyncio.sleep(0.05)
        assert autopilot.boot_clock.restarts >= 4
        begun = autopilot.connects - rounds
        assert 0 < begun <= 1 + (fake.now_s - began_s) / 0.3
        assert asked < fake.commands[511] <= asked + begun * 12
