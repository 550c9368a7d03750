"""The video of an AR.Drone 1.0, encoded as UVLC, and frames as they arrive in virtual time.

The frames of an AR.Drone 1.0 are encoded and decoded, and stamped by their arrival.
"""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.pictures import PictureRefusal
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp, after
from estimator.uvlc import UvlcDecoder
from sitl.ardrone import uvlc as uvlc_encoder
from sitl.ardrone.state import FIRST, Generation
from sitl.core.library import SIM
from sitl.world.truth import RenderedFrame

FINEST = 31
"""The quantizer that captures of the real drone show: it stands for the steps of quantizer 2, the finest that the drone uses."""
_COARSER = (*range(3, 31, 3), 30)
DATAGRAM_MAX = 65504
"""Bytes of the largest UDP datagram, in whole words."""


def encode(px: NDArray[np.uint8], number: int, quantizer: int = FINEST) -> bytes:
    """Encode one (height, width, 3) BGR frame: 176x144, 352x288, 320x240 or 640x480 px.

    A picture that does not fit a datagram is coded again with coarser steps, as the drone keeps its bit rate.

    Args:
        number: the drone's count of pictures.
        quantizer: 1 (fine) to 30; 31 stands for 2.

    Raises:
        ValueError: the frame is of another size, or fits no datagram.
    """
    height, width = px.shape[:2]
    px = np.ascontiguousarray(px)
    out = np.empty(DATAGRAM_MAX, np.uint8)
    for steps in (quantizer, *_COARSER):
        picture = SIM.ffi.new("dl_sim_uvlc_picture *", (width, height, steps, number % 2**32))
        coded = SIM.array("uint8_t", out)
        size = SIM.lib.dl_sim_uvlc_encode(SIM.array("uint8_t", px, 3 * width * height), px.size, picture, coded, len(out))
        if size < 0:
            raise ValueError(f"UVLC has no picture of {width}x{height} px with quantizer {steps}")
        if size > 0:
            return out[:size].tobytes()
    raise ValueError(f"a frame of {width}x{height} px fits no datagram")


_STAMP_SIGMA_S = 0.002
"""Standard deviation of the stamps of a drone that sends its clock's time."""

_BACK_TO_BACK_S = 0.001
"""Time between the arrivals of two pictures when the first was held up, s: that of sending one."""


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
        rendered: whether the images are renderings: one that stands for a drawn detection is distinguished by its pixels, and no
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
