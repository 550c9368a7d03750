"""Framing, sequence numbers, signatures, messages of our own, long texts: nothing on the wire raises, nothing intact is lost."""

import errno
import hashlib
import itertools
import json
import struct
import xml.etree.ElementTree as Xml
from pathlib import Path

import pymavlink
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.settings.files import signing_key
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, TargetRelative, TimeSyncV2, crc_extra_of, mav
from drivers.mavlink.joined_texts import CHUNK, LOST, JoinedTexts
from drivers.mavlink.requests import Parameters, RateLimit, Streams, VersionRequest, is_for, parameter_value, wire_value
from drivers.mavlink.signing import EPOCH_S, TICKS_PER_S, Signing, SigningKey, SigningTimes
from drivers.mavlink.vehicle import Stack
from estimator.contracts.errors import BadInput
from tests.make import ns

KEY = SigningKey(bytes(range(32)))


def attitude_message(n: int) -> Message:
    return mav.MAVLink_attitude_message(n, 0.1, -0.2, 0.3, 1.0, -2.0, 3.0)


def stream(count: int) -> list[bytes]:
    sender = Codec(1, 1)
    return [sender.pack(attitude_message(n)) for n in range(count)]


def times(messages: list[Message]) -> list[int]:
    return [m.time_boot_ms for m in messages]


def signing(link_id: int = 3, wall_s: float = EPOCH_S + 1000.0) -> Signing:
    return Signing(lambda: KEY, SigningTimes(None, lambda: wall_s), link_id)


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
    old = attitude_message(5).pack(mav.MAVLink(None, srcSystem=1, srcComponent=1), force_mavlink1=True)
    assert times(codec.feed(old)) == [5]
    assert codec.counters.old_version == 1
    with pytest.raises(ValueError, match=r"ATTITUDE\.time_boot_ms does not fit"):
        codec.pack(mav.MAVLink_attitude_message(-1, 0, 0, 0, 0, 0, 0))
    codec = Codec(1, 1)
    assert len(codec.feed(bytes(frame[:-2]) + stream(1)[0] + b"\0")) == 1


def test_the_signature_is_the_published_one() -> None:
    data = Codec(1, 1, signing=signing()).pack(attitude_message(1))
    keyless = Codec(2, 1)
    keyless.feed(data + Codec(1, 1).pack(attitude_message(2)))
    assert (keyless.counters.messages, keyless.counters.with_signature) == (2, 1), "who has no key sees that another signs"
    assert data[2] & 1
    link, low, high = struct.unpack("<BIH", data[-13:-6])
    assert link == 3
    assert abs(low + (high << 32) - 1000 * 100_000) < 10
    assert data[-6:] == hashlib.sha256(KEY.secret + data[:-6]).digest()[:6]


def test_signed_traffic_is_received_and_anything_else_is_refused() -> None:
    sender, receiver = Codec(1, 1, signing=signing()), Codec(2, 1, signing=signing(link_id=4))
    good = sender.pack(attitude_message(1))
    assert times(receiver.feed(good)) == [1]
    assert receiver.feed(good) == [], "a replay"
    assert receiver.feed(Codec(1, 1).pack(attitude_message(2))) == [], "unsigned"
    stranger = Signing(lambda: SigningKey(bytes(32)), SigningTimes(None, lambda: EPOCH_S + 1001.0), 3)
    assert receiver.feed(Codec(9, 1, signing=stranger).pack(attitude_message(3))) == [], "another key"
    late = Codec(5, 1, signing=signing(wall_s=EPOCH_S + 900.0))
    assert receiver.feed(late.pack(attitude_message(4))) == [], "a new stream more than a minute behind"
    assert receiver.counters.refused_signature == 4
    assert times(receiver.feed(sender.pack(attitude_message(5)))) == [5]


def test_a_forged_time_does_not_shut_the_true_sender_out() -> None:
    sender, receiver = Codec(1, 1, signing=signing()), Codec(2, 1, signing=signing(link_id=4))
    assert receiver.feed(sender.pack(attitude_message(1)))
    forger = Signing(lambda: SigningKey(bytes(32)), SigningTimes(None, lambda: EPOCH_S + 9e8), 3)
    assert receiver.feed(Codec(1, 1, signing=forger).pack(attitude_message(2))) == []
    assert times(receiver.feed(sender.pack(attitude_message(3)))) == [3]


