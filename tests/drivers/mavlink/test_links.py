"""Links over real sockets and a pseudo terminal on this host; ids count only with the link and the peer that they come from."""

import asyncio
import logging
import os
import select
import socket
import tty
from contextlib import AsyncExitStack
from typing import Any

import pytest

from drivers.clock import SystemClock
from drivers.endpoint import Endpoint, parse_endpoint
from drivers.mavlink.access import Access, AccessLevel, Named, NamedSenders, Source, parse_operators
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, TimeSyncV2, mav
from drivers.mavlink.links import LinkOptions, Links, open_links
from drivers.mavlink.options import LinkLimits
from drivers.mavlink.signing import Signing, SigningKey, SigningTimes
from estimator.contracts.errors import BadInput, Recoverable
from tests.make import ns
from tests.support.waiting import answering, until

HOST = "127.0.0.1"
ANYBODY = NamedSenders(everybody=True)


def heartbeat(kind: int = 18) -> Message:
    return mav.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3)


def quick(url: str, signing: Signing | None = None, **limits: Any) -> LinkOptions:
    quickly = LinkLimits(restart_first_s=0.02, restart_most_s=0.1, **limits)
    return LinkOptions(parse_endpoint(url), signing, quickly)


def port_of(links: Links, number: int = 0) -> int:
    address = links.all[number].local
    return address[1]


@pytest.mark.parametrize(
    ("url", "endpoint"),
    [
        ("udpin://0.0.0.0:14550", Endpoint("udpin", "0.0.0.0", 14550)),
        ("udpout://ship.local:14550", Endpoint("udpout", "ship.local", 14550)),
        ("tcp://[::1]:5760/", Endpoint("tcp", "::1", 5760)),
        ("serial:///dev/ttyAMA0:921600", Endpoint("serial", "/dev/ttyAMA0", 921600)),
    ],
)
def test_addresses_as_people_write_them(url: str, endpoint: Endpoint) -> None:
    assert parse_endpoint(url) == endpoint
    assert parse_endpoint(str(endpoint)) == endpoint


@pytest.mark.parametrize(
    "url",
    ["", "udp://1.2.3.4:1", "udpin:14550", "tcp://host", "tcp://host:0", "udpout://h:70000", "serial://ttyS0:57600",
     "serial:///dev/ttyS0", "serial:///dev/ttyS0:5", "tcp://:5760", "tcp://a:b:1", "udpout://255.255.255.255:14550",
     "udpout://239.1.2.3:14550", "udpin://[ff02::1]:14550"],
)  # fmt: skip
def test_a_wrong_address_is_bad_input_that_quotes_it(url: str) -> None:
    with pytest.raises(BadInput, match="MAVLink link"):
        parse_endpoint(url)


async def test_a_listening_link_answers_every_peer_with_its_own_sequence() -> None:
    async with open_links([quick(f"udpin://{HOST}:0")], SystemClock(), (1, 191), access=ANYBODY) as ours:
        await until(lambda: ours.all[0].local)
        url = f"udpout://{HOST}:{port_of(ours)}"
        async with (
            open_links([quick(url)], SystemClock(), (1, 1)) as autopilot,
            open_links([quick(url)], SystemClock(), (255, 190)) as station,
        ):
            await until(lambda: autopilot.send(heartbeat(2)) and station.send(heartbeat(6)))
            messages = [await ours.received.get() for _ in range(2)]
            assert {(h.system, h.component, h.message.type) for h in messages} == {(1, 1, 2), (255, 190, 6)}
            for _ in range(3):
                ours.send(heartbeat())
            for peer in (autopilot, station):
                got = [(await peer.received.get()).message for _ in range(3)]
                assert [m.get_seq() for m in got] == [0, 1, 2]
                assert (got[0].get_srcSystem(), got[0].get_srcComponent()) == (1, 191)
            assert ours.all[0].peers == 2
            assert ours.all[0].counters.as_dict()["messages"] == 2


async def test_rubbish_makes_nobody_a_peer_and_is_counted() -> None:
    async with open_links([quick(f"udpin://{HOST}:0", peers_max=2)], SystemClock(), (1, 191), access=ANYBODY) as ours:
        await until(lambda: ours.all[0].local)
        for n in range(20):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
                sock.sendto(bytes([n]) * 40, (HOST, port_of(ours)))
        await until(lambda: ours.all[0].counters.bytes_in == 800)
        assert ours.all[0].peers == 0
        assert ours.all[0].counters.codec.damaged == 20
        for n in range(4):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
                sock.sendto(Codec(n + 1, 1).pack(heartbeat()), (HOST, port_of(ours)))
                await until(lambda seen=n + 1: ours.all[0].counters.codec.messages == seen)
        assert ours.all[0].peers == 2


