"""NMEA 2000 by CAN and by gateways, and Signal K, to the messages of `ship_sensors`.

The package `nmea2000`, which carries canboat's database and decoder, takes frames, lines and messages apart; the extra `ship` has
it. Lines of a gateway are recognized by themselves: Actisense's N2K ASCII, Yacht Devices' RAW, canboat's plain lines and JSON,
can-utils' candump, SeaSmart and iKonvert; so are Actisense's binary messages (NGT-1) and Signal K's deltas.

A device keeps its NAME (PGN 60928) and changes its address when others come or power returns: what it reports bears the NAME.

Source: canboat's PGN database and formats; ISO 11783-5 for addresses and NAMEs; Signal K specification 1.7, delta format and
the paths of vessels.
"""

import logging
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import msgspec

from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.nmea.definitions import MESSAGES, Read
from drivers.nmea.ship_sensors import Samples, ShipSensors, Values
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp, seconds_between

log = logging.getLogger(__name__)

CLAIM = 60928
"""The message by which a device says its NAME."""
KINDS: Mapping[int, tuple[str, tuple[str, ...]]] = {
    pgn: (kind, tuple(name for name, row in fields.items() if isinstance(row, Read))) for pgn, (kind, fields) in MESSAGES.items()
}
"""Messages that are used, with the fields that a payload must hold: the decoder reads one that is cut as small numbers."""
_TEXTS = {
    "n2k_ascii_raw": "actisense_ascii", "basic_string": "plain", "can_frame_ascii": "ydwg02", "candump2": "candump",
    "candump3": "candump", "pcdin": "seasmart", "pdgy": "ikonvert",
}  # fmt: skip
"""Names of the formats as the package recognizes them, and as its parser wants them."""
_FRAMES = ("ydwg02", "candump")
"""Formats of single CAN frames; the others hold whole messages, and `plain` either."""
_DLE_STX = b"\x10\x02"
_LINE_MAX = 4096  # longest line that is read, characters
_TORN_S = 0.75
"""Age at which the frames of a long message wait no longer for the next one (ISO 11783-3 waits as long)."""
_ARRIVAL_SIGMA_S = 0.05  # standard deviation of a stamp by arrival
_OF_DAY = ClockMapOptions(wrap_ns=86_400 * NS_PER_S, resolution_s=0.001, floor_sigma_s=_ARRIVAL_SIGMA_S, jump_s=5.0)
_CLOCKS_MAX = 64  # senders whose times of day are mapped
_CLOCK = re.compile(r"(?<!\d)([01]\d|2[0-3]):?([0-5]\d):?([0-5]\d\.\d{1,6})")
_TURN_RAD = 2.0 * math.pi  # a larger direction shows that the source sends degrees
_DIRECTIONS = ("heading", "cog", "windangle", "yaw")
_ANGLES = (*_DIRECTIONS, "roll", "pitch", "rate", "deviation", "variation")
_SURE = 5
"""Directions with more digits than a degree has in canboat's JSON, after which its angles count as radians."""
_PAIR_S = 1.0  # age up to which one message's values complete another's
_ADDRESS_MAX = 251  # the highest address of a device
_NAMES_MAX = 252
"""NAMEs that are kept."""
_NEW_S = 10.0
"""Age up to which a device without a NAME may still get another name here: nothing is learnt of it yet."""
_PATHS: tuple[tuple[str, Mapping[str, str], Mapping[str, str]], ...] = (
    ("attitude", {"": "navigation.attitude"}, {}),
    ("heave", {"heave": "environment.heave"}, {}),
    ("turn", {"rate": "navigation.rateOfTurn"}, {}),
    ("variation", {"variation": "navigation.magneticVariation"}, {}),
    ("heading", {"heading": "navigation.headingTrue"}, {"reference": "True"}),
    ("heading", {"heading": "navigation.headingMagnetic"}, {"reference": "Magnetic"}),
    ("gnss", {"method": "navigation.gnss.methodQuality"}, {}),
    ("position", {"": "navigation.position"}, {}),
    ("course", {"sog": "navigation.speedOverGround", "cog": "navigation.courseOverGroundTrue"}, {"cogreference": "True"}),
    (
        "wind",
        {"windspeed": "environment.wind.speedOverGround", "windangle": "environment.wind.directionTrue"},
        {"reference": "True (ground referenced to North)"},
    ),
    (
        "wind",
        {"windspeed": "environment.wind.speedApparent", "windangle": "environment.wind.angleApparent"},
        {"reference": "Apparent"},
    ),
)
"""The paths of Signal K that make up a message of each kind, by its fields, and what they say besides."""
_USED_PATHS = {path for _, fields, _ in _PATHS for path in fields.values()}


