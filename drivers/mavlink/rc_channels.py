"""The positions of a transmitter's switches, by the pulse widths in RC_CHANNELS.

Source: mavlink.io, common message set: RC_CHANNELS (65), whose chanN_raw is 65535 for a channel that is not there.
"""

from drivers.mavlink.dialect import Message

RATE_HZ = 10.0
"""Rate at which RC_CHANNELS is requested: a switch moves within a few of them."""
BANDS_US = ((800, 1300), (1400, 1600), (1700, 2200))
"""Pulse widths of the low, the middle and the high position, microseconds."""
POSITIONS = ("low", "middle", "high")
FIRST = 5
"""First channel that may be a switch: those before are the sticks."""
LAST = 18
"""Last channel that RC_CHANNELS holds."""
_THROTTLE_LOST_US = 950
"""Throttle at or below which a receiver says by it that its transmitter is lost: autopilots take 975 and less for that."""


def pulse_us(message: Message, channel: int) -> int | None:
    """Return the pulse width of a channel, microseconds; None where it is not there or the input is lost."""
    width, throttle = getattr(message, f"chan{channel}_raw"), message.chan3_raw
    if channel > message.chancount or not BANDS_US[0][0] <= width <= BANDS_US[-1][1] or throttle <= _THROTTLE_LOST_US:
        return None
    return int(width)


def band_of(pulse: int | None) -> int | None:
    """Return the number of the position that a pulse width stands for; None between two positions, or without a pulse."""
    return next((n for n, (least, most) in enumerate(BANDS_US) if pulse is not None and least <= pulse <= most), None)
