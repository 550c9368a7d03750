"""Fuzz all that an AR.Drone sends to the service, and all that a client sends to the simulated drone."""

import struct
from collections.abc import Iterator
from functools import cache
from unittest.mock import patch

import av
import numpy as np

from companion.guidance.pilot import make_pilot
from companion.settings.load import load
from companion.settings.model import Settings
from drivers.ardrone import at, control, navdata
from drivers.ardrone.counters import Counters, Refusal
from drivers.ardrone.navdata_channel import NavdataChannel
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.pave import FrameType, PaveHeader, PaveParser, VideoDecoder
from estimator.contracts.pictures import PictureRefusal
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs
from estimator.uvlc import UvlcDecoder
from fuzz.target import Choices, Target, block
from sitl.ardrone.config import Configuration
from sitl.ardrone.drone import Drone, DroneClock
from sitl.ardrone.state import DroneState
from sitl.ardrone.uvlc import encode
from sitl.emulators.ardrone.wire_pictures import Encoder
from sitl.emulators.autopilots.lock_step import LockStepClock
from sitl.scenario.scenario import load as load_scenario
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.world import World

_START = MonoNs(1_000_000_000_000)
_CHECKSUM_BYTES = 8


def run_navdata(data: bytes) -> None:
    """Pass datagrams with corrected checksums through the channel into the pilot; each must be processed or counted."""
    choices = Choices(data)
    clock, counters = LockStepClock(_START), Counters()
    pilot = make_pilot(_settings())

    def received(_: navdata.Navdata, samples: list[Sample], received_at: MonoNs) -> None:
        for sample in samples:
            pilot.on_sample(sample)
        pilot.decide(received_at)

    channel = NavdataChannel(ArDroneOptions(), clock, counters, received, lambda: None)
    while choices:
        how, datagram = choices.number(1), choices.block()
        clock.advance((how >> 1) * 1e-3)
        channel.take(_checked(datagram) if how & 1 else datagram, clock.now())
        found = navdata.decode(datagram)
        if not isinstance(found, Refusal) and found.options and not found.skipped:
            assert not isinstance(navdata.decode(navdata.encode(found)), Refusal)


def _checked(datagram: bytes) -> bytes:
    body = datagram[:-_CHECKSUM_BYTES]
    return body + struct.pack("<HHI", navdata.CHECKSUM_TAG, _CHECKSUM_BYTES, sum(body) & 0xFFFFFFFF)


@cache
def _settings() -> Settings:
    return load("sim")


def navdata_seeds() -> Iterator[bytes]:
    """Yield navdata of the simulated drone: bootstrap, demo and full, on the ground and flying."""
    for full in (False, True):
        drone = _drone()
        commands: list[at.AtCommand] = [at.Config("general:navdata_demo", "FALSE" if full else "TRUE"), at.Ctrl(at.CTRL_ACK, 0)]
        datagrams = [drone.datagram()]
        drone.take(b"".join(at.encode(i + 1, c) for i, c in enumerate(commands)), _START)
        for tick in range(1, 4):
            drone.tick(MonoNs(_START + tick * 5_000_000))
            datagrams.append(drone.datagram())
        yield b"".join(b"\x0b" + block(d) for d in datagrams)
        yield b"\x00" + block(datagrams[-1])


@cache
def _world_of() -> World:
    return World(load_scenario("calm"), 1, _START)


def _drone() -> Drone:
    return Drone(_world_of(), DroneClock(_START, 0.0))


def run_pave(data: bytes) -> None:
    """Parse a stream in pieces: no error, a bounded buffer, and any result of the decoder for each frame."""
    choices = Choices(data)
    parser, decoder = PaveParser(), VideoDecoder()
    with patch("drivers.ardrone.pave.unit_decoder", lambda: _AnyCodec(choices)):
        fed = 0
        while choices:
            piece = choices.block()
            fed += len(piece)
            batch = parser.feed(piece)
            assert all(len(unit.payload) <= fed for unit in batch)
            decoder.newest(batch)
    assert parser.pending <= fed


class _AnyCodec:
    """A decoder of H.264 that answers as the input says: frames of any size, several or none."""

    def __init__(self, choices: Choices) -> None:
        self._choices = choices

    def decode(self, payload: bytes) -> list[object]:
        answer = self._choices.number(1)
        if answer & 0xC0 == 0xC0:
            return []
        width, height = (64, 48) if not answer & 0x30 else (2 * self._choices.number(1) + 2, 2)
        return [av.VideoFrame(width, height, "yuv420p") for _ in range(answer & 3)]


def _unit(number: int, payload: bytes, kind: int, size: int, width: int = 64, height: int = 48) -> bytes:
    header = PaveHeader(
        len(payload), number, 33 * number, kind, header_size=size,
        display_width=width, display_height=height, encoded_width=width, encoded_height=height,
    )  # fmt: skip
    return header.pack() + payload


def pave_seeds() -> Iterator[bytes]:
    """Yield frames with each size of header, whole, in pieces, and with garbage between them."""
    units = [_unit(n, bytes(range(20 + n)), FrameType.IDR if n % 3 == 0 else FrameType.P, (64, 68, 76)[n % 3]) for n in range(6)]
    stream = b"".join(units)
    yield block(stream) + b"\x01" * 8
    yield b"".join(block(stream[i : i + 50]) + b"\x01" for i in range(0, len(stream), 50))
    yield block(units[0] + b"PaVrubbishPaVE" + units[3]) + b"\x01\x11\x20\xc0"


