"""Fuzz the bytes of MAVLink: frames of a stream and of datagrams, and what signs them."""

import struct
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from companion.settings.files import signing_key
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import mav
from drivers.mavlink.signing import Signing, SigningKey, SigningTimes
from estimator.contracts.errors import BadInput
from fuzz.target import SHARED_MEMORY, Choices, Target, block

NUMBERS = tuple(sorted(mav.mavlink_map))


def run_codec(data: bytes) -> None:
    """Parse the bytes of a stream and of datagrams: no error, the counts add up, and each message can be sent on."""
    choices = Choices(data)
    how = choices.number(1)
    codec, sender = Codec(1, 191, datagrams=bool(how & 1)), Codec(1, 191)
    found = 0
    while choices:
        for message in codec.feed(choices.block()):
            found += 1
            with suppress(ValueError):
                assert sender.pack(message)
    assert codec.counters.messages == found


def codec_seeds() -> Iterator[bytes]:
    """Yield frames of both versions: whole, in pieces, with garbage between, with an unknown number, truncated."""
    codec, old = Codec(1, 1), mav.MAVLink(None, srcSystem=1, srcComponent=1)
    messages = [
        mav.MAVLink_attitude_quaternion_message(1000, 1, 0, 0, 0, 0.1, 0.2, 0.3),
        mav.MAVLink_attitude_message(1020, 0.1, -0.1, 2, 0, 0, 0),
        mav.MAVLink_local_position_ned_message(1030, 1, 2, -3, 0.1, 0.2, 0.3),
        mav.MAVLink_highres_imu_message(1_040_000, 0, 0, -9.8, 0, 0, 0, 0, 0, 0, 1013, 0, 20, 20, 63),
        mav.MAVLink_scaled_imu_message(1050, 0, 0, -1000, 1, 2, 3, 4, 5, 6),
        mav.MAVLink_raw_imu_message(1_060_000, 0, 0, -1000, 1, 2, 3, 4, 5, 6),
        mav.MAVLink_distance_sensor_message(1070, 10, 1000, 321, 0, 1, 25, 4),
        mav.MAVLink_sys_status_message(1, 1, 1, 500, 12000, 100, 80, 0, 0, 0, 0, 0, 0),
        mav.MAVLink_extended_sys_state_message(0, 2),
        mav.MAVLink_timesync_message(0, 123456789),
    ]
    frames = [codec.pack(message) for message in messages[:6]]
    frames += [bytes(message.pack(old, force_mavlink1=True)) for message in messages[6:]]
    unknown = b"\xfd\x02\x00\x00\x07\x01\x01\xff\xff\x00ab\x12\x34"
    stream = b"".join(frames[:3]) + b"\xfd rubbish \xfe" + b"".join(frames[3:]) + unknown
    for datagrams in (b"\0", b"\1"):
        yield datagrams + block(stream) + block(frames[0][:9]) + block(frames[0][9:])
        yield datagrams + b"".join(map(block, frames)) + block(unknown)


_SECRET = SigningKey(bytes(range(32)))


def run_signing(data: bytes) -> None:
    """Process signed frames with any fields in any order of times, and key and time files of any content."""
    choices = Choices(data)
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
        key, time = Path(folder) / "key", Path(folder) / "time"
        key.write_bytes(choices.block())
        key.chmod(0o600)
        time.write_bytes(choices.block())
        with suppress(BadInput):
            signing_key(str(key))
        with suppress(BadInput):
            times = SigningTimes(time, lambda: 1.7e9)
            times.next()
            times.close()
    clock = SigningTimes(None, lambda: 1.7e9)
    codec = Codec(1, 191, datagrams=True, signing=Signing(lambda: _SECRET, clock, 0))
    sender = mav.MAVLink(None, srcSystem=1, srcComponent=1)
    sender.signing.secret_key, sender.signing.sign_outgoing = _SECRET.secret, True
    while choices:
        how = choices.number(1)
        sender.signing.timestamp = choices.number(6) if how & 1 else clock.next()
        sender.signing.link_id = choices.number(1)
        number = NUMBERS[choices.number(2) % len(NUMBERS)]
        payload = choices.block()
        frame = bytearray(_signed(sender, number, payload))
        if how & 2:
            frame[choices.number(1) % len(frame)] ^= choices.number(1) or 1
        before = codec.counters.messages
        messages = codec.feed(bytes(frame))
        assert codec.counters.messages == before + len(messages)
        assert not (how & 2 and messages and bytes(messages[0].get_msgbuf()) == bytes(frame)), "an altered frame was believed"
        codec.pack(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))


def _signed(sender: Any, number: int, payload: bytes) -> bytes:
    kind = mav.mavlink_map[number]
    whole = payload[: kind.unpacker.size].ljust(kind.unpacker.size, b"\0")
    return bytes(mav.MAVLink_message(number, kind.msgname)._pack(sender, kind.crc_extra, whole))


def signing_seeds() -> Iterator[bytes]:
    """Yield keys in each of their forms, and rising, repeated and altered times."""
    keys = (bytes(range(32)), b"00" * 32, b"passphrase: open sesame", b"")
    beat = struct.pack("<H", 0) + block(b"\x01\x02\x03\x04\x05\x06\x07\x08\x03")
    for key in keys:
        yield block(key) + block(b"12345678") + b"\x00\x00" + beat + b"\x01" + (10**14).to_bytes(6, "little") + b"\x00" + beat
    yield (
        block(b"")
        + block(b"nine")
        + (b"\x01" + (5).to_bytes(6, "little") + b"\x00" + beat) * 2
        + b"\x02\x00"
        + beat
        + b"\x05\x01"
    )


TARGETS = {
    "mavlink_codec": Target(run_codec, codec_seeds),
    "mavlink_signing": Target(run_signing, signing_seeds),
}
