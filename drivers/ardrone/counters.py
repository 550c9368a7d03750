"""What became of everything that crossed an AR.Drone link."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, fields

from drivers.ardrone.refusal import Refusal


@dataclass(slots=True)
class Counters:
    """Running totals since the link was opened."""

    navdata_datagrams: int = 0
    navdata_refused: Counter[str] = field(default_factory=Counter)
    """By `Refusal`."""
    navdata_out_of_order: int = 0
    navdata_lost: int = 0
    """Sequence numbers that never came in order."""
    navdata_restarts: int = 0
    """Times the drone began its sequence anew."""
    navdata_silences: int = 0
    """Times the stream was asked for again."""
    navdata_options_skipped: int = 0
    samples: int = 0

    video_bytes: int = 0
    video_units: int = 0
    video_skipped_bytes: int = 0
    video_torn: int = 0
    video_lost: int = 0
    """Frame numbers that never came."""
    frames: int = 0
    """Given out."""
    frames_replaced: int = 0
    """Given out and overtaken before anyone read them."""
    frames_overtaken: int = 0
    frames_waiting: int = 0
    """Dropped until the next IDR."""
    frames_damaged: int = 0
    frames_unsupported: int = 0
    frames_before_setup: int = 0
    """Decoded before the bottom camera was known to be selected."""

    at_datagrams: int = 0
    at_commands: int = 0
    at_errors: int = 0
    """Send errors the system reported."""
    watchdog_resets: int = 0
    hover_for_age: int = 0
    """Periods in which a velocity command was too old to be flown."""
    hover_for_blindness: int = 0
    """Periods in which a velocity command lacked a fresh measured velocity."""
    take_offs_given_up: int = 0
    landings_given_up: int = 0
    """Landings that guidance fell silent about and that were called off."""
    landings_called_off: int = 0
    """Periods in which the drone was told to end a landing that nobody wants."""
    at_late_hovers: int = 0
    """Datagrams in which the sender put hover for a word of ours that had run out."""
    at_hovers_past_sender: int = 0
    """Times that we told the drone to hover ourselves, as the sender was silent or gone."""
    at_senders: int = 0
    """Sender processes that were started; more than one means that one was lost."""

    config_sent: int = 0
    config_acknowledged: int = 0
    config_timeouts: int = 0
    config_mismatches: int = 0
    """Keys that read back otherwise than asked for."""
    control_reads: int = 0

    restarts: Counter[str] = field(default_factory=Counter)
    """By channel: navdata, video, at, control, setup."""

    def refused(self, why: Refusal) -> None:
        self.navdata_refused[why.value] += 1

    def as_dict(self) -> dict[str, int]:
        """Flat, for records and telemetry; the named ones as `navdata_refused.torn`."""
        out: dict[str, int] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, Counter):
                out.update({f"{f.name}.{key}": n for key, n in sorted(value.items())})
            else:
                out[f.name] = value
        return out