def test_a_message_that_never_ends_is_not_waited_for_with_growing_memory() -> None:
    codec = Codec(1, 1)
    for _ in range(500):
        assert codec.feed(b"\xfd\xff\x01" + bytes(2000)) == []
        assert len(codec._buffer) <= 280, "the longest message there is"


DEFINITIONS = Path(pymavlink.__file__).parent / "dialects/v20"


def test_the_crc_seed_of_every_message_of_common_comes_out_as_generated() -> None:
    checked = 0
    for file in ("common.xml", "standard.xml", "minimal.xml"):
        for message in Xml.parse(DEFINITIONS / file).getroot().iter("message"):
            fields: list[tuple[str, str]] = []
            for child in message:
                if child.tag == "extensions":
                    break
                if child.tag == "field":
                    fields.append((child.attrib["type"].replace("_mavlink_version", ""), child.attrib["name"]))
            generated = mav.mavlink_map[int(message.attrib["id"])]
            assert crc_extra_of(message.attrib["name"], fields) == generated.crc_extra, message.attrib["name"]
            checked += 1
    assert checked > 200


def test_a_defined_message_crosses_the_wire_field_by_field() -> None:
    sent = TargetRelative(
        timestamp=2**40 + 5, id=3, frame=1, x=1.5, y=-2.25, z=3.125, pos_std=[0.25, 0.5, 0.75], yaw_std=0.125,
        q_target=[1.0, 2.0, 3.0, 4.0], q_sensor=[5.0, 6.0, 7.0, 8.0], type=3,
    )  # fmt: skip
    data = Codec(7, 191).pack(sent)
    (got,) = Codec(1, 1).feed(data)
    assert got.to_dict() == sent.to_dict()
    assert data[10:30].hex() == "0500000000010000" + "0000c03f" + "000010c0" + "00004840", "uint64 first, then the floats"


def test_timesync_has_targets_and_receives_those_without() -> None:
    assert TimeSyncV2.crc_extra == 34
    data = Codec(1, 1).pack(TimeSyncV2(5, -6, 7, 191))
    (got,) = Codec(1, 1).feed(data)
    assert (got.tc1, got.ts1, got.target_system, got.target_component) == (5, -6, 7, 191)
    (old,) = Codec(1, 1).feed(Codec(1, 1).pack(mav.MAVLink_timesync_message(5, 6)))
    assert (old.tc1, old.ts1, old.target_system, old.target_component) == (5, 6, 0, 0)


PX4, COPTER = (1, 1), (2, 1)