@cache
def _backend() -> Any:
    from nmea2000 import backend, input_formats

    return backend, backend.canboat, input_formats.detect_format


def question() -> tuple[int, bytes]:
    """Return the CAN identifier and data of the request for the NAMEs of all devices, from one that has no address."""
    return int(_backend()[1].can_id_compose(6, 59904, 254, 255)), CLAIM.to_bytes(3, "little")


@cache
def _bytes_needed(pgn: int) -> int:
    fields = {field.id: field for field in _backend()[0].DATABASE.pgn_variants(pgn)[0].fields}
    return max(int(fields[name].bit_offset + fields[name].bit_length + 7) // 8 for name in KINDS[pgn][1])


def greeting() -> bytes:
    """Return what makes an NGT-1 send all messages."""
    return bytes(_backend()[1].GatewayCodec("ngt1").open())


class Devices:
    """The devices of a network and their addresses.

    A device has its NAME here. If it sent for long before it sent that, it keeps the name of its first address.
    """

    def __init__(self) -> None:
        self._heard: dict[int, MonoNs] = {}
        """Arrival of the first message from each address."""
        self._names: dict[str, str] = {}
        """The name of each device here, by its NAME."""
        self._now: dict[int, str] = {}
        """The name of the device at each address."""

    def name(self, address: int, now: MonoNs) -> str:
        """Return what the device is called that sends from an address."""
        self._heard.setdefault(address, now)
        bare = f"src {address}"
        return self._now.get(address) or (f"{bare} anew" if bare in self._names.values() else bare)

    def claimed(self, name: str, address: int, now: MonoNs) -> None:
        """Note that the device with a NAME has an address, and log it if it had another one."""
        known = self._names.get(name)
        if not 0 <= address <= _ADDRESS_MAX or (known is None and len(self._names) >= _NAMES_MAX):
            return
        if known is None:
            long = seconds_between(self._heard.get(address, now), now) > _NEW_S
            known = self._names[name] = self.name(address, now) if long and address not in self._now else name
            log.info("the ship's network: the device at address %d is %s, called %s here", address, name, known)
        if self._now.get(address) == known:
            return
        before = [other for other, called in self._now.items() if called == known]
        for other in before:
            del self._now[other]
            log.warning("the ship's network: %s moved from address %d to %d and keeps its name here", known, other, address)
        self._now[address] = known


class BusReader:
    """Reads what one wire carries, in whatever format it is.

    Args:
        sensors: makes the samples.
    """

    def __init__(self, sensors: ShipSensors) -> None:
        self._sensors = sensors
        self._devices = Devices()
        self._refused: Counter[str] = Counter()
        self._rest = b""
        self._binary: Any = None
        self._open: dict[tuple[int, int], tuple[Any, MonoNs]] = {}
        self._clocks: dict[str, ClockMap] = {}
        """Clocks of the gateway, and of the sources of Signal K, which stamp each by its own."""
        self._json_units: str | None = None
        self._sure = 0
        self._self: object = None
        self._newest: dict[tuple[str, str], tuple[MonoNs, Any]] = {}

    @property
    def refused(self) -> Counter[str]:
        """The number of lines and messages that were not used, by reason."""
        return self._refused + self._sensors.refused

    def restart(self) -> None:
        """Forget what a connection before this one left unfinished."""
        self._rest, self._binary, self._json_units, self._sure, self._self = b"", None, None, 0, None
        self._open.clear()

    def feed(self, data: bytes, received_at: MonoNs) -> Samples:
        """Return the samples in the next bytes of a stream."""
        data = self._rest + data
        if self._binary is None and _DLE_STX in data:
            self._binary, self._rest = _backend()[1].GatewayCodec("ngt1"), b""
        if self._binary is not None:
            return self._actisense(data, received_at)
        *lines, self._rest = data.split(b"\n")
        if len(self._rest) > _LINE_MAX:
            self._refused["too_long"] += 1
            self._rest = b""
        return [sample for line in lines for sample in self.line(line, received_at)]

    def line(self, line: bytes, received_at: MonoNs) -> Samples:
        """Return the samples in one line."""
        text = line.decode("utf-8", "replace").strip()
        if not text or text.startswith("#"):
            return []
        if len(text) > _LINE_MAX:
            self._refused["too_long"] += 1
            return []
        return self._guarded(self._json if text.startswith("{") else self._text, text, received_at)

    def _guarded(self, read: Callable[..., Samples], *read_of: Any) -> Samples:
        try:
            return read(*read_of)
        except Exception:  # the packages raise many kinds on damaged bytes, and none of it may end the part
            self._refused["malformed"] += 1
            return []

    def _text(self, text: str, received_at: MonoNs) -> Samples:
        form = _TEXTS[_backend()[2](text).value]
        _, pgn, source, _, data = _backend()[1].parse_line(form, text)
        stamp = self._stamp(text if form in ("actisense_ascii", "plain", "ydwg02") else "", received_at)
        is_frame = form in _FRAMES or (form == "plain" and len(data) <= 8)
        return (self.frame if is_frame else self.message)(pgn, source, data, stamp)

    def _stamp(self, text: str, received_at: MonoNs, whose: str = "the ship's gateway") -> Stamp:
        """Return when a line's message was measured, by its time of day where the text has one."""
        found = _CLOCK.search(text[:32])
        if found is None or (whose not in self._clocks and len(self._clocks) >= _CLOCKS_MAX):
            return Stamp(received_at, received_at, _ARRIVAL_SIGMA_S, "arrival")
        of_day = (int(found[1]) * 3600 + int(found[2]) * 60) * NS_PER_S + round(float(found[3]) * NS_PER_S)
        return self._clocks.setdefault(whose, ClockMap(replace(_OF_DAY, name=whose))).stamp(of_day, received_at)

    def arrived(self, can_id: int, data: bytes, received_at: MonoNs) -> Samples:
        """Return the samples of a frame of a CAN bus that arrived now."""
        _, pgn, source, _ = _backend()[1].can_id_decompose(can_id)
        return self._guarded(self.frame, pgn, source, data, self._stamp("", received_at))

    def frame(self, pgn: int, source: int, data: bytes, stamp: Stamp) -> Samples:
        """Return the samples of a CAN frame, which is a whole message or a part of a long one."""
        if pgn not in KINDS or not _backend()[0].is_fast_pgn(pgn):
            return self.message(pgn, source, data, stamp)
        joiner, last = self._open.pop((pgn, source), (None, stamp.received_at))
        if not data:
            self._refused["malformed"] += 1
            return []
        # Its sequence number has three bits: a frame that was lost must not be filled by one of eight messages later.
        if joiner is not None and (data[0] & 0x1F == 0 or seconds_between(last, stamp.received_at) > _TORN_S):
            self._refused["torn"] += 1
            joiner = None
        joiner = joiner or _backend()[1].Reassembler()
        payload = joiner.push(pgn, data, source)
        if payload is not None:
            return self.message(pgn, source, payload, stamp)
        self._open[pgn, source] = joiner, stamp.received_at
        return []

    def message(self, pgn: int, source: int, payload: bytes, stamp: Stamp) -> Samples:
        """Return the samples of a whole message."""
        if pgn == CLAIM and len(payload) == 8:
            self._devices.claimed(f"{int.from_bytes(payload, 'little'):016x}", source, stamp.received_at)
            return []
        if pgn not in KINDS:
            self._refused["other_message"] += 1
            return []
        if len(payload) < _bytes_needed(pgn):
            self._refused["too_short"] += 1
            return []
        decoded = _backend()[0].decode(pgn, payload, source, 255, 3, "si")
        if decoded is None:
            self._refused["malformed"] += 1
            return []
        values = {field.id.lower(): field.value for field in decoded.fields}
        return self._sensors.samples(KINDS[pgn][0], self._devices.name(source, stamp.received_at), values, stamp)

    def _actisense(self, data: bytes, received_at: MonoNs) -> Samples:
        out: Samples = []
        for event, what in self._binary.receive(data):
            if event == "frame":
                _, pgn, source, _, payload = what
                out += self._guarded(self.message, pgn, source, payload, self._stamp("", received_at))
            elif event == "error":
                self._refused["malformed"] += 1
        return out

    def _json(self, text: str, received_at: MonoNs) -> Samples:
        found = msgspec.json.decode(text)
        if "units" in found and "fields" not in found:
            self._json_units = {"si": "si", "std": "deg"}.get(found["units"])
            return []
        if "pgn" in found:
            return self._canboat(found, received_at)
        if "updates" in found:
            return self._delta(found, received_at)
        self._self = found.get("self", self._self)
        return []

    def _canboat(self, found: dict[str, Any], received_at: MonoNs) -> Samples:
        if found["pgn"] not in (*KINDS, CLAIM):
            self._refused["other_message"] += 1
            return []
        values: dict[str, Any] = {
            name.replace(" ", "").lower(): value.get("name", value.get("value")) if isinstance(value, dict) else value
            for name, value in found["fields"].items()
        }
        source = int(found["src"])
        if found["pgn"] == CLAIM:
            self._devices.claimed(f"{values['manufacturercode']} {values['uniquenumber']}"[:64], source, received_at)
            return []
        self._learn_units(values)
        if self._json_units is None and any(name in values for name in _ANGLES):
            self._refused["no_units"] += 1
            return []
        if self._json_units == "deg":
            values |= {name: math.radians(values[name]) for name in _ANGLES if values.get(name) is not None}
        stamp = self._stamp(str(found.get("timestamp", ""))[-16:], received_at)
        return self._sensors.samples(KINDS[found["pgn"]][0], self._devices.name(source, received_at), values, stamp)

    def _learn_units(self, values: Values) -> None:
        """Note whether angles are degrees or radians, which only the first line of a stream says.

        A direction beyond a turn in radians is of degrees. Degrees have one decimal, radians four: canboat's resolution.
        """
        for value in (values[name] for name in _DIRECTIONS if isinstance(values.get(name), float)):
            if abs(value) > _TURN_RAD:
                self._json_units = "deg"
            elif self._json_units is None and abs(value - round(value, 1)) > 1e-6:
                self._sure += 1
                self._json_units = "si" if self._sure >= _SURE else None

    def _delta(self, found: dict[str, Any], received_at: MonoNs) -> Samples:
        if found.get("context", "vessels.self") not in ("vessels.self", self._self, f"vessels.{self._self}"):
            self._refused["other_ship"] += 1
            return []
        out: Samples = []
        for update in found["updates"]:
            named = update.get("source", {})
            label = update.get("$source") or f"{named.get('label', '')}.{named.get('src', '')}"
            source = str(named.get("canName") or label)
            stamp = self._stamp(str(update.get("timestamp", ""))[-16:], received_at, source)
            out += [sample for message in self._messages(update, source, stamp) for sample in message]
        return out

    def _messages(self, update: dict[str, Any], source: str, stamp: Stamp) -> Iterator[Samples]:
        new = {one["path"]: one["value"] for one in update.get("values", ()) if one["path"] in _USED_PATHS}
        if len(self._newest) > 1024:
            self._newest.clear()
        self._newest |= {(source, path): (stamp.received_at, value) for path, value in new.items()}
        for kind, fields, besides in _PATHS:
            if new.keys().isdisjoint(fields.values()):
                continue
            got = {name: self._newest.get((source, path)) for name, path in fields.items()}
            values: dict[str, Any] = dict(besides)
            for name, at_value in got.items():
                value = None if at_value is None or seconds_between(at_value[0], stamp.received_at) > _PAIR_S else at_value[1]
                values |= value or {} if not name else {name: value}
            yield self._sensors.samples(kind, source, values, stamp)
