"""The counters of everything that crossed an AR.Drone link."""

from collections import Counter
from dataclasses import dataclass, field, fields
from enum import Enum


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


@dataclass(slots=True)
class Counters:
    """Running totals since the link was opened."""

    navdata_datagrams: int = 0
    navdata_refused: Counter[str] = field(default_factory=Counter)
    """Refused datagrams by their `Refusal`."""
    navdata_out_of_order: int = 0
    navdata_lost: int = 0
    """Sequence numbers that never arrived in order."""
    navdata_restarts: int = 0
    """Times the drone restarted its sequence."""
    navdata_silences: int = 0
    """Times the stream was requested again."""
    navdata_options_skipped: int = 0
    samples: int = 0

    video_bytes: int = 0
    video_units: int = 0
    video_skipped_bytes: int = 0
    video_torn: int = 0
    video_refused: Counter[str] = field(default_factory=Counter)
    """Pictures of an AR.Drone 1.0 that were refused, by their `Refusal`."""
    video_lost: int = 0
    """Frame numbers that never arrived."""
    frames: int = 0
    """Frames that were given out."""
    frames_replaced: int = 0
    """Frames that were given out and replaced by a newer one before anyone read them."""
    frames_overtaken: int = 0
    frames_waiting: int = 0
    """Frames that were dropped until the next IDR."""
    frames_damaged: int = 0
    frames_unsupported: int = 0
    frames_before_setup: int = 0
    """Frames that were decoded before the bottom camera was known to be selected."""

    at_datagrams: int = 0
    at_commands: int = 0
    at_errors: int = 0
    """Send errors that the system reported."""
    watchdog_resets: int = 0
    hover_for_age: int = 0
    """Periods in which a velocity command was too old to be flown."""
    hover_for_blindness: int = 0
    """Periods in which a velocity command lacked a fresh measured velocity."""
    take_offs_given_up: int = 0
    landings_given_up: int = 0
    """Landings that guidance stopped renewing and that were called off."""
    landings_called_off: int = 0
    """Periods in which the drone was commanded to end a landing that nobody requests."""
    at_late_hovers: int = 0
    """Datagrams in which the sender replaced an expired command by hover."""
    at_hovers_past_sender: int = 0
    """Times that the service sent hover to the drone directly, because the sender was silent or gone."""
    at_senders: int = 0
    """Sender processes that were started; more than one means that one was lost."""

    config_sent: int = 0
    config_acknowledged: int = 0
    config_timeouts: int = 0
    config_mismatches: int = 0
    """Keys that read back with another value than was set."""
    control_reads: int = 0
    model_mismatches: int = 0
    """Reads of the configuration that named the firmware of the other generation of the drone."""

    restarts: Counter[str] = field(default_factory=Counter)
    """Restarts by channel: navdata, video, at, control, setup."""

    def refused(self, why: Refusal) -> None:
        self.navdata_refused[why.value] += 1

    def as_dict(self) -> dict[str, int]:
        """Return the counters as a flat dict for records and telemetry; those by name have keys like `navdata_refused.torn`."""
        out: dict[str, int] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, Counter):
                out.update({f"{f.name}.{key}": n for key, n in sorted(value.items())})
            else:
                out[f.name] = value
        return out