def chunks(text: str, number: int) -> list[Message]:
    """Return the chunks as an autopilot sends them: a full last chunk is followed by an empty one."""
    return [
        mav.MAVLink_statustext_message(2, text[k * CHUNK : (k + 1) * CHUNK].encode(), number, k)
        for k in range(len(text) // CHUNK + 1)
    ]


def joined(message: Message) -> Message:
    """Return the texts after a passage through the wire."""
    sender = mav.MAVLink(None, srcSystem=1, srcComponent=1)
    return mav.MAVLink(None).decode(bytearray(message.pack(sender)))


@given(st.lists(st.text("abcdefgh ", min_size=0, max_size=220), min_size=1, max_size=6))
def test_texts_of_two_senders_come_out_as_they_were(words: list[str]) -> None:
    texts, out = JoinedTexts(), []
    streams = [[joined(m) for n, w in enumerate(words, 1) for m in chunks(w, n)] for _ in (PX4, COPTER)]
    for pair in zip(*streams, strict=True):
        for sender, message in zip((PX4, COPTER), pair, strict=True):
            out += [(sender, text) for _, text in texts.on_message(message, sender)]
    for sender in (PX4, COPTER):
        assert [text for who, text in out if who == sender] == words


def test_a_lost_chunk_leaves_a_mark_and_costs_no_other_text() -> None:
    a, b, c = (joined(m) for m in chunks("x" * 50 + "y" * 50 + "z", 3))
    assert JoinedTexts().on_message(c, PX4) == [(2, f"{LOST}{LOST}z")]
    texts = JoinedTexts()
    texts.on_message(a, PX4)
    assert texts.on_message(c, PX4) == [(2, "x" * 50 + LOST + "z")]
    texts.on_message(a, PX4)
    texts.on_message(b, PX4)
    plain = joined(mav.MAVLink_statustext_message(6, b"armed"))
    assert texts.on_message(plain, PX4) == [(2, "x" * 50 + "y" * 50 + LOST), (6, "armed")]
    assert texts.on_message(plain, PX4) == [(6, "armed")]


TARGET = (7, 1)


def ack(result: int = 0) -> Message:
    return mav.MAVLink_command_ack_message(mav.MAV_CMD_SET_MESSAGE_INTERVAL, result)


def test_one_stream_at_a_time_since_the_answer_does_not_say_which() -> None:
    streams = Streams({"ATTITUDE_QUATERNION": 100.0, "LOCAL_POSITION_NED": 50.0})
    (first,) = streams.due(ns(0), TARGET)
    assert (first.param1, first.param2, first.command) == (31, 10_000, 511)
    assert streams.due(ns(0.1), TARGET) == []
    streams.on_message(ack(), ns(0.2))
    (second,) = streams.due(ns(0.2), TARGET)
    assert (second.param1, second.param2) == (32, 20_000)
    streams.on_message(ack(2), ns(0.3))
    assert streams.due(ns(1), TARGET) == []
    assert streams.settled
    assert streams.refused == {"LOCAL_POSITION_NED": 2}


def test_where_the_quaternion_is_refused_the_angles_are_requested() -> None:
    streams = Streams({"ATTITUDE_QUATERNION": 100.0, "RAW_IMU": 50.0})
    streams.due(ns(0), TARGET)
    streams.on_message(ack(4), ns(0.1))
    asked = []
    for n in (1, 2):
        (request,) = streams.due(ns(0.2 * n), TARGET)
        asked.append((request.param1, request.param2))
        streams.on_message(ack(), ns(0.2 * n + 0.1))
    assert asked == [(27, 20_000), (30, 10_000)]
    assert streams.settled
    assert streams.refused == {"ATTITUDE_QUATERNION": 4}
    streams.restart()
    assert not streams.settled


def test_an_unanswered_request_is_repeated_with_a_growing_pause_for_ever() -> None:
    streams, asked = Streams({"RAW_IMU": 100.0}, tries=3), []
    for n in range(4000):
        asked += [0.1 * n for _ in streams.due(ns(0.1 * n), TARGET)]
        if n == 12:
            assert streams.refused == {"RAW_IMU": -1}
    gaps = [b - a for a, b in itertools.pairwise(asked)]
    assert gaps[:3] == pytest.approx([0.5, 0.5, 0.5])
    assert gaps == sorted(gaps)
    assert gaps[-1] == pytest.approx(30.0)
    streams.restart()
    assert len(streams.due(ns(400), TARGET)) == 1


def test_a_stream_that_another_station_slows_or_stops_is_requested_again_and_that_is_logged_once(caplog):
    streams, requests, each, obeys = Streams({"RAW_IMU": 100.0}), [], 1, True
    for n in range(12_000):
        now = ns(0.01 * n)
        if n in (2000, 6000):
            each, obeys = (25, False) if n == 2000 else (10**9, True)
        if streams.due(now, TARGET):
            requests.append(0.01 * n)
            streams.on_message(ack(0 if obeys else 4), now)
            each = 1 if obeys else each
        if n % each == 0:
            streams.on_message(mav.MAVLink_raw_imu_message(0, 0, 0, 0, 0, 0, 0, 0, 0, 0), now)
    assert requests[0] == 0.0
    assert 20.0 < requests[1] < 25.0, "slowed"
    assert 3 <= len(requests) <= 8, "refused now, and requested with a growing pause until it is granted"
    assert streams.refused == {}, "stopped, requested and granted"
    assert caplog.text.count("arrives at") == 1


@pytest.mark.parametrize(("target", "ours"), [((1, 191), True), ((0, 0), True), ((255, 190), False), ((1, 190), False)])
def test_an_acknowledgement_counts_for_the_program_that_it_names(target: tuple[int, int], ours: bool) -> None:
    assert is_for(mav.MAVLink_command_ack_message(511, 0, 0, 0, *target), (1, 191)) is ours


@pytest.mark.parametrize(("result", "each_s", "most_s"), [(4, 1.0, 0.2), (0, 1.0, 0.32), (0, 0.2, 0.2)])
def test_the_mode_is_polled_where_its_reports_come_less_often_than_asked(result: int, each_s: float, most_s: float) -> None:
    """PX4 refuses HEARTBEAT more often than once a second, and answers the request for one; ArduPilot sends them as asked."""
    streams, arrivals, polls, begins_s = Streams({"HEARTBEAT": 5.0, "RAW_IMU": 100.0}), [0.0], 0, 10.0
    for n in range(1, 251):
        now_s = begins_s + 0.02 * n
        asked = streams.due(ns(now_s), TARGET)
        streams.on_message(mav.MAVLink_command_ack_message(mav.MAV_CMD_REQUEST_MESSAGE, 2), ns(now_s))  # no answer to a stream
        for m in asked:
            if m.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
                streams.on_message(ack(result if m.param1 == 0 else 0), ns(now_s))
        polled = [m for m in asked if m.command == mav.MAV_CMD_REQUEST_MESSAGE]
        assert all(m.param1 == 0 for m in polled)
        if polled or n % round(each_s / 0.02) == 0:
            streams.on_message(mav.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3), ns(now_s))
            arrivals.append(0.02 * n)
            polls += len(polled)
    assert max(b - a for a, b in itertools.pairwise(arrivals)) <= most_s + 0.02
    assert polls == 0 if each_s < 1.0 else 10 <= polls <= 32
    assert streams.refused == ({"HEARTBEAT": 4} if result else {})


