"""Fuzz MAVLink from the socket to the bytes that are sent: the fuzzer chooses the fields, the checksums are right.

An input is a sequence of steps. Each names a message of the dialect, a sender and a link, fills the message's payload, and
advances the time, so that the fuzzer gets past the checksum and to the fields. Some steps are raw bytes instead.
"""

from __future__ import annotations

import asyncio
import math
import struct
import tempfile
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from companion.base.health import Health
from companion.guidance.make_pilot import make_pilot
from companion.parts.mavlink.bridge import BridgePart
from companion.parts.mavlink.make import AutopilotPart
from companion.settings.load import from_mapping
from companion.settings.mavlink import BridgeOptions
from companion.settings.model import Settings
from drivers.endpoint import Endpoint, parse_endpoint
from drivers.mailbox import Line
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import LinkOptions
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.signing import Signing, SigningKey, load_key
from drivers.mavlink.signing_times import SigningTimes
from drivers.wires import Pack, WireCounts
from estimator.contracts.commands import Hover, Velocity
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Attitude, BodyVelocity, Range, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp
from fuzz.target import SHARED_MEMORY, Choices, Target, block
from sitl.emulators.autopilots.lock_step import LockStepClock

SETTINGS = {
    "vehicle": {"kind": "mavlink", "links": "udpin://127.0.0.1:14550, udpout://127.0.0.1:14551, tcp://127.0.0.1:5760"},
    "camera": {"file": "sim", "gimbal": {"device_id": 1, "point_down": True}},
    "pad": {"file": "thesis"},
    "vision": {"colours": "simulator"},
    "guidance": {"start": "signal"},
}
NUMBERS = tuple(sorted(mav.mavlink_map))
_ACTED_ON = {
    "HEARTBEAT", "SYS_STATUS", "SYSTEM_TIME", "PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "PARAM_VALUE", "PARAM_SET",
    "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "SCALED_IMU", "SCALED_IMU2", "RAW_IMU",
    "HIGHRES_IMU", "DISTANCE_SENSOR", "COMMAND_LONG", "COMMAND_INT", "COMMAND_ACK", "TIMESYNC", "STATUSTEXT", "EVENT",
    "GIMBAL_DEVICE_ATTITUDE_STATUS", "GIMBAL_MANAGER_STATUS", "MOUNT_ORIENTATION", "MOUNT_STATUS",
    "EXTENDED_SYS_STATE", "MESSAGE_INTERVAL", "AUTOPILOT_VERSION", "BATTERY_STATUS", "LANDING_TARGET", "ALTITUDE",
    "SETUP_SIGNING", "PING", "COMMAND_CANCEL", "SET_MODE", "GPS_RAW_INT", "VFR_HUD", "ODOMETRY",
}  # fmt: skip
HANDLED = tuple(number for number in NUMBERS if mav.mavlink_map[number].msgname in _ACTED_ON)
"""Numbers of the messages that the service acts on; half of the steps use these."""
SENDERS = ((1, 1), (255, 190), (66, 1), (1, 191), (2, 1), (0, 0), (255, 255), (1, 0))
"""System and component of autopilot, ground station, unknown sender, ourselves, the ship, nobody, broadcast, and another
component of the autopilot's system."""
REALS = (math.nan, math.inf, -math.inf, 1e38, -1e38, 1e-45, -1.0, 0.0, 1.0, 2.0**31, 2.0**32, 2.0**63, 0.5, 1e9, -0.0, 244.0)
AUTOPILOTS = (int(mav.MAV_AUTOPILOT_PX4), int(mav.MAV_AUTOPILOT_ARDUPILOTMEGA), int(mav.MAV_AUTOPILOT_GENERIC))
TO_US = (1, int(mav.MAV_COMP_ID_ONBOARD_COMPUTER))
_RAW, _ADDRESSED, _V1, _REAL = 0x80, 0x40, 0x20, 0x10
_STEPS = 200


@dataclass
class Wires:
    """Replace the sockets: a parser of its own reads each sent message again and must find it valid."""

    received: list[Callable[[bytes, MonoNs, Any], None]] = field(default_factory=list)
    sent: int = 0
    _reader: Any = field(default_factory=lambda: mav.MAVLink(None))

    @asynccontextmanager
    async def open(
        self, endpoint: Endpoint, clock: Clock, received: Callable[[bytes, MonoNs, Any], None], counts: WireCounts
    ) -> AsyncIterator[Wires]:
        self.received.append(received)
        yield self

    @property
    def local(self) -> None:
        return None

    def send(self, pack: Pack, to: object, newest_of: str = "") -> bool:
        self.sent += 1
        if data := pack():
            self._reader.decode(bytearray(data))
        return bool(data)

    async def broken(self) -> None:
        await asyncio.Event().wait()


