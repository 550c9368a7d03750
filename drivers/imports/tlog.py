"""Read a ground station's telemetry log (.tlog): frames of MAVLink, each after its instant in Unix time, us, big-endian.

The samples are those of the first autopilot in it, by the same conversion and the same clock map as on the wire.
Source: Mission Planner and MAVProxy write it; pymavlink's mavlogfile reads it.
"""

from collections.abc import Iterator
from pathlib import Path

from msgspec import Struct

from drivers.files import Largest, bytes_of
from drivers.log_history import AutopilotLog, LogHistory
from drivers.log_stamps import Tell, quiet, timeline
from drivers.mavlink.boot_clock import BootClock
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message
from drivers.mavlink.requests import parameter_value
from drivers.mavlink.samples import MavlinkSampler
from drivers.mavlink.timesync import TimeSync
from drivers.mavlink.vehicle import is_autopilot, stack_of
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs

_STAMP = 8  # length of the stamp before each frame, bytes
_HEADS = {0xFE: (8, 0), 0xFD: (12, 13)}
"""The bytes around the payload by the marker: those of every frame, and those of a signature."""
_TEXTS_MAX = 1000  # texts that are kept


class _Received(Struct, frozen=True):
    at_us: int
    message: Message


def read(path: Path, tell: Tell = quiet) -> list[Sample]:
    """Return all samples of the first autopilot in order.

    Raises:
        BadInput: the file cannot be read, or no autopilot is in it.
    """
    received, heartbeat = _of_autopilot(path, tell)
    sampler, out = MavlinkSampler(stack_of(heartbeat), BootClock(TimeSync()), tell=tell), list[Sample]()
    for one, at_ns in zip(received, timeline([h.at_us for h in received], tell), strict=True):
        if at_ns is not None:
            out += sampler.samples(one.message, MonoNs(at_ns))
    return sorted(out, key=lambda s: s.stamp.received_at)


def read_history(path: Path, tell: Tell = quiet) -> AutopilotLog:
    """Return the parameters and texts of the first autopilot.

    Raises:
        BadInput: the file cannot be read, or holds no autopilot or none of its parameters.
    """
    received, heartbeat = _of_autopilot(path, tell)
    stack = stack_of(heartbeat)
    parameters: dict[str, float] = {}
    texts: list[str] = []
    for message in (one.message for one in received):
        if message.get_type() == "PARAM_VALUE":
            parameters[str(message.param_id)] = parameter_value(stack, message.param_value, int(message.param_type))
        elif message.get_type() == "STATUSTEXT" and len(texts) < _TEXTS_MAX:
            texts.append(str(message.text))
    if not parameters:
        raise BadInput(
            f"{path}: a telemetry log without parameters: load them in the ground station while it logs, or give the autopilot's "
            "own log (.bin or .ulg)"
        )
    times = [t for t in timeline([one.at_us for one in received]) if t is not None]
    history = LogHistory(round(max(times, default=0) * 1e-9, 2))
    return AutopilotLog(stack.value, None, None, dict(sorted(parameters.items())), tuple(texts), (), history)


def _of_autopilot(path: Path, tell: Tell) -> tuple[list[_Received], Message]:
    """Return the messages of the first autopilot, and its first heartbeat."""
    received = list(_messages(bytes_of(path, Largest.LOG), tell))
    beats = [m for m in (h.message for h in received) if m.get_type() == "HEARTBEAT" and is_autopilot(m, m.get_srcComponent())]
    if not beats:
        raise BadInput(f"{path}: a telemetry log without an autopilot's heartbeat: give the autopilot's own log (.bin or .ulg)")
    first = beats[0].get_srcSystem(), beats[0].get_srcComponent()
    if (count := len({m.get_srcSystem() for m in beats})) > 1:
        tell(f"{count} autopilots are in it, and system {first[0]} alone is read")
    return [h for h in received if (h.message.get_srcSystem(), h.message.get_srcComponent()) == first], beats[0]


def _messages(data: bytes, tell: Tell) -> Iterator[_Received]:
    codec, at, skipped = Codec(255, 1, datagrams=True), 0, 0
    while at + _STAMP + 8 <= len(data):
        marker, length = data[at + _STAMP], data[at + _STAMP + 1]
        size, signature = _HEADS.get(marker, (0, 0))
        end = at + _STAMP + size + length
        if marker == 0xFD and data[at + _STAMP + 2] & 1:
            end += signature
        found = codec.feed(data[at + _STAMP : end]) if size and end <= len(data) else []
        if not found and not (size and (end == len(data) or data[end + _STAMP : end + _STAMP + 1] in (b"\xfe", b"\xfd"))):
            at, skipped = at + 1, skipped + 1
            continue
        yield from (_Received(int.from_bytes(data[at : at + _STAMP], "big"), message) for message in found)
        at = end
    if skipped:
        tell(f"damaged: {skipped} bytes in it are no frames and were left out")