def value(name: str, number: float, kind: int = 9) -> Message:
    return mav.MAVLink_param_value_message(name.encode(), number, kind, 900, 65535)


def test_parameters_are_read_a_few_at_a_time() -> None:
    names = [f"PLND_{n}" for n in range(6)]
    reader = Parameters(Stack.ARDUPILOT, names, at_once=2, tries=2)
    assert [m.param_id for m in reader.due(ns(0), TARGET)] == names[:2]
    reader.on_message(value("PLND_0", 0.5))
    assert [m.param_id for m in reader.due(ns(0.1), TARGET)] == [names[2]]
    for n in range(1, 120):
        for m in reader.due(ns(0.1 * n), TARGET):
            if m.param_id != "PLND_3":
                reader.on_message(value(m.param_id, 2.0))
    assert reader.settled
    assert reader.absent == {"PLND_3"}
    assert reader.values["PLND_0"] == 0.5
    (again,) = [m for n in range(120, 400) for m in reader.due(ns(0.1 * n), TARGET)][:1]
    assert again.param_id == "PLND_3", "the way up may come later"
    assert reader.settled
    reader.on_message(value("PLND_3", 1.0))
    assert reader.absent == set()
    reader.request(["PLND_3"])
    assert not reader.settled


@pytest.mark.parametrize(("value", "kind"), [(245, 6), (-1, 6), (-3, 2), (200, 1), (4_000_000_000, 5), (0.25, 9)])
def test_a_parameter_comes_back_as_it_was_set(value: float, kind: int) -> None:
    for stack in (Stack.PX4, Stack.ARDUPILOT):
        sent = mav.MAVLink_param_set_message(1, 1, b"NAME", wire_value(stack, value, kind), kind)
        (wire,) = struct.unpack("<f", struct.pack("<f", sent.param_value))
        assert parameter_value(stack, wire, kind) == pytest.approx(value, rel=1e-7)
    assert wire_value(Stack.PX4, -7, 6) == pytest.approx(struct.unpack("<f", struct.pack("<i", -7))[0], nan_ok=True), "as bytes"


@pytest.mark.parametrize(("value", "kind"), [(0.5, 6), (300, 1), (-1, 5)])
def test_what_does_not_fit_an_integer_is_refused(value: float, kind: int) -> None:
    with pytest.raises(ValueError, match=r"integer|does not fit"):
        wire_value(Stack.PX4, value, kind)


