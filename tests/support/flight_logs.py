"""Flight logs of both stacks, written as the programs write them: dataflash (.bin) and ULog (.ulg)."""

import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

_FORMATS = {
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "PARM": (130, "QNf", "TimeUS,Name,Value"),
    "MSG": (131, "QZ", "TimeUS,Message"),
    "EV": (132, "QB", "TimeUS,Id"),
    "ERR": (133, "QBB", "TimeUS,Subsys,ECode"),
    "VIBE": (134, "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip"),
    "XKF4": (135, "QBccccB", "TimeUS,C,SV,SP,SH,SM,PI"),
    "PL": (136, "QBB", "TimeUS,Heal,TAcq"),
}
_CODES = {"Q": "Q", "B": "B", "I": "I", "f": "f", "c": "h", "n": "4s", "N": "16s", "Z": "64s"}
_ULOG_TYPES = {"bool": "?", "uint8_t": "B", "uint32_t": "I", "float": "f"}


def _layout(form: str) -> str:
    return "<" + "".join(_CODES[c] for c in form)


def _row(name: str, *values: object, form: str = "") -> bytes:
    number, usual, _ = _FORMATS[name]
    packed = [v.encode() if isinstance(v, str) else v for v in values]
    return b"\xa3\x95" + bytes([number]) + struct.pack(_layout(form or usual), *packed)


def dataflash(
    path: Path,
    parameters: Mapping[str, float],
    rows: Sequence[tuple[float, str, Sequence[object]]] = (),
    *,
    defaults: bool = False,
) -> Path:
    """Write an ArduCopter 4.5.7 log.

    Args:
        rows: (seconds, message, its values after the time), in order of time.
        defaults: whether parameters have their defaults beside them; not a number for those of `parameters`.
    """
    formats = _FORMATS | ({"PARM": (130, "QNff", "TimeUS,Name,Value,Default")} if defaults else {})
    data = b"".join(
        _row("FMT", number, 3 + struct.calcsize(_layout(form)), name, form, columns)
        for name, (number, form, columns) in formats.items()
    )
    data += _row("MSG", 0, "ArduCopter V4.5.7 (2a3dc4b7)")
    unknown = (math.nan,) if defaults else ()
    data += b"".join(_row("PARM", 0, name, float(value), *unknown, form=formats["PARM"][1]) for name, value in parameters.items())
    path.write_bytes(
        data + b"".join(_row(name, round(1e6 * at_s), *values, form=formats[name][1]) for at_s, name, values in rows)
    )
    return path


def _message(kind: str, data: bytes) -> bytes:
    return struct.pack("<HB", len(data), ord(kind)) + data


def _parameter(name: str, value: float) -> bytes:
    kind, layout = ("int32_t", "<i") if isinstance(value, int) else ("float", "<f")
    key = f"{kind} {name}".encode()
    return _message("P", bytes([len(key)]) + key + struct.pack(layout, value))


def ulog(
    path: Path,
    parameters: Mapping[str, float],
    topics: Mapping[str, Mapping[str, str]],
    rows: Sequence[tuple[float, str, Sequence[object]]] = (),
    texts: Sequence[tuple[float, str]] = (),
) -> Path:
    """Write a log of PX4 1.16.2.

    Args:
        parameters: integers are written as integers.
        topics: type by field, by topic; the time stamp is added.
        rows: (seconds, topic, its values), in order of time.
        texts: (seconds, text).
    """
    key = b"uint32_t ver_sw_release"
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    head += _message("I", bytes([len(key)]) + key + struct.pack("<I", 0x011002FF))
    for name, fields in topics.items():
        inner = "".join(f"{kind} {field};" for field, kind in fields.items())
        head += _message("F", f"{name}:uint64_t timestamp;{inner}".encode())
    head += b"".join(_parameter(name, value) for name, value in parameters.items())
    head += b"".join(_message("A", struct.pack("<BH", 0, i) + name.encode()) for i, name in enumerate(topics))
    numbers = {name: i for i, name in enumerate(topics)}
    body = []
    for at_s, name, values in rows:
        layout = "<HQ" + "".join(_ULOG_TYPES[kind] for kind in topics[name].values())
        body.append((at_s, _message("D", struct.pack(layout, numbers[name], round(1e6 * at_s), *values))))
    body += [(at_s, _message("L", b"4" + struct.pack("<Q", round(1e6 * at_s)) + text.encode())) for at_s, text in texts]
    path.write_bytes(head + b"".join(data for _, data in sorted(body, key=lambda one: one[0])))
    return path
