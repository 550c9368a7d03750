"""Fuzz the sentences of a ship: NMEA 0183 and AIS, with right and with wrong checksums."""

import math
from collections.abc import Iterator

from drivers.nmea.sentences import NmeaReader
from estimator.contracts.samples import GeoFix
from estimator.contracts.time import MonoNs
from fuzz.target import Choices, Target, block

_MMSI = 211_234_560


def run_nmea(data: bytes) -> None:
    """Read datagrams: nothing raises, and every accepted place and velocity is possible."""
    choices, reader, now = Choices(data), NmeaReader(_MMSI), 0
    while choices:
        seal, now = bool(choices.number(1) & 1), now + 10_000_000 * choices.number(1)
        sentence = choices.block()
        for sample in reader.samples(sealed(sentence) if seal else sentence, MonoNs(now)):
            if isinstance(sample, GeoFix):
                assert abs(sample.place.latitude_rad) <= 0.5 * math.pi
                assert sample.v_ned is None or math.hypot(*sample.v_ned.tolist()) < 60.0


def sealed(sentence: bytes) -> bytes:
    """Return a sentence with its right checksum."""
    check = 0
    for letter in sentence[1:]:
        check ^= letter
    return sentence + f"*{check:02X}".encode()


def nmea_seeds() -> Iterator[bytes]:
    """Yield one sentence of each kind."""
    for sentence in (
        b"$GPRMC,081836,A,3751.65,S,14507.36,E,005.5,045.0,130998,011.3,E",
        b"$GPGGA,134658.00,5106.9792,N,11402.3003,W,2,09,1.6,1048.47,M,-16.27,M,08,AAAA",
        b"$GPVTG,180.0,T,,M,010.0,N,18.5,K",
        b"$HEHDT,123.4,T",
        b"!AIVDM,1,1,,A,139Lg0?P0O0fdB0O8<01i1NIP000,0",
        b"!AIVDM,1,1,,A,B39Lg003wh;c4P7j303Q3wv00000,0",
    ):
        yield b"\1\1" + block(sentence)


TARGETS = {"nmea": Target(run_nmea, nmea_seeds)}