def test_requests_are_bounded_in_rate_whatever_is_requested() -> None:
    limit, sent = RateLimit(20.0, 100), 0
    for tick in range(250):  # 10 s
        while limit.allows(ns(0.04 * tick)):
            limit.spend(4)
            sent += 4
    assert 280 <= sent <= 310
    assert limit.allows(ns(1000.0)), "after a pause"


def test_the_version_is_requested_until_it_is_answered_with_a_growing_pause() -> None:
    request = VersionRequest()
    asked = [t for t in range(60) if request.due(ns(float(t)), (1, 1))]
    assert asked == [0, 2, 4, 6, 8, 12, 20, 36]
    request = VersionRequest()
    (message,) = request.due(ns(0.0), (7, 1))
    assert (message.target_system, message.command, message.param1) == (7, 512, 148)
    request.answered = True
    assert not any(request.due(ns(float(t)), (7, 1)) for t in range(10))


SECRET = bytes(range(100, 132))


@pytest.mark.parametrize(
    ("content", "mode", "named", "found"),
    [
        (SECRET, 0o600, "", SECRET), (SECRET.hex().encode(), 0o600, "", SECRET), (SECRET, 0o400, "credential:key", SECRET),
        (SECRET.hex().upper().encode() + b"\n", 0o600, "", SECRET),
        (b"passphrase: sea and sky\n", 0o600, "", hashlib.sha256(b"sea and sky").digest()),
        (SECRET, 0o440, "credential:key", SECRET),  # as systemd's access list for a dynamic user shows
        (SECRET, 0o644, "", "chmod 600"), (b"short and secret", 0o600, "", "neither 32 bytes"), (b"", 0o600, "", "neither"),
        (SECRET, 0o600, "credential:../key", "does not name a credential"), (SECRET, 0o600, "/nowhere/key", "No such file"),
        (SECRET, 0o600, "/dev/zero", "not a file, but a device"),
    ],
)  # fmt: skip
def test_a_key_is_of_three_forms_and_what_is_none_is_named_and_not_shown(tmp_path, content, mode, named, found):
    (file := tmp_path / "key").write_bytes(content)
    file.chmod(mode)
    environment = {"CREDENTIALS_DIRECTORY": str(tmp_path)}
    if isinstance(found, bytes):
        assert signing_key(named or str(file), environment=environment).secret == found
        return
    with pytest.raises(BadInput, match=found) as raised:
        signing_key(named or str(file), environment=environment)
    assert "secret" not in str(raised.value)


def test_time_follows_the_wall_and_never_repeats() -> None:
    wall = [EPOCH_S + 10.0]
    time = SigningTimes(None, lambda: wall[0])
    first = time.next()
    assert first == 10 * TICKS_PER_S
    assert time.next() == first + 1
    wall[0] += 1
    assert time.next() == 11 * TICKS_PER_S
    wall[0] -= 100
    assert time.next() == 11 * TICKS_PER_S + 1, "a wall clock set back"
    time.note_received(10**9)
    assert time.next() == 10**9 + 1
    time.note_received(2**48 - 1)
    assert time.next() == 10**9 + 2, "who says the last time there is does not silence us"


def crossing(times: SigningTimes, messages: list[bytes]) -> int:
    """Return the number of these that a link with these times accepts."""
    codec = Codec(1, 191, datagrams=True, signing=Signing(lambda: SigningKey(SECRET), times, 0))
    return sum(len(codec.feed(message)) for message in messages)


def signed(wall_s: float, count: int = 3, system: int = 1) -> list[bytes]:
    sender = Codec(system, 1, signing=Signing(lambda: SigningKey(SECRET), SigningTimes(None, lambda: wall_s), 7))
    return [sender.pack(mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)) for _ in range(count)]


def test_what_was_received_before_a_restart_cannot_be_played_again_after_it(tmp_path: Path) -> None:
    path, now_s = tmp_path / "times", EPOCH_S + 5000.0
    captured = signed(now_s)
    before = SigningTimes(path, lambda: now_s)
    assert crossing(before, captured) == 3
    used = before.next()
    before.close()
    assert SigningTimes(path, lambda: now_s - 4000.0).next() > used, "a clock that was set back goes on after the last time"
    after = SigningTimes(path, lambda: now_s + 40.0)
    assert crossing(after, captured) == 0
    assert crossing(after, signed(now_s + 40.0)) == 3


