"""The camera's frames as H.264 in a recording.

Each frame is encoded from those before it back to the last key frame, so whoever wants one decodes these as well. Frames are
mostly wanted in order, and then each is decoded once.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from companion.recording.frame_encoder import VideoQuality, is_key_frame
from drivers.pyav import AccessUnitDecoder

U8 = NDArray[np.uint8]

KEY_EACH = 30
"""Frames from one key frame to the next: what a viewer decodes for a seek, and what a damaged frame spoils at most."""
_CRF = 26
"""Quality of the codec.

At 20 most of the bytes are the sensor's noise: five times as many, for a heading that a replay measures 0.1 degrees better at 95
%.
"""
_PIXELS_MAX = 1 << 24
"""A file that claims larger frames than any camera here gets no memory for them."""
RECORDED = VideoQuality(_CRF, KEY_EACH)


class _Group(Struct, eq=False):
    """A key frame and what follows it up to the next."""

    packets: list[bytes] = field(default_factory=list)
    decoder: AccessUnitDecoder | None = None
    decoded: int = 0
    last: U8 | None = None

    def image(self, number: int) -> U8 | None:
        if self.decoder is None or number < self.decoded - 1:
            self.decoder = AccessUnitDecoder("a recording whose frames are H.264", _PIXELS_MAX, flags="low_delay")
            self.decoded, self.last = 0, None
        while self.decoded <= number:
            frames = self.decoder.decode(self.packets[self.decoded])
            self.last = np.asarray(frames[-1].to_ndarray(format="bgr24"), np.uint8) if frames else None
            self.decoded += 1
        return self.last


class VideoImage(Struct, frozen=True, eq=False):
    """One recorded frame of a video, decoded when it is requested."""

    _group: _Group
    _number: int

    def px(self) -> U8 | None:
        """Return (H, W, 3) BGR, or None if the frame is damaged or what it builds upon is missing."""
        return self._group.image(self._number)


class FrameSequence:
    """Puts the access units of a recording together, in order."""

    def __init__(self) -> None:
        self._group: _Group | None = None

    def add(self, data: bytes) -> VideoImage | None:
        """Return the frame of an access unit; None before the first key frame."""
        if is_key_frame(data):
            self._group = _Group()
        if self._group is None:
            return None
        self._group.packets.append(data)
        return VideoImage(self._group, len(self._group.packets) - 1)