def message_bytes(number: int, payload: bytes, sender: tuple[int, int], sequence: int, *, old: bool = False) -> bytes:
    """Return a frame with a valid checksum around any payload: MAVLink 2, or 1 if `old` is set and the number allows it."""
    kind = mav.mavlink_map[number]
    payload = payload[: kind.unpacker.size].ljust(kind.unpacker.size, b"\0")
    if old and number < 256:
        head = struct.pack("<BBBBB", len(payload), sequence & 0xFF, *sender, number)
        marker = b"\xfe"
    else:
        payload = payload.rstrip(b"\0") or b"\0"
        head = struct.pack("<BBBBBB", len(payload), 0, 0, sequence & 0xFF, *sender) + number.to_bytes(3, "little")
        marker = b"\xfd"
    crc = mav.x25crc(head + payload)
    crc.accumulate(bytes([kind.crc_extra]))
    return marker + head + payload + struct.pack("<H", crc.crc)


def addressed(number: int, payload: bytes, to: tuple[int, int]) -> bytes:
    """Return the payload with its target fields, if it has them, set to `to`."""
    kind = mav.mavlink_map[number]
    values = list(kind.unpacker.unpack(payload[: kind.unpacker.size].ljust(kind.unpacker.size, b"\0")))
    if sum(length or 1 for length in kind.array_lengths) != len(values):
        return payload  # arrays of numbers move the fields; none of those messages is a command
    for name, value in zip(("target_system", "target_component"), to, strict=True):
        if name in kind.ordered_fieldnames:
            values[kind.ordered_fieldnames.index(name)] = value
    return bytes(kind.unpacker.pack(*values))


def step_bytes(choices: Choices, sequence: int) -> bytes:
    """Return the bytes of the next step as on the wire."""
    how, sender = choices.number(1), SENDERS[choices.number(1) % len(SENDERS)]
    if how & _RAW:
        return choices.block()
    pick = choices.number(2)
    number = HANDLED[pick % len(HANDLED)] if pick & 1 else NUMBERS[(pick >> 1) % len(NUMBERS)]
    payload = choices.block()
    if how & _REAL:
        where, value = 4 * choices.number(1), struct.pack("<f", REALS[choices.number(1) % len(REALS)])
        payload = payload.ljust(where + 4, b"\0")[:where] + value + payload[where + 4 :]
    if how & _ADDRESSED:
        payload = addressed(number, payload, TO_US)
    return message_bytes(number, payload, sender, sequence, old=bool(how & _V1))


def step(message: Message, sender: int = 0, how: int = 0, wait: int = 1, link: int = 0) -> bytes:
    """Return the input of a step that sends this message; the seeds consist of such steps."""
    payload = bytes(message.pack(mav.MAVLink(None, srcSystem=1, srcComponent=1)))[10:-2]
    pick = 2 * NUMBERS.index(message.get_msgId())
    return bytes([wait | link << 6, how, sender]) + struct.pack("<H", pick) + block(payload)


@cache
def _settings() -> Settings:
    return from_mapping(SETTINGS, "fuzz")


def run_autopilot(data: bytes) -> None:
    """Run each link's input to the bytes that go out again: codec, links, autopilot, component, samples, pilot, commands."""
    asyncio.run(_autopilot(Choices(data)))