async def test_tcp_comes_back_when_the_server_does() -> None:
    messages: list[Message] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        codec = Codec(1, 1)
        writer.write(codec.pack(heartbeat(2)))
        messages.extend(codec.feed(await reader.read(100)))
        writer.close()

    server = AsyncExitStack()
    port = await server.enter_async_context(answering(serve))
    async with server, open_links([quick(f"tcp://{HOST}:{port}")], SystemClock(), (1, 191)) as ours:
        for _ in range(2):
            assert (await ours.received.get()).message.type == 2
            assert ours.send(heartbeat())
        await until(lambda: len(messages) == 2)
        await server.aclose()
        await until(lambda: ours.all[0].down and "nothing listens there" in ours.all[0].down)
        assert ours.opened[0] >= 2
        assert ours.all[0].counters.restarts >= 2
        assert not ours.send(heartbeat())
        assert ours.all[0].counters.dropped == 1
    assert [m.get_seq() for m in messages] == [0, 1], "the sequence goes on over a reconnection"


async def test_a_serial_port_carries_both_ways_and_its_loss_is_seen() -> None:
    master, slave = os.openpty()
    tty.setraw(master)
    codec = Codec(1, 1)
    async with open_links([quick(f"serial://{os.ttyname(slave)}:921600")], SystemClock(), (1, 191)) as ours:
        await until(lambda: ours.all[0].down is None)
        os.write(master, b"\r\n\x00" + codec.pack(heartbeat(2)))
        assert (await ours.received.get()).message.type == 2
        assert ours.send(heartbeat())
        await until(lambda: select.select([master], [], [], 0)[0])
        assert codec.feed(os.read(master, 100))[0].type == 18
        os.close(slave)
        os.close(master)
        await until(lambda: ours.all[0].counters.restarts >= 1)
        assert ours.all[0].down


async def test_several_links_at_once_and_one_of_them_missing() -> None:
    taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    taken.bind((HOST, 0))
    urls = [f"udpin://{HOST}:0", "serial:///dev/no-such-port:57600", f"udpin://{HOST}:0"]
    urls.append(f"udpin://{HOST}:{taken.getsockname()[1]}")
    async with open_links([quick(u) for u in urls], SystemClock(), (1, 191), access=ANYBODY) as ours:
        await until(lambda: ours.all[0].local and ours.all[2].local and ours.all[1].counters.restarts)
        assert "no-such-port" in (ours.all[1].down or "")
        await until(lambda: "another program" in (ours.all[3].down or ""))
        taken.close()
        await until(lambda: ours.all[3].local is not None)
        async with (
            open_links([quick(f"udpout://{HOST}:{port_of(ours, 0)}")], SystemClock(), (2, 1)) as a,
            open_links([quick(f"udpout://{HOST}:{port_of(ours, 2)}")], SystemClock(), (3, 1)) as b,
        ):
            await until(lambda: a.send(heartbeat()) and b.send(heartbeat()))
            messages = [await ours.received.get() for _ in range(2)]
            assert {(h.link, h.system) for h in messages} == {(0, 2), (2, 3)}
            ours.send(heartbeat(1), to=2)
            assert (await b.received.get()).message.type == 1
            assert len(a.received) == 0
    with pytest.raises(Recoverable, match="closed"):
        await ours.received.get()


async def test_signed_links_hear_each_other_only() -> None:
    def signing(link_id: int) -> Signing:
        return Signing(lambda: SigningKey(bytes(range(32))), SigningTimes(None), link_id)

    async with open_links([quick(f"udpin://{HOST}:0", signing=signing(0))], SystemClock(), (1, 191)) as ours:
        await until(lambda: ours.all[0].local)
        url = f"udpout://{HOST}:{port_of(ours)}"
        async with (
            open_links([quick(url)], SystemClock(), (66, 1)) as unsigned,
            open_links([quick(url, signing=signing(1))], SystemClock(), (1, 1)) as signed,
        ):
            await until(lambda: unsigned.send(heartbeat()))
            await until(lambda: ours.all[0].counters.codec.refused_signature)
            assert ours.all[0].peers == 0
            await until(lambda: signed.send(heartbeat()))
            assert (await ours.received.get()).system == 1
            ours.send(heartbeat())
            assert (await signed.received.get()).message.get_signed()
            assert len(unsigned.received) == 0


