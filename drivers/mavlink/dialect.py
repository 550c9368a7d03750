"""The MAVLink dialect in use: `common` as pymavlink ships it, plus the messages that it lacks.

TIMESYNC with its target fields and six further messages are built here from their definitions.

    message = mav.MAVLink_heartbeat_message(...)     # any message of `common`
    message = ComponentInformationBasic(...)         # a message added by this module

Source of the added definitions: mavlink.io message definitions, `common` (396, 397, 410), `ardupilotmega` (158) and `development`
(510, 511). The wire order and the CRC seed of a message follow from its fields: mavlink.io, "MAVLink serialization".
"""

import re
import struct
from typing import Any

from pymavlink.dialects.v20 import common as mav

__all__ = [
    "ComponentInformationBasic",
    "ComponentMetadata",
    "Event",
    "Message",
    "MountStatus",
    "TargetAbsolute",
    "TargetRelative",
    "TimeSyncV2",
    "crc_extra_of",
    "define",
    "mav",
    "ms_since_boot",
    "unfit_field",
]

Message = Any
"""An object of a pymavlink message class; pymavlink is not typed."""

_FORMATS = {
    "char": ("s", 1), "uint8_t": ("B", 1), "int8_t": ("b", 1), "uint16_t": ("H", 2), "int16_t": ("h", 2), "uint32_t": ("I", 4),
    "int32_t": ("i", 4), "float": ("f", 4), "uint64_t": ("Q", 8), "int64_t": ("q", 8), "double": ("d", 8),
}  # fmt: skip
_ARRAY = re.compile(r"^(\w+)\[(\d+)\]$")


def _split(kind: str) -> tuple[str, int]:
    """Return the base type and the array length (0 for a scalar) of a type as a definition writes it."""
    array = _ARRAY.match(kind)
    return (array[1], int(array[2])) if array else (kind, 0)


def _wire_order(fields: list[tuple[str, str]]) -> list[int]:
    """Return the indices of the fields in wire order: larger elements first, otherwise as defined."""
    return sorted(range(len(fields)), key=lambda i: -_FORMATS[_split(fields[i][0])[0]][1])


def crc_extra_of(name: str, fields: list[tuple[str, str]]) -> int:
    """Return the CRC seed of a message.

    Args:
        name: name of the message.
        fields: (type, name) of each field in the order of the definition, without the extension fields.
    """
    crc = mav.x25crc()
    crc.accumulate((name + " ").encode())
    for i in _wire_order(fields):
        base, length = _split(fields[i][0])
        crc.accumulate(f"{base} {fields[i][1]} ".encode())
        if length:
            crc.accumulate(bytes([length]))
    return (int(crc.crc) & 0xFF) ^ (int(crc.crc) >> 8)


def _fields_of(text: str) -> list[tuple[str, str]]:
    """Return the (type, name) of each field of a definition."""
    return [(kind, name) for kind, _, name in (field.strip().partition(" ") for field in text.split(",") if field.strip())]


