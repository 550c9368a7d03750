"""Closed by default: strangers receive nothing, command nothing and impersonate nobody."""

import asyncio
import logging
import socket
from collections.abc import Iterator

import pytest

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from tests.companion.mavlink.stage import AUTOPILOT, HOST, STATION, US, Border, bordered
from tests.support.clocks import PatientClock
from tests.support.waiting import until

DENIED, ACCEPTED = int(mav.MAV_RESULT_DENIED), int(mav.MAV_RESULT_ACCEPTED)
LANDED = mav.MAVLink_extended_sys_state_message(0, mav.MAV_LANDED_STATE_ON_GROUND)
FLIES = mav.MAVLink_extended_sys_state_message(0, mav.MAV_LANDED_STATE_IN_AIR)


@pytest.fixture
def stranger() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.setblocking(False)
        yield wire


def command_message(number: int, *params: float) -> Message:
    return mav.MAVLink_command_long_message(*US, number, 0, *[*params, 0, 0, 0, 0, 0, 0, 0][:7])


EVERY_COMMAND = [command_message(n) for n in (21, 193, 191, 2510, 2511, 511, 512)] + [
    mav.MAVLink_param_set_message(*US, b"PID_H_KP", 0.9, 9)
]


def setting(border: Border) -> float:
    return border.component._parameters._store.get("PID_H_KP")


@pytest.mark.hazard("H8")
async def test_an_unknown_peer_s_commands_and_parameters_are_not_obeyed(stranger: socket.socket) -> None:
    async with bordered() as border:
        before = setting(border)
        for source in ((66, 1), STATION, AUTOPILOT, US):
            await border.send(*EVERY_COMMAND, wire=stranger, source=source)
        await asyncio.sleep(0.05)
        assert border.tower.done == []
        assert setting(border) == before
        assert border.answers(stranger) == [], "not even an answer: its address may be another's"
        await border.alive()


async def test_forty_unknown_peers_receive_nothing() -> None:
    async with bordered() as border:
        wires = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(40)]
        try:
            for n, wire in enumerate(wires):
                wire.setblocking(False)
                await border.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), wire=wire, source=(100 + n, 190))
            await border.told_of_the_pad()
            assert sum(len(border.answers(wire)) for wire in wires) == 0
            assert border.links.all[0].peers == 1
        finally:
            for wire in wires:
                wire.close()


