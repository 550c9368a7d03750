"""AT commands of UDP port 5556: `AT*NAME=<sequence>[,arguments]<CR>`, encoded and decoded without I/O.

Floats travel as the signed decimal of the int32 with the same bits; text in double quotes. Source: Parrot SDK 2.0.1
`at_msgs_ids.h` and the developer guide, checked against a log of a real session.
"""

import math
import re
import struct
from functools import lru_cache
from typing import Annotated, Any, ClassVar

from msgspec import Struct, structs

from drivers.ardrone.counters import Refusal

REF_BASE = 0x11540000
"""Bits 18, 20, 22, 24, 28, which are always set. A flying drone lands when REF comes without `REF_TAKE_OFF`."""
REF_TAKE_OFF = 1 << 9
"""Bit of REF that keeps the drone in the air, and starts its motors if it is on the ground."""
REF_EMERGENCY = 1 << 8
"""Bit of REF whose rising edge toggles the emergency state."""
PCMD_PROGRESSIVE = 1
"""Fly by the sticks; without it the drone holds its place by itself."""
CTRL_CONFIGURATION = 4
"""Send the configuration on port 5559."""
CTRL_ACK = 5
"""Clear the command acknowledge bit of navdata."""
CTRL_CUSTOM_IDS = 6
"""Mode of a CTRL command that lists the identifiers of sessions, users and applications."""
DATAGRAM_MAX = 1024
"""The size of the drone's buffer for one datagram of commands, bytes."""

_INT = "int"
_FLOAT = "float"
_TEXT = "text"
_MAYBE_INT = "maybe int"
Int = Annotated[int, _INT]
Float = Annotated[float, _FLOAT]
Text = Annotated[str, _TEXT]
MaybeInt = Annotated[int | None, _MAYBE_INT]
_DIGITS_MOST = 10  # number of digits of the longest argument, 4294967295


class Ref(Struct, frozen=True):
    """Command take-off, landing or emergency; `bits` is the whole word, see `REF_BASE`."""

    NAME: ClassVar[str] = "REF"
    bits: Int

    @property
    def take_off(self) -> bool:
        """True if the command orders the drone to fly, as opposed to land."""
        return bool(self.bits & REF_TAKE_OFF)

    @property
    def emergency(self) -> bool:
        """True if the emergency bit is set; its rising edge toggles the emergency state."""
        return bool(self.bits & REF_EMERGENCY)


class Pcmd(Struct, frozen=True):
    """Set the sticks, fractions of the configured limits: roll + right, pitch + backward, gaz + up, yaw + clockwise."""

    NAME: ClassVar[str] = "PCMD"
    flags: Int
    roll: Float
    pitch: Float
    gaz: Float
    yaw: Float


class PcmdMag(Pcmd, frozen=True):
    """`Pcmd` with the pilot's own heading (-1..1 is -180..180 degrees) and its accuracy."""

    NAME: ClassVar[str] = "PCMD_MAG"
    psi: Float
    psi_accuracy: Float


class Ftrim(Struct, frozen=True):
    """Take the present attitude as level; it is sent only on the ground."""

    NAME: ClassVar[str] = "FTRIM"


class Calib(Struct, frozen=True):
    """Calibrate a device (0 is the magnetometer: the drone turns in flight)."""

    NAME: ClassVar[str] = "CALIB"
    device: Int


class Config(Struct, frozen=True):
    """Set one configuration key."""

    NAME: ClassVar[str] = "CONFIG"
    key: Text
    value: Text


class ConfigIds(Struct, frozen=True):
    """Name the session, user and application whose configuration the next `Config` sets; eight hexadecimal digits each."""

    NAME: ClassVar[str] = "CONFIG_IDS"
    session: Text
    user: Text
    application: Text


class Ctrl(Struct, frozen=True):
    """Make a request by its number; some clients leave the second number out (None)."""

    NAME: ClassVar[str] = "CTRL"
    mode: Int
    misc: MaybeInt = 0


class ComWdg(Struct, frozen=True):
    """Reset the communication watchdog."""

    NAME: ClassVar[str] = "COMWDG"


