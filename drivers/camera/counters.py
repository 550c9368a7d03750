"""The counters of a camera's frames."""

from collections import Counter
from dataclasses import dataclass, field, fields


@dataclass(slots=True)
class CameraCounters:
    """Running totals since the camera was opened. Every buffer is counted as given out, overtaken, damaged or waiting."""

    buffers: int = 0
    """Buffers received from the device or the stream."""
    frames: int = 0
    """Frames that were given out."""
    frames_overtaken: int = 0
    """Frames that were skipped because a newer one had already arrived."""
    frames_damaged: int = 0
    """Frames marked bad by the kernel, torn, of another size than was agreed, or refused by the decoder."""
    frames_wrong_size: int = 0
    """Frames that claimed another size than was agreed and were not decoded: a part of `frames_damaged`."""
    frames_waiting: int = 0
    """Frames dropped until the next IDR (H.264)."""
    frames_lost: int = 0
    """Frames missing in the device's own count; they were never received and are not among `buffers`."""
    frames_replaced: int = 0
    """Frames that were given out and replaced by a newer one before anyone read them: a part of `frames`."""
    stamps_refused: int = 0
    """Kernel time stamps that were impossible; the arrival was used instead."""
    restarts: Counter[str] = field(default_factory=Counter)
    """Restarts by reason: unplugged, silent, absent, failed."""

    def as_dict(self) -> dict[str, int]:
        """Return the counters as a flat dict for records and telemetry; restarts have keys like `restarts.unplugged`."""
        out: dict[str, int] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, Counter):
                out.update({f"{f.name}.{key}": n for key, n in sorted(value.items())})
            else:
                out[f.name] = value
        return out