def define(msg_id: int, name: str, definition: str, extension: str = "", *, replace: bool = False) -> Any:
    """Return a new message class like those of the dialect, and register it with the dialect's parser.

    Args:
        msg_id: number of the message.
        name: name of the message.
        definition: type and name of each field with commas between, types as mavlink.io writes them ("float[3] vel").
        extension: likewise the fields after `<extensions/>`; they are numbers and 0 if a sender leaves them out.
        replace: whether to replace a message of the dialect.

    Raises:
        ValueError: the dialect already has a message of that number and `replace` is False, or its CRC seed differs.
    """
    fields, extensions = _fields_of(definition), _fields_of(extension)
    known = mav.mavlink_map.get(msg_id)
    seed = crc_extra_of(name, fields)
    if known is not None and not (replace and known.crc_extra == seed):
        raise ValueError(f"the dialect has message {msg_id} already")
    order = [*_wire_order(fields), *range(len(fields), len(fields) + len(extensions))]
    fields = [*fields, *extensions]
    names = [field for _, field in fields]
    absent = {field: 0 for _, field in extensions}
    parts = [(*_FORMATS[_split(fields[i][0])[0]], *_split(fields[i][0])) for i in order]
    layout = "<" + "".join(f"{length or ''}{code}" for code, _, _, length in parts)

    def initialise(self: Any, *values: Any, **named: Any) -> None:
        mav.MAVLink_message.__init__(self, msg_id, name)
        self._fieldnames = names
        given = absent | dict(zip(names, values, strict=False)) | named
        if set(given) != set(names) or len(values) > len(names):
            raise TypeError(f"{name} takes {', '.join(names)}")
        for (kind, field), value in zip(fields, (given[n] for n in names), strict=True):
            text = _split(kind)[0] == "char" and isinstance(value, bytes)
            setattr(self, field, value.split(b"\0", 1)[0].decode("utf-8", errors="replace") if text else value)

    def pack(self: Any, link: Any, force_mavlink1: bool = False) -> bytes:
        flat: list[Any] = []
        for i in order:
            (base, length), value = _split(fields[i][0]), getattr(self, fields[i][1])
            if base == "char":
                flat.append(value.encode())
            elif length:
                flat += [value[n] for n in range(length)]
            else:
                flat.append(value)
        return bytes(self._pack(link, self.crc_extra, struct.pack(layout, *flat), force_mavlink1=force_mavlink1))

    attributes = {
        "__doc__": f"{name} ({msg_id}): {', '.join(f'{n}: {t}' for t, n in fields)}.",
        "__init__": initialise,
        "pack": pack,
        "id": msg_id,
        "msgname": name,
        "fieldnames": names,
        "ordered_fieldnames": [names[i] for i in order],
        "fieldtypes": [_split(kind)[0] for kind, _ in fields],
        "orders": [order.index(i) for i in range(len(fields))],
        "lengths": [1 if base == "char" else length or 1 for _, _, base, length in parts],
        "array_lengths": [length for *_, length in parts],
        "crc_extra": seed,
        "unpacker": struct.Struct(layout),
    }
    made = type(f"MAVLink_{name.lower()}_message", (mav.MAVLink_message,), attributes)
    mav.mavlink_map[msg_id] = made
    return made


def ms_since_boot(now: int) -> int:
    """Return an instant, nanoseconds since boot, as the `time_boot_ms` of a message."""
    return now // 1_000_000 & 0xFFFFFFFF


def unfit_field(message: Message) -> str:
    """Return the name of the first field whose value does not fit its wire type, or "?" if every single value fits."""
    kinds = dict(zip(message.fieldnames, message.fieldtypes, strict=True))
    for name, length in zip(message.ordered_fieldnames, message.array_lengths, strict=True):
        value = getattr(message, name)
        try:
            if kinds[name] == "char":
                bytes(value.encode() if isinstance(value, str) else value)
            else:
                struct.pack(f"<{length or 1}{_FORMATS[kinds[name]][0]}", *(value[:length] if length else [value]))
        except (struct.error, TypeError, ValueError, OverflowError, AttributeError):
            return str(name)
    return "?"


TimeSyncV2 = define(111, "TIMESYNC", "int64_t tc1, int64_t ts1", "uint8_t target_system, uint8_t target_component", replace=True)
MountStatus = define(
    158,
    "MOUNT_STATUS",
    "uint8_t target_system, uint8_t target_component, int32_t pointing_a, int32_t pointing_b, int32_t pointing_c",
    "uint8_t mount_mode",
)
ComponentInformationBasic = define(
    396,
    "COMPONENT_INFORMATION_BASIC",
    "uint32_t time_boot_ms, uint64_t capabilities, uint32_t time_manufacture_s, char[32] vendor_name, char[32] model_name, "
    "char[24] software_version, char[24] hardware_version, char[32] serial_number",
)
ComponentMetadata = define(397, "COMPONENT_METADATA", "uint32_t time_boot_ms, uint32_t file_crc, char[100] uri")
Event = define(
    410,
    "EVENT",
    "uint8_t destination_component, uint8_t destination_system, uint32_t id, uint32_t event_time_boot_ms, uint16_t sequence, "
    "uint8_t log_levels, uint8_t[40] arguments",
)
TargetAbsolute = define(
    510,
    "TARGET_ABSOLUTE",
    "uint64_t timestamp, uint8_t id, uint8_t sensor_capabilities, int32_t lat, int32_t lon, float alt, float[3] vel, "
    "float[3] acc, float[4] q_target, float[3] rates, float[2] position_std, float[3] vel_std, float[3] acc_std",
)
TargetRelative = define(
    511,
    "TARGET_RELATIVE",
    "uint64_t timestamp, uint8_t id, uint8_t frame, float x, float y, float z, float[3] pos_std, float yaw_std, "
    "float[4] q_target, float[4] q_sensor, uint8_t type",
)
