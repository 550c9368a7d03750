"""The rows of a ship's messages against the libraries' definitions, against what is read, and against cells that mean nothing."""

import importlib
from typing import Any

import pyais
import pynmea2
import pytest

from drivers.nmea.definitions import AIS, MESSAGES, RELPOSNED, SENTENCES, Fields, Read
from drivers.nmea.sentences import NmeaReader, Samples
from drivers.nmea.ship_bus import BusReader
from drivers.nmea.ship_sensors import ShipSensors
from drivers.relpos import RelposOptions, RelposReader
from estimator.contracts.time import MonoNs, Stamp
from tests.drivers.nmea.test_sentences import MMSI, NOW, ais, line

PLACE = "3751.6500,S,14507.3600,E"
GOOD = {
    "RMC": f"GPRMC,081836,A,{PLACE},005.5,045.0,130998,11.3,E,A,V",
    "GGA": f"GPGGA,081836,{PLACE},1,09,1.0,12.0,M,42.1,M,,",
    "GNS": f"GNGNS,081836,{PLACE},AA,09,1.0,12.0,42.1,,,V",
    "GLL": f"GPGLL,{PLACE},081836,A,A",
    "VTG": "GPVTG,045.0,T,034.4,M,005.5,N,010.2,K,A",
    "HDT": "HEHDT,44.0,T",
    "THS": "HETHS,44.0,A",
    "VHW": "VWVHW,44.0,T,33.0,M,5.0,N,9.3,K",
    "ROT": "HEROT,12.0,A",
    "XDR": "YXXDR,A,1.5,D,ROLL",
    "MWV": "WIMWV,45.0,R,8.0,M,A",
    "MWD": "WIMWD,45.0,T,34.0,M,16.0,N,8.2,M",
    "PSXN,20": "PSXN,20,0,0,0,0",
    "PSXN,22": "PSXN,22,0.1,0.2",
    "PSXN,23": "PSXN,23,1.5,0.5,44.0,0.3",
    "PSXN,24": "PSXN,24,0.1,0.1,0.2,0.1",
    "PASHR": "PASHR,081836.00,44.0,T,1.5,0.5,0.3,0.02,0.02,0.1,1,1",
    "PRDID": "PRDID,0.5,1.5,44.0",
}
MORE = {"GNS": ("nav_status",)}
"""Fields of a later version than the library's."""
THS = ("heading", "mode")
LATER = MonoNs(NOW + 4_000_000_000)


def names(kind: str) -> tuple[str, ...]:
    """Return the fields of a sentence in their order, as the library defines them."""
    if kind == "THS":
        return THS
    made: Any = pynmea2.parse(f"${GOOD[kind]}")
    return (*(field[1] for field in made.fields), *MORE.get(kind, ()))


def cells(kind: str, **changed: str) -> str:
    begin, *row = GOOD[kind].split(",")
    before = kind == "PASHR" or kind == "PRDID" or kind.startswith("PSXN")
    at = {name: n - before for n, name in enumerate(names(kind))}
    for name, cell in changed.items():
        row[at[name]] = cell
    return ",".join((begin, *row))


def begun() -> NmeaReader:
    """Return a reader that knows her heading and way of some seconds ago, so that another source may be chosen."""
    reader = NmeaReader()
    for body in ("INHDT,44.0,T", "INVTG,045.0,T,034.4,M,005.5,N,010.2,K,A"):
        reader.samples(line(body), NOW)
    return reader


def read(*bodies: str) -> tuple[Samples, NmeaReader]:
    """Return the samples of sentences."""
    reader = begun()
    return [one for body in bodies for one in reader.samples(line(body), LATER)], reader


class SpiedCells(list[str]):
    """Cells that note which of them are read."""

    seen: set[int]

    def __getitem__(self, at: Any) -> Any:
        self.seen |= set(range(len(self))[at]) if isinstance(at, slice) else {at}
        return super().__getitem__(at)


class Spied:
    """A message that notes which of its fields are read."""

    def __init__(self, of: Any, seen: set[str]) -> None:
        self.of, self.seen = of, seen

    def __getattr__(self, name: str) -> Any:
        self.seen.add(name)
        return getattr(self.of, name)

    def get(self, name: str, default: Any = None) -> Any:
        self.seen.add(name)
        return self.of.get(name, default)


def reads(fields: Fields) -> set[str]:
    return {name for name, row in fields.items() if isinstance(row, Read)}


@pytest.mark.parametrize("kind", SENTENCES)
def test_every_field_of_a_sentence_has_its_row_and_what_is_read_is_what_it_says(kind: str, monkeypatch) -> None:
    fields = SENTENCES[kind]
    assert sorted(fields) == sorted(names(kind))
    assert all(row for row in fields.values() if not isinstance(row, Read)), "a reason"
    seen, parse, ths = set[int](), pynmea2.parse, importlib.import_module("drivers.nmea.sentences")._Ths

    def spied(m: Any) -> Any:
        m.data = SpiedCells(m.data)
        m.data.seen = seen
        return m

    for body in (cells(kind), *(cells(kind, **{name: ""}) for name in reads(fields) - {"message_type"})):
        reader = begun()
        with monkeypatch.context() as m:
            m.setattr(pynmea2, "parse", lambda text: spied(parse(text)))
            m.setattr("drivers.nmea.sentences._Ths", lambda *of: spied(ths(*of)))
            reader.samples(line(body), LATER)
    assert {names(kind)[n] for n in seen} == reads(fields)


