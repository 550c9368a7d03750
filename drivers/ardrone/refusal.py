"""The reasons for which wire input is refused. A refusal is a result to be counted, never an exception."""

from enum import Enum


class Refusal(Enum):
    """The reason of a refusal; the value is the name of its counter."""

    TOO_SHORT = "too_short"
    """The input is shorter than a header."""
    BAD_MAGIC = "bad_magic"
    """The input does not begin as this format begins."""
    TORN = "torn"
    """The input ends inside an element, or goes on after its end."""
    BAD_CHECKSUM = "bad_checksum"
    UNKNOWN_COMMAND = "unknown_command"
    BAD_ARGUMENTS = "bad_arguments"
    """A known command has too few, too many or unreadable arguments."""