def run_video(data: bytes) -> None:
    """Decode a stream with the real decoder; damaged frames must be counted, whatever the access unit contains."""
    parser, decoder = PaveParser(), VideoDecoder()
    for unit in parser.feed(data):
        image = decoder.newest([unit])
        assert image is None or image.px.shape == (unit.header.display_height, unit.header.display_width, 3)


def video_seeds() -> Iterator[bytes]:
    """Yield two encoded frames of 64 by 48 pixels."""
    encoder, rng = Encoder(64, 48, 30.0, 1000.0), np.random.default_rng(1)
    units = [encoder.encode(np.full((48, 64, 3), 90, np.uint8) + rng.integers(0, 9, (48, 64, 3), np.uint8)) for _ in range(2)]
    kinds = [FrameType.IDR if unit.idr else FrameType.P for unit in units]
    yield b"".join(_unit(n, unit.data, kind, 68) for n, (unit, kind) in enumerate(zip(units, kinds, strict=True)))


def run_uvlc(data: bytes) -> None:
    """Decode a datagram of an AR.Drone 1.0: a refusal, or a whole picture of the size that its header says."""
    decoder = UvlcDecoder()
    picture = decoder.header(data)
    if not isinstance(picture, PictureRefusal):
        px = decoder.decode(data, picture)
        assert isinstance(px, PictureRefusal) or px.shape == (picture.height, picture.width, 3)


def uvlc_seeds() -> Iterator[bytes]:
    """Yield pictures of 176 by 144 pixels: grey, of a few colours, and coarse."""
    grey = np.full((144, 176, 3), 90, np.uint8)
    colours = grey.copy()
    colours[40:90, 30:120] = 20, 160, 240
    yield encode(grey, 1)
    yield encode(colours, 2)
    yield encode(np.random.default_rng(1).integers(0, 60, (144, 176, 3), np.uint8), 3, 30)


def run_control(data: bytes) -> None:
    """Parse the drone's configuration as text; the result must survive writing and reading."""
    pairs = control.parse(data)
    for value in pairs.values():
        number = control.number(value)
        assert number is None or np.isfinite(number)
    again = control.parse(control.render(pairs))
    assert again == pairs


def control_seeds() -> Iterator[bytes]:
    """Yield the simulated drone's own answer."""
    yield control.render(dict(list(Configuration().dump().items())[::6]))
    yield control.render(Configuration().dump())


def run_at(data: bytes) -> None:
    """Send datagrams of commands, with time between them, to the simulated drone.

    Each is obeyed or counted, and the drone's answers can be built.
    """
    choices = Choices(data)
    drone, now = _drone(), _START
    phases = tuple(VehiclePhase)
    state = DroneState()
    while choices:
        how, datagram = choices.number(1), choices.block()
        now = MonoNs(now + (how >> 3) * 100_000_000)
        phase = phases[(how & 7) % len(phases)]
        tuple(state.take(datagram, now, phase))
        tuple(state.tick(now, phase))
        state.word(phase, False, False)
        state.config.custom_ids()
        drone.state.config = state.config
        drone.datagram()
        for item in at.decode(datagram):
            if not isinstance(item, Refusal):
                assert at.decode(at.encode(*item)) == [item]
    assert control.parse(control.render(state.config.dump())) == state.config.dump()


def at_seeds() -> Iterator[bytes]:
    """Yield a start, a flight, configurations of several users, and each command once."""
    ids = at.ConfigIds("dec1a4de", "dec1a4d1", "dec1a4d0")
    start: list[at.AtCommand] = [
        at.Pmode(2),
        at.Misc(),
        at.Config("custom:session_id", "dec1a4de"),
        ids,
        at.Config("video:codec_fps", "30"),
    ]
    flight: list[at.AtCommand] = [
        at.Ftrim(),
        at.Ref(at.REF_BASE | at.REF_TAKE_OFF),
        at.Pcmd(1, 0.1, -0.2, 0.3, -1.0),
        at.ComWdg(),
        at.Ref(at.REF_BASE),
    ]
    others: list[at.AtCommand] = [
        at.PcmdMag(1, 0.0, 0.0, 0.0, 0.0, 0.5, 0.1),
        at.Calib(0),
        at.Ctrl(4, 0),
        at.Ctrl(5, None),
        at.Led(1, 2.0, 3),
        at.Anim(1, 100),
    ]
    limits: list[at.AtCommand] = [
        ids,
        at.Config("control:euler_angle_max", "0.25"),
        ids,
        at.Config("custom:session_id", "-all"),
        at.Config("leds:leds_anim", "1,1073741824,2"),
    ]
    rows = [b"".join(at.encode(i + 1, command) for i, command in enumerate(row)) for row in (start, flight, others, limits)]
    yield b"".join(b"\x0a" + block(row) for row in rows)
    for row in rows:
        yield b"\x03" + block(row)


TARGETS = {
    "navdata": Target(run_navdata, navdata_seeds, 8192),
    "pave": Target(run_pave, pave_seeds),
    "video": Target(run_video, video_seeds, 8192),
    "uvlc": Target(run_uvlc, uvlc_seeds, 8192),
    "control": Target(run_control, control_seeds, 8192),
    "at": Target(run_at, at_seeds),
}
