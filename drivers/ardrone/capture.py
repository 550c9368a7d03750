"""Read captures of an AR.Drone's own streams: video as received over TCP (PaVE), and concatenated navdata datagrams."""

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from drivers.ardrone.counters import in_words
from drivers.ardrone.navdata import Navdata, decode
from drivers.ardrone.navdata_channel import AS_REPORTED, NavdataSampler
from drivers.ardrone.pave import PaveParser, VideoDecoder
from drivers.file_kinds import NAVDATA_MAGIC
from drivers.files import Largest, bytes_of
from drivers.importer import ForeignFile
from drivers.log_stamps import FRAME_DELAY_S, Tell, quiet, stamp, timeline
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Frame, Sample

_NAVDATA_WRAP_US = 2048 * 1_000_000  # period of the time in navdata: eleven bits of seconds
_NAVDATA_PERIOD_S = 0.005
"""The period assumed for datagrams without a time: full navdata are sent 200 times a second."""
_PAUSE_MS = 600_000  # a video that goes on after a longer time was not paused: the drone's clock began again
_FRAME_MS = 33  # time between two frames at 30 Hz
_CHECKSUM_TAG = 0xFFFF  # tag of the last option of a navdata datagram
_OPTION = struct.Struct("<HH")


def import_video(file: ForeignFile) -> Iterator[Frame]:
    """Read a capture of video as an importer (`drivers.importer.Read`)."""
    return frames(file.path)


def import_navdata(file: ForeignFile) -> list[Sample]:
    """Read a capture of navdata as an importer (`drivers.importer.Read`)."""
    return samples(file.path, file.tell)


def frames(path: Path) -> Iterator[Frame]:
    """Yield the frames of a PaVE capture that decode, from the first key frame on, at the times of their headers.

    Raises:
        BadInput: the file cannot be read, or no frame in it decodes.
    """
    parser, decoder = PaveParser(), VideoDecoder()
    last_ms: int | None = None
    at_ms = given = 0
    for unit in parser.feed(bytes_of(path, Largest.LOG)):
        image = decoder.newest([unit])
        if image is None:
            continue
        step_ms = 0 if last_ms is None else (unit.header.timestamp_ms - last_ms) % (1 << 32)
        last_ms = unit.header.timestamp_ms
        # Its clock begins again with the drone: the next frame comes a frame later.
        at_ms += step_ms if step_ms <= _PAUSE_MS else _FRAME_MS
        given += 1
        yield Frame(stamp(at_ms * 1_000_000, FRAME_DELAY_S), unit.header.frame_number, image.px, coded=True)
    if not given:
        raise BadInput(f"{path}: no frame in it decodes")


def samples(path: Path, tell: Tell = quiet) -> list[Sample]:
    """Return the samples of a navdata capture, at the drone's own time.

    Raises:
        BadInput: the file cannot be read, or no datagram in it is whole.
    """
    whole: list[Navdata] = []
    refused: Counter[str] = Counter()
    for datagram in datagrams(bytes_of(path, Largest.LOG)):
        navdata = decode(datagram)
        if isinstance(navdata, Navdata):
            whole.append(navdata)
        else:
            refused[navdata.value] += 1
    output = in_words(refused)
    if not whole:
        raise BadInput(f"{path}: no whole navdata datagram in it{f'; {output}' if output else ''}")
    if refused:
        tell(output)
    sampler, out = NavdataSampler(AS_REPORTED), list[Sample]()
    for navdata, at_ns in zip(whole, timeline(_unwrap(whole), tell), strict=True):
        if at_ns is not None:
            out += sampler.samples(navdata, stamp(at_ns))
    return sorted(out, key=lambda s: s.stamp.received_at)


def _unwrap(navdata: Sequence[Navdata]) -> list[int]:
    """Return the drone's time of each datagram without its wraps, us; one without a time follows the one before."""
    out: list[int] = []
    newest_us: int | None = None
    for one in navdata:
        us, before = one.time_us, out[-1] if out else 0
        if us is None:
            out.append(before + round(_NAVDATA_PERIOD_S * 1e6) if out else 0)
            continue
        half = _NAVDATA_WRAP_US // 2
        out.append(before + (us - newest_us + half) % _NAVDATA_WRAP_US - half if newest_us is not None else before)
        newest_us = us
    return out


def datagrams(data: bytes) -> Iterator[bytes]:
    """Split concatenated datagrams, each ends with its checksum option. Bytes between them are skipped."""
    begin = 0
    while True:
        begin = data.find(NAVDATA_MAGIC, begin)
        if begin < 0:
            return
        end = _end(data, begin)
        if end is None:
            begin += 4
            continue
        yield data[begin:end]
        begin = end


def _end(data: bytes, begin: int) -> int | None:
    at: int = begin + 16
    while at + 4 <= len(data):
        tag, size = _OPTION.unpack_from(data, at)
        if size < 4 or at + size > len(data):
            return None
        at += size
        if tag == _CHECKSUM_TAG:
            return at
    return None