class Led(Struct, frozen=True):
    """Play a light animation."""

    NAME: ClassVar[str] = "LED"
    animation: Int
    frequency_hz: Float
    duration_s: Int


class Anim(Struct, frozen=True):
    """Play a flight animation."""

    NAME: ClassVar[str] = "ANIM"
    animation: Int
    duration_ms: Int


class Pmode(Struct, frozen=True):
    """Send PMODE, which is undocumented; clients send 2 at start."""

    NAME: ClassVar[str] = "PMODE"
    mode: Int


class Misc(Struct, frozen=True):
    """Send MISC, which is undocumented; clients send 2, 20, 2000, 3000 at start."""

    NAME: ClassVar[str] = "MISC"
    a: Int = 2
    b: Int = 20
    c: Int = 2000
    d: Int = 3000


AtCommand = Ref | Pcmd | PcmdMag | Ftrim | Calib | Config | ConfigIds | Ctrl | ComWdg | Led | Anim | Pmode | Misc

_CLASSES: dict[str, type[Any]] = {cls.NAME: cls for cls in AtCommand.__args__}
_KINDS: dict[type[Any], tuple[tuple[str, str], ...]] = {
    cls: tuple((field.name, field.type.__metadata__[0]) for field in structs.fields(cls)) for cls in _CLASSES.values()
}
_NAMED: dict[bytes, tuple[type[Any], list[str]]] = {
    name.encode(): (cls, [kind for _, kind in _KINDS[cls]]) for name, cls in _CLASSES.items()
}
"""The class of each command and the kinds of its arguments, by its name on the wire."""
_START = b"AT*"
_COMMAND = re.compile(rb"AT\*([A-Z_]{2,16})=(\d{1,10})(?:,(.*))?", re.DOTALL)
_ARGUMENTS = re.compile(rb'"[^"]*"|[^,"]*')
_SINGLE, _BITS, _SIGNED_BITS = struct.Struct("<f"), struct.Struct("<I"), struct.Struct("<i")
_CLEAN_TEXT = re.compile(r'[^"\x00-\x1f\x7f]*')


def encode(sequence: int, command: AtCommand) -> bytes:
    """Return one command with its carriage return; join several for one datagram of at most `DATAGRAM_MAX` bytes.

    Raises:
        ValueError: a number that does not fit 32 bits or is not finite, or text with quotes, control or non-ASCII characters.
    """
    return numbered(sequence, command.NAME, arguments(command))


def numbered(sequence: int, name: str, arguments: str) -> bytes:
    """Return the bytes of a command whose `arguments` are text already, each preceded by its comma."""
    return f"AT*{name}={sequence}{arguments}\r".encode("ascii")


def arguments(command: AtCommand) -> str:
    """Return the arguments of a command as they follow its sequence number, each preceded by its comma.

    Raises:
        ValueError: as for `encode`.
    """
    words = [""]
    for name, kind in _KINDS[type(command)]:
        value = getattr(command, name)
        if kind == _FLOAT:
            if not math.isfinite(value):
                raise ValueError(f"{command.NAME}: {name} must be finite, got {value!r}")
            words.append(str(_bits_of(value)))
        elif kind == _TEXT:
            if not value.isascii() or not _CLEAN_TEXT.fullmatch(value):
                raise ValueError(f"{command.NAME}: {name} cannot travel as text: {value!r}")
            words.append(f'"{value}"')
        elif value is not None:
            if not -(1 << 31) <= value < 1 << 32:
                raise ValueError(f"{command.NAME}: {name} must fit 32 bits, got {value!r}")
            words.append(str(value))
    return ",".join(words)


def decode(datagram: bytes) -> list[tuple[int, AtCommand] | Refusal]:
    """Return every command of a datagram in order, each as (sequence, command) or as the reason for its refusal. Never raises.

    A line feed ends a command as well as a carriage return. The bytes before the `AT*` of a good command make one refusal.
    """
    out: list[tuple[int, AtCommand] | Refusal] = []
    *lines, rest = datagram.replace(b"\n", b"\r").split(b"\r")
    for line in lines:
        if not line:
            continue
        result = _decode_one(line)
        if (
            isinstance(result, Refusal)
            and (at := line.rfind(_START)) > 0
            and not isinstance(later := _decode_one(line[at:]), Refusal)
        ):
            out.append(result)
            result = later
        out.append(result)
    if rest.strip(b"\x00 "):
        out.append(Refusal.TORN)
    return out