async def _autopilot(choices: Choices) -> None:
    clock, wires, pilot = LockStepClock(), Wires(), make_pilot(_settings())
    vehicle = _settings().vehicle
    assert isinstance(vehicle, AutopilotOptions)
    part = AutopilotPart(_settings(), vehicle, pilot, Health(clock), clock, lambda on: None, lambda *crossed: None)

    async def on_message(samples: Line[Sample]) -> None:
        async for sample in samples:
            pilot.on_sample(sample)
            part.component.on_sample(sample)

    first = choices.number(1)
    with patch("drivers.mavlink.links.open_wire", wires.open):
        async with part.open() as link, asyncio.TaskGroup() as group:
            task = group.create_task(on_message(link.samples))
            await clock.settle()
            if first < 0xC0:
                beat = mav.MAVLink_heartbeat_message(2, AUTOPILOTS[first % 3], 0xD1, 4, 4, 3)
                data = bytes(beat.pack(mav.MAVLink(None, srcSystem=1, srcComponent=1)))
                wires.received[0](data, clock.now(), ("127.0.0.1", 14550))
                await clock.settle()
            for sequence in range(_STEPS):
                if not choices:
                    break
                when = choices.number(1)
                number = when >> 6
                wire, peer = (0, ("127.0.0.1", 14550)) if number < 2 else (number - 1, None)
                wires.received[wire](step_bytes(choices, sequence), clock.now(), peer if number != 1 else ("10.0.0.9", 9))
                clock.advance((when & 0x3F) * 0.01)
                decision = pilot.decide(clock.now())
                part.component.on_decision(decision)
                with suppress(Recoverable):
                    link.command(decision.command or (Hover() if when & 1 else Velocity(_v(), 0.1)))
                await clock.settle()
                _raise_what_failed(task)
            clock.advance(1.0)
            await clock.settle()
            _raise_what_failed(task)
            task.cancel()


def _v() -> F64:
    return np.array([0.1, -0.2, 0.3])


def _raise_what_failed(task: asyncio.Task[None]) -> None:
    if task.done():
        task.result()
        raise AssertionError("nothing reads the samples any more")


def _conversation() -> list[Message]:
    """Return one of each message that an autopilot and a station send to the service, with usual content."""
    us, me = TO_US, mav
    longs = (
        (me.MAV_CMD_NAV_LAND, 0, 0), (me.MAV_CMD_DO_PAUSE_CONTINUE, 0, 0), (me.MAV_CMD_DO_PAUSE_CONTINUE, 1, 0),
        (me.MAV_CMD_DO_GO_AROUND, 0, 0), (me.MAV_CMD_USER_1, 2, 0), (me.MAV_CMD_LOGGING_START, 0, 0),
        (me.MAV_CMD_LOGGING_STOP, 0, 0),
        (me.MAV_CMD_REQUEST_MESSAGE, 0, 0), (me.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 1e5), (me.MAV_CMD_GET_MESSAGE_INTERVAL, 0, 0),
    )  # fmt: skip
    return [
        me.MAVLink_attitude_quaternion_message(1000, 1, 0, 0, 0, 0.1, 0.2, 0.3),
        me.MAVLink_attitude_message(1020, 0.1, -0.1, 2, 0, 0, 0),
        me.MAVLink_local_position_ned_message(1030, 1, 2, -3, 0.1, 0.2, 0.3),
        me.MAVLink_highres_imu_message(1_040_000, 0, 0, -9.8, 0, 0, 0, 0, 0, 0, 1013, 0, 20, 20, 63),
        me.MAVLink_scaled_imu_message(1050, 0, 0, -1000, 1, 2, 3, 4, 5, 6),
        me.MAVLink_raw_imu_message(1_060_000, 0, 0, -1000, 1, 2, 3, 4, 5, 6),
        me.MAVLink_distance_sensor_message(1070, 10, 1000, 321, 0, 1, 25, 4),
        me.MAVLink_sys_status_message(1, 1, 1, 500, 12000, 100, 80, 0, 0, 0, 0, 0, 0),
        me.MAVLink_extended_sys_state_message(0, 2),
        me.MAVLink_timesync_message(0, 123456789),
        me.MAVLink_timesync_message(1_000_000_000_500, 1_000_000_000_000),
        me.MAVLink_statustext_message(4, b"PreArm: nothing"),
        me.MAVLink_param_value_message(b"PLND_LAG", 0.02, 9, 700, 3),
        me.MAVLink_param_value_message(b"RNGFND1_TYPE", 10.0, 9, 700, 4),
        me.MAVLink_command_ack_message(me.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 0, 0, *us),
        me.MAVLink_global_position_int_message(1000, 470000000, 80000000, 1000, 1000, 10, 20, 30, 18000),
        me.MAVLink_param_request_list_message(*us),
        me.MAVLink_param_request_read_message(*us, b"SPEED", 0),
        me.MAVLink_param_set_message(*us, b"DL_SPEED", 0.5, 9),
        *(me.MAVLink_command_long_message(*us, command, 0, a, b, 0, 0, 0, 0, 0) for command, a, b in longs),
        me.MAVLink_command_int_message(*us, 0, me.MAV_CMD_DO_PAUSE_CONTINUE, 0, 0, 0, 0, 0, 0, 0, 0, 0),
    ]


