"""Read captures of an AR.Drone's own streams: video as received over TCP (PaVE), and concatenated navdata datagrams."""

import struct
from collections.abc import Iterator
from pathlib import Path

from drivers.ardrone.navdata import Navdata, decode
from drivers.ardrone.pave import PaveParser
from drivers.ardrone.samples import AS_REPORTED, NavdataSampler, time_us
from drivers.ardrone.video import VideoDecoder
from drivers.imports.stamps import FRAME_DELAY_S, stamp
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Frame, Sample

NAVDATA_MAGIC = b"\x88\x77\x66\x55"
_NAVDATA_WRAP_US = 2048 * 1_000_000
_NAVDATA_PERIOD_S = 0.005
"""The period assumed for datagrams without a time: full navdata are sent 200 times a second."""
_CHECKSUM_TAG = 0xFFFF
_OPTION = struct.Struct("<HH")


def frames(path: Path) -> Iterator[Frame]:
    """Yield the frames of a PaVE capture that decode, from the first key frame on, at the times of their headers.

    Raises:
        BadInput: the file cannot be read, or no frame in it decodes.
    """
    parser, decoder = PaveParser(), VideoDecoder()
    first_ms: int | None = None
    given = 0
    for unit in parser.feed(_bytes(path)):
        image = decoder.newest([unit])
        if image is None:
            continue
        first_ms = unit.header.timestamp_ms if first_ms is None else first_ms
        given += 1
        at_ns = ((unit.header.timestamp_ms - first_ms) % (1 << 32)) * 1_000_000
        yield Frame(stamp(at_ns, FRAME_DELAY_S), unit.header.frame_number, image.px, coded=True)
    if not given:
        raise BadInput(f"{path}: no frame in it decodes")


def samples(path: Path) -> list[Sample]:
    """Return the samples of a navdata capture, at the drone's own time.

    Raises:
        BadInput: the file cannot be read, or no datagram in it is whole.
    """
    sampler, out, whole = NavdataSampler(AS_REPORTED), list[Sample](), 0
    newest_us: int | None = None
    at_ns = 0
    for datagram in datagrams(_bytes(path)):
        navdata = decode(datagram)
        if not isinstance(navdata, Navdata):
            continue
        whole += 1
        us = time_us(navdata)
        if us is not None:
            if newest_us is not None:
                at_ns += ((us - newest_us) % _NAVDATA_WRAP_US) * 1000
            newest_us = us
        elif whole > 1:
            at_ns += round(_NAVDATA_PERIOD_S * 1e9)
        out += sampler.samples(navdata, stamp(at_ns))
    if not whole:
        raise BadInput(f"{path}: no whole navdata datagram in it")
    return out


def datagrams(data: bytes) -> Iterator[bytes]:
    """Split concatenated datagrams, each of which ends with its checksum option. Bytes between them are skipped."""
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


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as why:
        raise BadInput(f"{path}: {why.strerror or why}") from why