def _decode_one(line: bytes) -> tuple[int, AtCommand] | Refusal:
    if not line.startswith(_START):
        return Refusal.BAD_MAGIC
    match = _COMMAND.fullmatch(line)
    if match is None:
        return Refusal.BAD_ARGUMENTS
    name, sequence, rest = match.groups()
    if int(sequence) >= 1 << 32:
        return Refusal.UNKNOWN_COMMAND if name not in _NAMED else Refusal.BAD_ARGUMENTS
    command = _steady(name, rest) if name in _STEADY else _read(name, rest)
    return command if isinstance(command, Refusal) else (int(sequence), command)


def _read(name: bytes, rest: bytes | None) -> AtCommand | Refusal:
    """Return the command of this name with these arguments."""
    known = _NAMED.get(name)
    if known is None:
        return Refusal.UNKNOWN_COMMAND
    cls, kinds = known
    words = _split(rest) if rest is not None else []
    left_out = bool(kinds) and kinds[-1] == _MAYBE_INT and len(words) == len(kinds) - 1
    values = _values(words, kinds[:-1] if left_out else kinds)
    if values is None:
        return Refusal.BAD_ARGUMENTS
    made: AtCommand = cls(*values, *([None] if left_out else []))
    return made


_STEADY = (b"REF", b"COMWDG")
"""Commands that are sent again and again without a change."""
_steady = lru_cache(maxsize=16)(_read)


def _split(rest: bytes) -> list[bytes]:
    """Return the arguments between commas; text that follows a closing quote without a comma gives an empty, unreadable one."""
    if b'"' not in rest:
        return rest.split(b",")
    out: list[bytes] = []
    at = 0
    while True:
        match = _ARGUMENTS.match(rest, at)
        assert match is not None
        out.append(match.group())
        at = match.end() + 1
        if match.end() >= len(rest):
            return out
        if rest[match.end()] != ord(","):
            return [*out, b""]


def _values(words: list[bytes], kinds: list[str]) -> list[Any] | None:
    """Return the arguments in their types; None when their number is wrong or one is unreadable."""
    if len(words) != len(kinds):
        return None
    out: list[Any] = []
    for word, kind in zip(words, kinds, strict=True):
        if kind == _TEXT:
            text = word[1:-1].decode("latin-1")
            if len(word) < 2 or word[:1] != b'"' or word[-1:] != b'"' or not text.isascii() or not _CLEAN_TEXT.fullmatch(text):
                return None
            out.append(text)
            continue
        digits = word[1:] if word.startswith(b"-") else word
        if len(digits) > _DIGITS_MOST or not digits.isdigit() or not -(1 << 31) <= (number := int(word)) < 1 << 32:
            return None
        if kind != _FLOAT:
            out.append(number)
            continue
        value: float = _SINGLE.unpack(_BITS.pack(number & 0xFFFFFFFF))[0]
        if not math.isfinite(value):
            return None
        out.append(value)
    return out


def unit(stick: float) -> float:
    """Return a stick's position within its ends, -1 to 1."""
    return min(1.0, max(-1.0, stick))


def _bits_of(value: float) -> int:
    """Return the int32 with the bits of the nearest float32.

    Raises:
        ValueError: the value is beyond the largest float32.
    """
    try:
        bits: int = _SIGNED_BITS.unpack(_SINGLE.pack(value))[0]
    except OverflowError as why:
        raise ValueError(f"{value!r} does not fit a 32-bit float") from why
    return bits


class SequenceGate:
    """The receiver's rule: numbers must grow; 1 starts the count again, and so does an expired communication watchdog."""

    def __init__(self) -> None:
        self._last = 0

    def accepts(self, sequence: int) -> bool:
        """Return whether a command of this number is to be obeyed, and remember it if so."""
        if sequence != 1 and sequence <= self._last:
            return False
        self._last = sequence
        return True

    def reset(self) -> None:
        """Accept any sequence number next, as the drone does after its communication watchdog expired."""
        self._last = 0
