"""Why a piece of wire input was not taken. A refusal is a result to be counted, never an exception."""

from __future__ import annotations

from enum import Enum


class Refusal(Enum):
    """One reason; the value is the name of its counter."""

    TOO_SHORT = "too_short"
    """Less than a header."""
    BAD_MAGIC = "bad_magic"
    """Does not begin as this format begins."""
    TORN = "torn"
    """Ends inside an element, or goes on after its end."""
    BAD_CHECKSUM = "bad_checksum"
    UNKNOWN_COMMAND = "unknown_command"
    BAD_ARGUMENTS = "bad_arguments"
    """A known command with too few, too many or unreadable arguments."""