async def test_what_an_autopilot_sends_before_its_first_heartbeat_is_not_an_unknown_sender_s() -> None:
    async with open_links([quick(f"udpin://{HOST}:0")], SystemClock(), (1, 191)) as ours:
        await until(lambda: ours.all[0].local)
        counters, url = ours.all[0].counters, quick(f"udpout://{HOST}:{port_of(ours)}")
        async with open_links([url], SystemClock(), (1, 1)) as autopilot, open_links([url], SystemClock(), (255, 190)) as station:
            await until(lambda: autopilot.send(TimeSyncV2(0, 1)) and station.send(TimeSyncV2(0, 1)))
            await until(lambda: counters.unknown_senders == 2)
            autopilot.send(heartbeat())
            ours.bind_autopilot(await ours.received.get())
            assert counters.unknown_senders == 1, "that of the station"


A: Source = (0, ("10.0.0.1", 14550))
B: Source = (0, ("10.0.0.66", 14550))
CABLE: Source = (1, None)
STATION, AUTOPILOT, SHIP = (255, 190), (1, 1), (17, 1)


def level(access: Access, source: Source, ids: tuple[int, int], seconds: float = 0.0, *, signed: bool = False) -> AccessLevel:
    return access.level(source, ids, ns(seconds), asked_for=source[1] is None, signed=signed)


@pytest.mark.parametrize(
    ("access", "source", "ids", "expected"),
    [
        *((Access(NamedSenders()), A, ids, AccessLevel.UNKNOWN) for ids in (STATION, AUTOPILOT, SHIP, (66, 1))),
        (Access(NamedSenders()), CABLE, STATION, AccessLevel.PEER),
        (Access(NamedSenders(), autopilot=(A, AUTOPILOT)), A, STATION, AccessLevel.OPERATOR),
        (Access(NamedSenders(), autopilot=(A, AUTOPILOT)), B, STATION, AccessLevel.UNKNOWN),
        (Access(NamedSenders(reporters=frozenset({17}))), A, SHIP, AccessLevel.REPORTER),
        (Access(NamedSenders(reporters=frozenset({17}))), CABLE, SHIP, AccessLevel.PEER),
    ],
)
def test_by_default_nobody_may_command(access: Access, source: Source, ids: tuple[int, int], expected: AccessLevel) -> None:
    assert level(access, source, ids) is expected


@pytest.mark.parametrize("signed", [False, True])
def test_nobody_else_is_taken_for_the_autopilot(signed: bool) -> None:
    access = Access(NamedSenders((Named(1),)), autopilot=(A, AUTOPILOT))
    for elsewhere in (B, CABLE):
        assert level(access, elsewhere, AUTOPILOT, signed=signed) is AccessLevel.UNKNOWN
    assert access.refused["impostor"] == 2
    assert level(access, A, AUTOPILOT, signed=signed) is AccessLevel.OPERATOR


def test_a_named_system_is_held_to_its_peer_until_that_one_falls_silent() -> None:
    access = Access(NamedSenders((Named(255),), silence_s=30.0))
    assert level(access, A, STATION, 0.0) is AccessLevel.OPERATOR
    assert level(access, B, STATION, 1.0) is AccessLevel.UNKNOWN
    assert level(access, B, (255, 1), 2.0) is AccessLevel.UNKNOWN, "another component is no way in"
    assert level(access, A, STATION, 29.0) is AccessLevel.OPERATOR
    assert level(access, B, STATION, 58.0) is AccessLevel.UNKNOWN
    assert level(access, B, STATION, 60.0) is AccessLevel.OPERATOR
    assert access.refused["impostor"] == 3


def test_an_unknown_peer_that_stays_is_reported_once_with_the_cure(caplog: pytest.LogCaptureFixture) -> None:
    access = Access(NamedSenders())
    with caplog.at_level(logging.WARNING):
        for n in range(100):
            access.refuse_unknown(STATION, A[1], ns(0.1 * n))
        for system in range(1, 250):
            for n in range(2):
                access.refuse_unknown((system, 200), B[1], ns(20.0 + 5.0 * n))
    assert [r.getMessage() for r in caplog.records if "system 255" in r.getMessage() and "`operators`" in r.getMessage()]
    assert len(caplog.records) <= 64, "a flood of ids neither fills the log nor the memory"
    assert len(access._unknown_senders) <= 64
    assert access.refused["unknown"] == 100 + 498


def test_operators_as_people_write_them() -> None:
    assert parse_operators("") == ()
    assert parse_operators("255, 245/190") == (Named(255), Named(245, 190))
    assert [str(n) for n in parse_operators("255,1/2")] == ["255", "1/2"]
    for wrong in ("0", "256", "255/", "/1", "a", "255;1", "255,", "1/2/3", "-1"):
        with pytest.raises(BadInput, match="operator"):
            parse_operators(wrong)
