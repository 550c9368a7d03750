"""The undo file of `doctor --fix`: what each parameter was and what it was set to, of one autopilot. No I/O."""

from __future__ import annotations

import struct

import msgspec
from msgspec import Struct

from companion.tools.doctor.snapshot import AutopilotSnapshot
from estimator.contracts.errors import BadInput


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
    """What was about to be written, in that order; it exists before the first write."""

    autopilot: str
    system: int
    written: tuple[PlannedWrite, ...]

    def foreign_to(self, autopilot: AutopilotSnapshot) -> str | None:
        """Return why the file does not belong to this autopilot; None if it does."""
        if (self.autopilot, self.system) == (autopilot.stack, autopilot.system):
            return None
        return f"it is of {self.autopilot}, system {self.system}; heard is {autopilot.stack}, system {autopilot.system}"


def same(a: float, b: float) -> bool:
    """Return whether two values are one to an autopilot, which keeps 32 bits of each."""
    return a == b or _rounded(a) == _rounded(b)


def _rounded(value: float) -> float:
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return value


def encode_undo(undo: UndoFile) -> bytes:
    """Return the file as readable JSON."""
    return msgspec.json.format(msgspec.json.encode(undo), indent=2) + b"\n"


def decode_undo(data: bytes, where: str) -> UndoFile:
    """Return the file in a JSON text.

    Raises:
        BadInput: the text holds none; the message says where it is wrong.
    """
    try:
        return msgspec.json.decode(data, type=UndoFile)
    except (msgspec.DecodeError, UnicodeDecodeError) as why:
        raise BadInput(f"{where}: no undo file of doctor --fix: {why}") from why
