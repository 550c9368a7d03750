"""Arrival of a ship's sentences: cut anywhere, from any port of her computer, by UDP, TCP and a serial port."""

import asyncio
import os
import socket
import tty

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import SystemClock
from drivers.endpoint import Address, Endpoint, parse_endpoint
from drivers.nmea.source import HELD_S, SentenceJoiner, SentenceSource, sentences_from
from estimator.contracts.errors import Recoverable
from tests.make import ns
from tests.support.waiting import until

HOST = "127.0.0.1"
SHIP, OTHER = (HOST, 4000), ("192.0.2.7", 4000)


def sentence(body: str) -> bytes:
    check = 0
    for letter in body:
        check ^= ord(letter)
    return f"${body}*{check:02X}\r\n".encode()


sentences = st.builds(
    lambda tag, body: (rb"\s:bridge*12" b"\\" if tag else b"") + sentence(body),
    st.booleans(),
    st.text("ABCGNPRS0123456789.,", min_size=1, max_size=70),
)


@given(st.lists(st.lists(sentences, min_size=1, max_size=5), min_size=1, max_size=3), st.data())
def test_sentences_of_several_programs_are_put_together_wherever_they_are_cut(programs, data):
    joiner, now = SentenceJoiner(), 0.0
    found: dict[int, list[bytes]] = {n: [] for n in range(len(programs))}
    streams = [b"".join(one) for one in programs]
    while any(streams):
        n = data.draw(st.sampled_from([n for n, rest in enumerate(streams) if rest]))
        size = data.draw(st.integers(1, len(streams[n])))
        piece, streams[n] = streams[n][:size], streams[n][size:]
        found[n] += joiner.lines(piece, (HOST, 5000 + n), ns(now))
        now += 0.01
    assert [found[n] for n in found] == [[line.strip() for line in one] for one in programs]
    assert joiner.cut == 0


@pytest.mark.parametrize(
    "pieces",
    [
        [(0.0, b"P,1,2*00\r\n")],  # the end alone
        [(0.0, b"$GPRMC,1"), (0.1, sentence("GPHDT,1,T"))],  # the begin alone, then another
        [(0.0, b"$GPRMC,1"), (9.0, b",2*00\r\n")],  # the end comes too late
        [(0.0, b"$" + 600 * b"G")],
        [(0.0, bytes(range(128, 200)))],
    ],
)
def test_half_a_sentence_is_counted_and_no_whole_one_is_lost(pieces: list[tuple[float, bytes]]) -> None:
    joiner = SentenceJoiner()
    lines = [line for when, data in pieces for line in joiner.lines(data, SHIP, ns(when))]
    assert joiner.cut >= 1
    assert [line for line in lines if b"GPHDT" in line] == [d.strip() for _, d in pieces if b"GPHDT" in d]
    assert joiner.lines(sentence("GPHDT,2,T"), SHIP, ns(20.0)) == [sentence("GPHDT,2,T").strip()]


@given(st.lists(st.tuples(st.binary(max_size=80), st.integers(0, 40)), max_size=40))
def test_any_bytes_are_lines_or_counted_and_little_is_kept(pieces: list[tuple[bytes, int]]) -> None:
    joiner = SentenceJoiner()
    for data, port in pieces:
        for line in joiner.lines(data, (HOST, port), ns(0.0)):
            assert b"\n" not in line
    assert len(joiner._begun) <= 16


def taken(source_of: str, datagrams: list[tuple[float, Address, bytes]]) -> tuple[list[bytes], SentenceSource]:
    got: list[bytes] = []
    source = SentenceSource(source_of, lambda data, when: got.append(data))
    for when, sender, data in datagrams:
        source.take(data, ns(when), sender)
    return got, source


def test_an_address_counts_and_not_a_port() -> None:
    lines = [sentence(f"GPHDT,{n},T") for n in range(8)]
    for named in (HOST, ""):
        got, source = taken(named, [(float(n), (HOST, 4000 + n), line) for n, line in enumerate(lines)])
        assert got == [line.strip() for line in lines]
        assert not source.refused
    got, _ = taken(HOST, [(0.0, (f"::ffff:{HOST}", 4000), lines[0])])
    assert got == [lines[0].strip()], "a socket for IPv6 writes it so"


def test_another_address_is_refused_until_the_first_is_silent() -> None:
    lines = [sentence(f"GPHDT,{n},T") for n in range(4)]
    senders = [(0.0, SHIP), (1.0, OTHER), (2.0, SHIP), (2.0 + HELD_S + 0.1, OTHER)]
    got, source = taken("", [(when, sender, line) for (when, sender), line in zip(senders, lines, strict=True)])
    assert got == [line.strip() for n, line in enumerate(lines) if n != 1]
    assert source.refused == {"wrong_sender": 1}
    got, source = taken("192.0.2.9", [(when, sender, line) for (when, sender), line in zip(senders, lines, strict=True)])
    assert (got, source.refused) == ([], {"wrong_sender": 4})


async def test_sentences_arrive_by_udp_tcp_and_a_serial_port() -> None:
    got: list[bytes] = []
    source = SentenceSource("", lambda data, when: got.append(data))
    data = sentence("GPHDT,1,T") + sentence("GPHDT,2,T")

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for piece in (data[:12], data[12:]):
            writer.write(piece)
            await writer.drain()
            await asyncio.sleep(0.01)
        writer.close()

    server = await asyncio.start_server(serve, HOST, 0)
    async with (
        server,
        sentences_from(parse_endpoint(f"tcp://{HOST}:{server.sockets[0].getsockname()[1]}"), source, SystemClock()),
    ):
        await until(lambda: b"\n".join(got).count(b"GPHDT") == 2)
    far, near = os.openpty()
    tty.setraw(far)
    async with sentences_from(Endpoint("serial", os.ttyname(near), 4800), source, SystemClock()):
        os.write(far, data)
        await until(lambda: b"\n".join(got).count(b"GPHDT") == 4)
    os.close(far)
    os.close(near)
    async with sentences_from(Endpoint("udpin", HOST, 0), source, SystemClock()) as wire:
        assert wire.local is not None
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ship:
            ship.sendto(data, wire.local)
        await until(lambda: b"\n".join(got).count(b"GPHDT") == 6)
        with pytest.raises(Recoverable, match=r"vessel.nmea udpin://127.0.0.1:\d+: "):
            async with sentences_from(Endpoint("udpin", HOST, wire.local[1]), source, SystemClock()):
                pass