def autopilot_seeds() -> Iterator[bytes]:
    """Yield a whole conversation for each kind of autopilot, and each of its messages alone with extreme values."""
    output = _conversation()
    for kind in range(3):
        yield bytes([kind]) + b"".join(step(message, how=_ADDRESSED, wait=2) for message in output)
    for message in output:
        yield b"\x01" + step(message, 1, _ADDRESSED) + step(message, 2, _ADDRESSED, link=1)
    yield b"\xff" + bytes([1, _RAW, 0]) + block(b"\xfd\x09\x00\x00" + bytes(12)) + step(output[0])


def run_bridge(data: bytes) -> None:
    """Run ground stations against the bridge of a drone without MAVLink: commands go in, its status comes out."""
    asyncio.run(_bridge(Choices(data)))


async def _bridge(choices: Choices) -> None:
    clock, wires = LockStepClock(), Wires()
    links = [LinkOptions(parse_endpoint("udpin://127.0.0.1:14550")), LinkOptions(parse_endpoint("udpout://127.0.0.1:14551"))]
    answers = iter(range(_STEPS * 64))
    part = BridgePart(
        BridgeOptions(), links, clock, order=lambda order: "not now" if next(answers) % 3 else None, tap=lambda *crossed: None
    )
    sampler = _samples()

    with patch("drivers.mavlink.links.open_wire", wires.open):
        async with asyncio.TaskGroup() as group:
            task = group.create_task(part.run())
            await clock.settle()
            for sequence in range(_STEPS):
                if not choices:
                    break
                when = choices.number(1)
                wire = 1 if when & 0x40 else 0
                peer = None if wire else ("127.0.0.1", 9 if when & 0x80 else 14550)
                wires.received[wire](step_bytes(choices, sequence), clock.now(), peer)
                part.on_sample(sampler[when % len(sampler)])
                clock.advance((when & 0x3F) * 0.01)
                await clock.settle()
                _raise_what_failed(task)
            task.cancel()


@cache
def _samples() -> tuple[Sample, ...]:
    t = Stamp(MonoNs(1_000_000_000_000), MonoNs(1_000_000_000_000), 0.001, "synced")
    return (
        VehicleStatus(t, True, "flying", 0.5, False, True),
        Attitude(t, Rotation.from_rpy(0.1, 0.2, 3.0), np.eye(3) * 1e-4),
        BodyVelocity(t, np.array([0.1, 0.2, 0.3]), np.eye(3) * 1e-2),
        Range(t, 1.5, 0.05),
        VehicleStatus(t, False, "landed", None, True, True),
    )


def bridge_seeds() -> Iterator[bytes]:
    """Yield what a station sends to a multicopter."""
    to = (1, 1)
    commands = (400, 22, 21, 193, 17, 252, 512, 511, 520)
    rows = [mav.MAVLink_command_long_message(*to, c, 0, 1, 1, 0, 0, 0, 0, 0) for c in commands]
    rows.append(mav.MAVLink_command_int_message(*to, 0, 193, 0, 0, 1, 0, 0, 0, 0, 0, 0))
    yield b"".join(step(message, 1) for message in rows)
    yield from (step(message, 1) + step(message, 2, link=1) for message in rows)


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
    frames = [codec.pack(message) for message in _conversation()[:6]]
    frames += [bytes(message.pack(old, force_mavlink1=True)) for message in _conversation()[6:10]]
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
            load_key(str(key), {})
        with suppress(BadInput):
            times = SigningTimes(time, lambda: 1.7e9)
            times.next()
            times.close()
    clock = SigningTimes(None, lambda: 1.7e9)
    codec = Codec(1, 191, datagrams=True, signing=Signing(_SECRET, clock, 0))
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
    message = mav.MAVLink_message(number, kind.msgname)
    return bytes(message._pack(sender, kind.crc_extra, whole))


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
    "mavlink_autopilot": Target(run_autopilot, autopilot_seeds),
    "mavlink_bridge": Target(run_bridge, bridge_seeds),
    "mavlink_codec": Target(run_codec, codec_seeds),
    "mavlink_signing": Target(run_signing, signing_seeds),
}
