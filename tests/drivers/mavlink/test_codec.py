"""Framing, sequence numbers, signatures: nothing on the wire raises, nothing intact is lost."""

import hashlib
import itertools
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.signing import EPOCH_S, Signing, SigningKey, SigningTimes

KEY = SigningKey(bytes(range(32)))


def attitude(n: int) -> Message:
    return mav.MAVLink_attitude_message(n, 0.1, -0.2, 0.3, 1.0, -2.0, 3.0)


def stream(count: int) -> list[bytes]:
    sender = Codec(1, 1)
    return [sender.pack(attitude(n)) for n in range(count)]


def times(messages: list[Message]) -> list[int]:
    return [m.time_boot_ms for m in messages]


def signing(link_id: int = 3, wall_s: float = EPOCH_S + 1000.0) -> Signing:
    return Signing(KEY, SigningTimes(None, lambda: wall_s), link_id)


@settings(max_examples=60)
@given(data=st.binary(max_size=300), cuts=st.lists(st.integers(0, 300), max_size=6), datagrams=st.booleans())
def test_any_bytes_cut_anywhere_never_raise(data: bytes, cuts: list[int], datagrams: bool) -> None:
    codec = Codec(1, 1, datagrams=datagrams, signing=signing())
    edges = [0, *sorted(min(c, len(data)) for c in cuts), len(data)]
    for a, b in itertools.pairwise(edges):
        codec.feed(data[a:b])


@settings(max_examples=60)
@given(
    rubbish=st.binary(max_size=40).map(lambda b: b.replace(b"\xfd", b"\x00").replace(b"\xfe", b"\x00")), cut=st.integers(1, 60)
)
def test_messages_come_out_whole_however_the_stream_is_cut(rubbish: bytes, cut: int) -> None:
    data = rubbish.join(stream(4))
    codec = Codec(1, 1)
    got = [m for i in range(0, len(data), cut) for m in codec.feed(data[i : i + cut])]
    assert times(got) == [0, 1, 2, 3]


def test_a_damaged_length_costs_no_message_but_its_own() -> None:
    frames = stream(20)
    hurt = bytearray(frames[2])
    hurt[1] = 255
    codec = Codec(1, 1)
    got = codec.feed(b"".join([*frames[:2], bytes(hurt), *frames[3:]]))
    assert times(got) == [n for n in range(20) if n != 2]
    assert codec.counters.lost == 1
    theirs = mav.MAVLink(None)
    theirs.robust_parsing = True
    parsed = theirs.parse_buffer(b"".join([*frames[:2], bytes(hurt), *frames[3:]]))
    assert sum(m.get_type() == "ATTITUDE" for m in parsed) < 19, "what framing of our own is for"


def test_an_unknown_message_is_counted_and_accepted_only_between_frames() -> None:
    frame = bytearray(stream(1)[0])
    frame[7:10] = (60_000).to_bytes(3, "little")
    codec = Codec(1, 1)
    assert codec.feed(bytes(frame) + stream(1)[0])[0].get_type() == "ATTITUDE"
    assert codec.counters.unknown == 1
    codec = Codec(1, 1)
    assert len(codec.feed(bytes(frame[:-2]) + stream(1)[0] + b"\0")) == 1


def test_mavlink_1_is_received_and_mavlink_2_is_spoken() -> None:
    old = attitude(5).pack(mav.MAVLink(None, srcSystem=1, srcComponent=1), force_mavlink1=True)
    codec = Codec(1, 1)
    assert times(codec.feed(old)) == [5]
    assert codec.counters.old_version == 1
    assert codec.pack(attitude(1))[0] == 0xFD


def test_what_does_not_fit_the_wire_is_the_callers_error() -> None:
    with pytest.raises(ValueError, match=r"ATTITUDE\.time_boot_ms does not fit"):
        Codec(1, 1).pack(mav.MAVLink_attitude_message(-1, 0, 0, 0, 0, 0, 0))


def test_the_signature_is_the_published_one() -> None:
    data = Codec(1, 1, signing=signing()).pack(attitude(1))
    assert data[2] & 1
    link, low, high = struct.unpack("<BIH", data[-13:-6])
    assert link == 3
    assert abs(low + (high << 32) - 1000 * 100_000) < 10
    assert data[-6:] == hashlib.sha256(KEY.secret + data[:-6]).digest()[:6]


def test_signed_traffic_is_received_and_anything_else_is_refused() -> None:
    sender, receiver = Codec(1, 1, signing=signing()), Codec(2, 1, signing=signing(link_id=4))
    good = sender.pack(attitude(1))
    assert times(receiver.feed(good)) == [1]
    assert receiver.feed(good) == [], "a replay"
    assert receiver.feed(Codec(1, 1).pack(attitude(2))) == [], "unsigned"
    stranger = Signing(SigningKey(bytes(32)), SigningTimes(None, lambda: EPOCH_S + 1001.0), 3)
    assert receiver.feed(Codec(9, 1, signing=stranger).pack(attitude(3))) == [], "another key"
    late = Codec(5, 1, signing=signing(wall_s=EPOCH_S + 900.0))
    assert receiver.feed(late.pack(attitude(4))) == [], "a new stream more than a minute behind"
    assert receiver.counters.refused_signature == 4
    assert times(receiver.feed(sender.pack(attitude(5)))) == [5]


def test_a_forged_time_does_not_shut_the_true_sender_out() -> None:
    sender, receiver = Codec(1, 1, signing=signing()), Codec(2, 1, signing=signing(link_id=4))
    assert receiver.feed(sender.pack(attitude(1)))
    forger = Signing(SigningKey(bytes(32)), SigningTimes(None, lambda: EPOCH_S + 9e8), 3)
    assert receiver.feed(Codec(1, 1, signing=forger).pack(attitude(2))) == []
    assert times(receiver.feed(sender.pack(attitude(3)))) == [3]


def test_a_message_that_never_ends_is_not_waited_for_with_growing_memory() -> None:
    codec = Codec(1, 1)
    for _ in range(500):
        assert codec.feed(b"\xfd\xff\x01" + bytes(2000)) == []
        assert len(codec._buffer) <= 280, "the longest message there is"
