"""The writes of `doctor --fix`: an undo file of what each parameter was, and the writing itself, on the ground and read back."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence

from msgspec import Struct

from companion.tools.doctor.gather import wait_until
from companion.tools.doctor.snapshot import AutopilotSnapshot
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.dialect import mav
from drivers.mavlink.requests import wire_value
from estimator.contracts.time import Clock

_READ_S = 5.0
"""Longest time for reading one parameter, its repetitions among it, seconds."""
_TRIES = 3  # times that a value is written


class PlannedWrite(Struct, frozen=True, forbid_unknown_fields=True):
    """One parameter to write, with the value that it must have before."""

    parameter: str
    was: float
    to: float

    @property
    def back(self) -> PlannedWrite:
        """The write that undoes this one."""
        return PlannedWrite(self.parameter, self.to, self.was)


class UndoFile(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters before a repair, in the order of the writes; the file exists before the first write."""

    autopilot: str
    system: int
    written: tuple[PlannedWrite, ...]

    def foreign_to(self, autopilot: AutopilotSnapshot) -> str | None:
        """Return why the file does not belong to this autopilot; None if it does."""
        if (self.autopilot, self.system) == (autopilot.stack, autopilot.system):
            return None
        return f"it is of {self.autopilot}, system {self.system}; found is {autopilot.stack}, system {autopilot.system}"


def same(a: float, b: float) -> bool:
    """Return whether two values are one to an autopilot, which keeps 32 bits of each."""
    return a == b or _rounded(a) == _rounded(b)


def _rounded(value: float) -> float:
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return value


OnResult = Callable[["WriteResult"], None]


class WriteResult(Struct, frozen=True):
    """Result of one planned write."""

    planned: PlannedWrite
    value: float | None
    """The parameter's value as read last; None if it was not answered."""
    refused: str | None = None
    """Reason why the parameter does not have the planned value; None if it has."""
    already: bool = False
    """True if it had the value before: nothing was written."""


async def read_parameters(autopilot: Autopilot, clock: Clock, names: Iterable[str]) -> dict[str, float]:
    """Return the autopilot's present values of these parameters; those without an answer are left out."""
    wanted, parameters = tuple(dict.fromkeys(names)), autopilot.parameters
    assert parameters is not None, "an autopilot is connected"
    parameters.request(wanted)
    await wait_until(clock, _READ_S + 0.5 * len(wanted), lambda: parameters.settled)
    return {name: parameters.values[name] for name in wanted if name in parameters.values and name not in parameters.absent}


async def write_parameters(
    autopilot: Autopilot, clock: Clock, planned: Sequence[PlannedWrite], on_result: OnResult
) -> tuple[WriteResult, ...]:
    """Write one parameter after the other, and return what became of each.

    A parameter is written only if it still has the value that the plan names, and only while the autopilot sends messages and
    says that it is disarmed; this is looked at again before each message.

    Args:
        on_result: called with each result as soon as it is known.
    """
    results = []
    for one in planned:
        result = await _write(autopilot, clock, one)
        on_result(result)
        results.append(result)
    return tuple(results)


def why_not_written(autopilot: Autopilot) -> str | None:
    """Return why no parameter may be written at this moment; None if one may."""
    if not autopilot.connected:
        return "the autopilot is silent"
    armed = autopilot.condition.armed
    if armed is None:
        return "the autopilot does not say whether it is armed"
    return "the vehicle is armed" if armed else None


async def _write(autopilot: Autopilot, clock: Clock, one: PlannedWrite) -> WriteResult:
    value = (await read_parameters(autopilot, clock, [one.parameter])).get(one.parameter)
    if value is None:
        return WriteResult(one, None, "it is not answered")
    if same(value, one.to):
        return WriteResult(one, value, already=True)
    if not same(value, one.was):
        return WriteResult(one, value, f"it was {one.was:g} and is {value:g}: somebody else changed it")
    identity, parameters = autopilot.identity, autopilot.parameters
    assert identity is not None
    assert parameters is not None
    kind = parameters.kinds[one.parameter]
    try:
        wire = wire_value(identity.stack, one.to, kind)
    except ValueError as why:
        return WriteResult(one, value, str(why))
    for _ in range(_TRIES):
        if (why_not := why_not_written(autopilot)) is not None:
            return WriteResult(one, value, why_not)
        autopilot.send(mav.MAVLink_param_set_message(*identity.address, one.parameter.encode(), wire, kind))
        answered = (await read_parameters(autopilot, clock, [one.parameter])).get(one.parameter)
        value = value if answered is None else answered
        if answered is not None and same(answered, one.to):
            return WriteResult(one, answered)
    refused = (
        f"the autopilot refuses it: it is still {value:g}" if same(value, one.was) else f"the autopilot made {value:g} of it"
    )
    return WriteResult(one, value, refused)
