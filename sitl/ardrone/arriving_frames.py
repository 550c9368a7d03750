"""Frames as they arrive in virtual time: those of an AR.Drone 1.0 are coded and decoded, and stamped by their arrival."""

from __future__ import annotations

import math

import numpy as np

from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.pictures import PictureRefusal
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp, after
from estimator.uvlc import UvlcDecoder
from sitl.ardrone import uvlc_encoder
from sitl.ardrone.generations import FIRST, Generation
from sitl.world.truth import RenderedFrame

_STAMP_SIGMA_S = 0.002
"""Standard deviation of the stamps of a drone that sends its clock's time."""

_BACK_TO_BACK_S = 0.001
"""Time between the arrivals of two pictures of which the first was held up, s: that of sending one."""


def synced(measured_at: MonoNs, received: MonoNs) -> Stamp:
    """Return the stamp of a sample. A sample with a stamp in the future counts as received at that stamp."""
    return Stamp(measured_at, max(measured_at, received), _STAMP_SIGMA_S, "sim")


class ArrivingFrames:
    """Makes the service's frames of what the camera saw.

    Args:
        generation: the drone's.
        options: the driver's.
        seed: of the arrivals of an AR.Drone 1.0's pictures: they scatter as its options say, about a delay of each flight,
            and keep their order.
        rendered: whether the images are renderings: one that stands for a drawn detection is told apart by its pixels, and no
            codec may change it.
    """

    def __init__(self, generation: Generation, options: ArDroneOptions, seed: np.random.SeedSequence, *, rendered: bool) -> None:
        self._first, self._coded = generation is FIRST, generation is FIRST and rendered
        self._decoder = UvlcDecoder()
        self._sigma_s = min(0.999, math.hypot(options.video_delay_sigma_s, options.arrival_sigma_s))
        self._random, self._scatter_s = np.random.default_rng(seed), options.arrival_sigma_s
        self._late_s = options.video_delay_sigma_s * self._random.standard_normal()
        self._newest: MonoNs | None = None
        """Stamp of the newest picture: one that was sent later arrives later, however long the one before was on its way."""

    def frame(self, number: int, image: RenderedFrame, received_at: MonoNs) -> Frame:
        """Return the frame that an image has become on its way."""
        if not self._first:
            return Frame(synced(after(image.exposed_at, image.stamp_error_s), received_at), number, image.px, image.exposure_s)
        px = image.px
        if self._coded and px.size:
            datagram = uvlc_encoder.encode(px, number)
            header = self._decoder.header(datagram)
            assert not isinstance(header, PictureRefusal)
            decoded = self._decoder.decode(datagram, header)
            assert not isinstance(decoded, PictureRefusal)
            px = decoded
        late_s = self._late_s + self._scatter_s * self._random.standard_normal()
        stamped = after(image.exposed_at, late_s)
        if self._newest is not None:
            stamped = max(stamped, after(self._newest, _BACK_TO_BACK_S))
        self._newest = stamped = min(stamped, received_at)
        return Frame(Stamp(stamped, received_at, self._sigma_s, "arrival"), number, px, image.exposure_s)