def test_without_a_file_nothing_older_than_a_minute_is_accepted(tmp_path: Path) -> None:
    now_s = EPOCH_S + 5000.0
    for times in (SigningTimes(None, lambda: now_s), SigningTimes(tmp_path / "none yet", lambda: now_s)):
        assert crossing(times, signed(now_s - 61.0)) == 0
        assert crossing(times, signed(now_s - 59.0)) == 3


def test_it_is_written_rarely_whole_and_never_by_the_flight_itself(tmp_path: Path) -> None:
    path, elapsed = tmp_path / "times", [0.0]
    times = SigningTimes(path, lambda: EPOCH_S + 5000.0 + elapsed[0], lambda: elapsed[0])
    contents = set()
    for n in range(1000):
        elapsed[0] = 0.01 * n
        times.next()
        times._wait()
        contents.add(path.read_text())
    assert len(contents) == 2, "at 0 and 5 of 10 s"
    assert json.loads(path.read_text())["time"] > times._used, "ahead of what was used, should it be killed now"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "content",
    [b"", b"not a number", b"{}", b'{"time": 1, "streams": [[1]]}', b"[" * 100_000, b"1e999", b"null", b"99999999999999999"],
)
def test_a_file_that_cannot_be_used_is_reported_once_and_flown_on_without(tmp_path, content, caplog):
    path, now_s = tmp_path / "times", EPOCH_S + 5000.0
    path.write_bytes(content)
    times = SigningTimes(path, lambda: now_s)
    assert [r.levelname for r in caplog.records] == ["ERROR"]
    assert crossing(times, signed(now_s - 61.0)) == 0
    assert crossing(times, signed(now_s)) == 3
    times.close()
    assert json.loads(path.read_text())["streams"] == [[7, 1, 1, times.streams[7, 1, 1]]], "and mended"


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EIO])
def test_a_disk_that_takes_nothing_is_reported_once_and_flown_on_without(number, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(Path, "open", lambda *_: (_ for _ in ()).throw(OSError(number, "broken")))
    elapsed = [0.0]
    times = SigningTimes(tmp_path / "times", lambda: EPOCH_S + 5000.0 + elapsed[0], lambda: elapsed[0])
    used = []
    for _ in range(5):
        elapsed[0] += 10.0
        used.append(times.next())
        times._wait()
    assert used == sorted(set(used))
    assert caplog.text.count("kept in memory alone") == 1
    assert crossing(times, signed(EPOCH_S + 5000.0)) == 3


def test_a_wrong_name_is_reported_before_the_flight(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(BadInput, match="signing times"):
        SigningTimes(tmp_path / "file/times")


def test_a_right_signature_with_a_time_that_is_refused_is_counted_apart() -> None:
    """An autopilot without a fix signs by a clock that is days behind: that is no wrong key."""
    now_s = EPOCH_S + 4e8

    def codec_of(key: bytes, wall_s: float) -> Codec:
        return Codec(1, 1, datagrams=True, signing=Signing(lambda: SigningKey(key), SigningTimes(None, lambda: wall_s), 0))

    ours = codec_of(SECRET, now_s)
    heartbeat = mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    assert ours.feed(codec_of(SECRET, now_s - 3 * 86_400.0).pack(heartbeat)) == []
    assert (ours.counters.refused_signature, ours.counters.refused_time) == (1, 1)
    assert ours.counters.behind_s == pytest.approx(3 * 86_400.0, abs=0.1)
    for data in (codec_of(SECRET[::-1], now_s).pack(heartbeat), Codec(1, 1).pack(heartbeat)):
        assert ours.feed(data) == []
    assert (ours.counters.refused_signature, ours.counters.refused_time) == (3, 1)
    fresh = codec_of(SECRET, now_s).pack(heartbeat)
    assert len(ours.feed(fresh)) == 1
    assert ours.feed(fresh) == []
    assert ours.counters.refused_time == 2
    assert ours.counters.behind_s == pytest.approx(0.0, abs=0.1), "played again"
