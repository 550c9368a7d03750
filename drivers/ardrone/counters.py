"""The counters of everything that crossed an AR.Drone link."""

from collections import Counter
from collections.abc import Mapping
from enum import Enum

from msgspec import Struct, field


class Refusal(Enum):
    """The reason for which wire input is refused: counted, never an exception. The value is the name of its counter."""

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


_IN_WORDS = {
    Refusal.TOO_SHORT: "they are cut short", Refusal.BAD_MAGIC: "they are of another protocol",
    Refusal.TORN: "their options do not fit their length", Refusal.BAD_CHECKSUM: "their checksum is wrong",
}  # fmt: skip


def in_words(refused: Mapping[str, int]) -> str:
    """Return how many datagrams are refused for what, the most frequent reason first; empty if none is.

    Args:
        refused: their numbers by the value of their `Refusal`.
    """
    ordered = Counter(refused).most_common()
    return ", ".join(f"{n} datagrams are refused: {_IN_WORDS.get(Refusal(why), why)}" for why, n in ordered if n > 0)


class Counters(Struct):
    """Running totals since the link was opened."""

    navdata_refused: Counter[str] = field(default_factory=Counter)
    """Refused datagrams by their `Refusal`."""
    navdata_restarts: int = 0
    """Times the drone restarted its sequence."""
    navdata_silences: int = 0
    """Times the stream was requested again."""
    samples: int = 0

    video_bytes: int = 0
    video_refused: Counter[str] = field(default_factory=Counter)
    """Pictures of an AR.Drone 1.0 that were refused, by their `Refusal`."""
    frames: int = 0
    """Frames that were given out."""
    frames_replaced: int = 0
    """Frames that were given out and replaced by a newer one before anyone read them."""
    frames_before_setup: int = 0
    """Frames that were decoded before the bottom camera was known to be selected."""

    at_senders: int = 0
    """Sender processes that were started; more than one means that one was lost."""

    config_acknowledged: int = 0
    config_timeouts: int = 0
    config_mismatches: int = 0
    """Keys that read back with another value than was set."""
    control_reads: int = 0
    model_mismatches: int = 0
    """Reads of the configuration that named the firmware of the other generation of the drone."""

    restarts: Counter[str] = field(default_factory=Counter)
    """Restarts by channel: navdata, video, at, control, setup."""