async def test_a_flood_of_unknown_peers_pushes_nothing_out_that_was_requested() -> None:
    async with bordered() as border:
        link, clock = border.links.all[0], border.autopilot._clock
        beat = Codec(66, 1).pack(mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
        text = border.codec.pack(mav.MAVLink_statustext_message(4, b"of the autopilot"))
        link._received(text, clock.now(), (HOST, border.wire.getsockname()[1]))
        for n in range(5000):  # before the reader has had a turn
            link._received(beat, clock.now(), (HOST, 20_000 + n))
        assert border.links.received.dropped == 0
        await until(lambda: len(border.links.received) == 0)
        assert [text for _, _, text in border.autopilot.texts] == ["of the autopilot"]
        await border.alive()


async def test_nobody_is_the_autopilot_from_another_port(stranger: socket.socket) -> None:
    async with bordered() as border:
        await border.send(FLIES)
        assert border.autopilot.condition.flying is True
        await border.send(LANDED, mav.MAVLink_heartbeat_message(2, 3, 0, 9, 4, 3), wire=stranger, source=AUTOPILOT)
        assert border.autopilot.condition.flying is True, "a flight does not end by what another port says"
        assert border.autopilot.condition.mode == "stabilize", "nor is its mode what another port says"
        assert border.links.access.refused["impostor"] == 2
        await border.send(LANDED)
        assert border.autopilot.condition.flying is False


async def test_an_autopilot_that_moved_is_accepted_once_it_is_silent_where_it_was(stranger: socket.socket) -> None:
    clock = PatientClock()
    async with bordered(clock=clock) as border:
        beat = mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
        await border.send(beat, FLIES)
        await border.send(beat, wire=stranger, source=AUTOPILOT)
        assert border.autopilot.connected
        assert border.links.access.autopilot[0][1] == (HOST, border.wire.getsockname()[1])
        clock.leap(10.0)
        await until(lambda: not border.autopilot.connected)
        await border.send(beat, LANDED, wire=stranger, source=AUTOPILOT)
        assert border.autopilot.connected
        assert border.autopilot.condition.flying is False
        await border.send(FLIES)
        assert border.autopilot.condition.flying is False, "and now the old port is nobody"


async def test_the_ship_s_reports_come_from_one_port(stranger: socket.socket) -> None:
    report = mav.MAVLink_global_position_int_message(4000, 0, 0, 0, 0, 150, 0, 0, 9000)
    async with bordered() as border:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ship:
            reports: list[object] = []
            border.autopilot.samples.offer_all = reports.extend  # type: ignore[method-assign, assignment]
            await border.send(report, wire=ship, source=(17, 1))
            await border.send(report, wire=stranger, source=(17, 1))
            assert [type(r).__name__ for r in reports] == ["VesselReport"]
            assert border.links.access.refused["impostor"] == 1
            assert border.answers(stranger) == []


async def test_what_a_router_forwards_from_the_autopilot_s_own_port_is_obeyed() -> None:
    async with bordered() as border:
        await border.send(command_message(193, 0), source=STATION)
        assert border.tower.done == ["hold"]


async def test_a_named_operator_is_obeyed_and_reported_from_its_first_port_alone(stranger: socket.socket) -> None:
    async with bordered(operators="255") as border:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
            station.setblocking(False)
            await border.send(command_message(193, 0), wire=station, source=STATION)
            assert border.tower.done == ["hold"]
            await border.send(command_message(191), wire=stranger, source=STATION)
            assert border.tower.done == ["hold"]
            assert (193, ACCEPTED) in {(m.command, m.result) for m in border.answers(station) if m.get_type() == "COMMAND_ACK"}
            await border.told_of_the_pad()
            assert "LANDING_TARGET" in {m.get_type() for m in border.answers(station)}
            assert border.answers(stranger) == []


async def test_a_peer_that_may_not_command_is_answered_and_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind((HOST, 0))
        station.setblocking(False)
        async with bordered(f"udpout://{HOST}:{station.getsockname()[1]}") as border:
            before = setting(border)
            await until(lambda: border.answers(station))
            with caplog.at_level(logging.WARNING):
                for message in EVERY_COMMAND * 3:
                    await border.send(message, wire=station, source=STATION, link=1)
            answers = [m for m in border.answers(station) if m.get_type() == "COMMAND_ACK"]
            assert {m.command for m in answers} == {21, 193, 191, 2510, 2511, 511, 512}
            assert {m.result for m in answers} == {DENIED}
            assert border.tower.done == []
            assert setting(border) == before
            assert border.component.refusals.counts == {"COMMAND_LONG": 21, "PARAM_SET": 3}
            reported = [r.getMessage() for r in caplog.records if "is no operator" in r.getMessage()]
            assert len(reported) == 1
            assert "vehicle.operators" in reported[0]


async def test_what_grows_by_what_is_sent_is_bounded() -> None:
    async with bordered() as border:
        for n in range(300):
            source = (1 + n % 250, 1 + n // 250)
            await border.send(command_message(512, 396), wire=border.wire, source=source)
            await border.send(mav.MAVLink_param_value_message(f"P{n}".encode(), 0.0, 9, 1, 1))
            await border.send(mav.MAVLink_param_set_message(*US, f"NO{n}".encode(), 1.0, 9))
        component, links = border.component, border.links
        assert len(component._commands._done) <= 64
        assert len(component._commands._last) <= 64
        assert len(component.texts._said) <= 65
        assert len(component.texts._waiting) <= 10
        assert all(len(peer.codec._sequences) <= 64 for peer in links.all[0]._peers.values())
        border.autopilot.parameters.values.update({f"F{n}": 0.0 for n in range(5000)})  # type: ignore[union-attr]
        await border.send(mav.MAVLink_param_value_message(b"ONE_MORE", 0.0, 9, 1, 1))
        assert "ONE_MORE" not in border.autopilot.parameters.values  # type: ignore[union-attr]