@pytest.mark.parametrize("kind", [kind for kind in SENTENCES if kind not in ("PSXN,20", "PSXN,22")])
def test_a_cell_that_means_nothing_gives_no_sample_or_what_stands_for_it(kind: str) -> None:
    good, reader = read(cells(kind))
    assert good, dict(reader.refused)
    for name in reads(SENTENCES[kind]) - {"message_type"}:
        row = SENTENCES[kind][name]
        for cell in row.absent:
            made, _ = read(cells(kind, **{name: cell}))
            assert bool(made) == bool(row.instead), (name, cell)


@pytest.mark.parametrize("field", ["hgt_qual", "head_qual", "rp_qual"])
def test_a_bad_quality_takes_parts_away(field: str) -> None:
    whole, _ = read(cells("PSXN,20"), cells("PSXN,23"))
    made, reader = read(cells("PSXN,20", **{field: "2"}), cells("PSXN,23"))
    assert str(made) != str(whole)
    assert reader.refused["bad_quality"] == 1


def test_every_field_of_a_position_report_has_its_row(monkeypatch) -> None:
    classes = [getattr(pyais.messages, f"MessageType{n}") for n in (1, 2, 3, 18, 19)]
    assert set(AIS) == {field.name for of in classes for field in of.fields()}
    seen, decode = set[str](), pyais.decode

    def made(**changed: float) -> Samples:
        return NmeaReader(MMSI).samples(ais(**changed), NOW)

    with monkeypatch.context() as m:
        m.setattr(pyais, "decode", lambda *of, **more: Spied(decode(*of, **more), seen))
        whole = made()
    assert len(whole) == 3
    assert seen == reads(AIS)
    for name, row in AIS.items():
        for cell in row.absent if isinstance(row, Read) else ():
            assert not cell or len(made(**{name: float(cell)})) < 3, (name, cell)


@pytest.mark.parametrize("pgn", MESSAGES)
def test_every_field_of_nmea_2000_has_its_row_and_none_is_a_value_where_it_has_none(pgn: int) -> None:
    backend = pytest.importorskip("nmea2000", reason="the extra ship is not installed").backend
    kind, fields = MESSAGES[pgn]
    [definition] = backend.DATABASE.pgn_variants(pgn)
    assert set(fields) == {field.id for field in definition.fields if not field.id.startswith("reserved")}
    values = {
        "heading": 1.0, "deviation": 0.0, "variation": 0.0, "reference": "True", "rate": 0.1, "heave": 0.2, "pitch": 0.0,
        "roll": 0.1, "latitude": 54.0, "longitude": 10.0, "altitude": 1.0, "method": "GNSS fix", "hdop": 1.0,
        "cogreference": "True", "cog": 1.0, "sog": 5.0, "windspeed": 5.0, "windangle": 1.0,
    }  # fmt: skip
    if kind == "wind":
        values["reference"] = "True (ground referenced to North)"
    seen = set[str]()
    for missing in (None, *values):
        spied: Any = Spied({**values, **({} if missing is None else {missing: None})}, seen)
        made = ShipSensors().samples(kind, "src 7", spied, Stamp(NOW, NOW, 0.01, "arrival"))
        assert made or missing is not None or kind == "variation"
    wanted = {name.lower() for name in reads(fields)}
    assert wanted <= seen
    assert seen - wanted <= {"altitude"}, "129025 shares the place of 129029, and has no height"
    for raw in (0xFF, 0x7F):  # all ones, and the highest values of fields with a sign
        size = sum(field.bit_length for field in definition.fields) // 8
        ends = {
            n for field in definition.fields for n in [(field.bit_offset + field.bit_length) // 8 - 1] if field.bit_length >= 16
        }
        data = bytes(raw if n in ends else 0xFF for n in range(size))
        made = BusReader(ShipSensors()).message(pgn, 7, data, Stamp(NOW, NOW, 0.01, "arrival"))
        small = raw == 0xFF and kind in ("turn", "heave", "attitude")  # -1 of the last digit, which a sea may bring
        assert small or made == []


def test_every_field_of_a_relative_position_has_its_row(monkeypatch) -> None:
    pyubx2 = pytest.importorskip("pyubx2", reason="the extra ship is not installed")
    types = importlib.import_module("pyubx2.ubxtypes_get").UBX_PAYLOADS_GET
    defined = set[str]()
    for version in ("NAV-RELPOSNED", "NAV-RELPOSNED-V0"):
        for name, kind in types[version].items():
            defined |= set(kind[1]) if name == "flags_bit" else {name}
    assert set(RELPOSNED) == defined
    seen, parse = set[str](), pyubx2.UBXReader.parse

    monkeypatch.setattr(pyubx2.UBXReader, "parse", staticmethod(lambda frame: Spied(parse(frame), seen)))
    flags = 1 | 1 << 1 | 1 << 2 | 2 << 3 | 1 << 5 | 1 << 7 | 1 << 8
    payload = (
        bytes([1, 0, 0, 0])
        + (1000).to_bytes(4, "little")
        + (100).to_bytes(4, "little") * 3
        + bytes(40)
        + flags.to_bytes(4, "little")
    )
    frame = pyubx2.UBXMessage(b"\x01", b"\x3c", pyubx2.GET, payload=payload).serialize()
    for mount in (None, 0.0):
        assert len(RelposReader(RelposOptions(mount_rad=mount)).take(frame, NOW)) == 1
    assert seen & set(RELPOSNED) == reads(RELPOSNED)
