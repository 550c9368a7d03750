"""The frames of one camera one after the other: automatics that follow the image, a driven exposure, and a lossy video link.

A renderer makes each frame for itself. What a camera and its link remember from frame to frame is here: the exposure that the
service drives, with how late a change shows and what it costs, and the decoder's newest frame. Each packet of the link holds one
slice of a frame. The decoder conceals a lost slice by the frame before, and motion smears there until the next key frame; where
all slices are lost the image stands still.

The meter of the automatics is that of simple cameras: the mean of the picture's values. A bright sea makes the exposure shorter
and the pad darker, a dark deck makes it longer until white paint is clipped. White balance takes the picture for grey on the
whole, between the colours of lamps and of a blue sky.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from fractions import Fraction
from functools import cache, lru_cache

import cv2
import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

from drivers.camera.exposure import ExposureDrive, ExposureRange, ExposureSetting
from drivers.pyav import require_pyav
from estimator.contracts.geometry import F64
from estimator.vision.camera.camera import Camera
from estimator.vision.srgb import linear_light
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Development, Light, Sensor, planck_rgb
from sitl.camera.settings import VideoSettings

U8 = NDArray[np.uint8]

_LAG_FRAMES = 2
"""Exposures that begin before a new setting acts, as with most USB cameras."""
_GAIN_MOST = 16.0  # largest gain of the automatics
_SHORTEST_S = 1e-4  # shortest exposure of a driven camera
_PART_OF_FRAME = 0.8  # longest exposure, as a share of a frame's time
_STEPS_OF_GAIN = 2.0
"""Steps of amplification in a stop; each has tables of its noise."""
_LOOKS = 6
"""Number of times that the automatics meter the first scene before its frame: the camera has been on for a while."""
_PACKET_BYTES = 1400  # largest slice of the video
_FPS = 30  # frames a second of the AR.Drone's video
_KEYFRAME_S = 1.0
"""Time between two pictures that need no other, as of the AR.Drone's encoder."""
_TARGET = 105.0
"""Mean value of a picture that is rightly exposed, 0 to 255."""
_SHORTEST = 1.0 / 32.0
"""Shortest exposure against that of daylight."""


class Taken(Struct, frozen=True):
    """Conditions of one frame."""

    setting: ExposureSetting | None = None
    """None where the camera sets it itself."""
    light_fraction: float = 1.0
    """Light on the scene against what the scenario says."""
    white_balance_k: float | None = None
    """Colour temperature that is taken for white; None where the camera sets it itself."""


class SimulatedExposure:
    """The camera's side of a driven exposure.

    Args:
        start: what it holds at first.
        arrived: returns the number of the newest frame that the service has.
    """

    def __init__(
        self, drive: ExposureDrive, start: ExposureSetting, period_s: float, white_balance_k: float, arrived: Callable[[], int]
    ) -> None:
        self._drive, self._arrived, self._white_balance_k = drive, arrived, white_balance_k
        can = ExposureRange(_SHORTEST_S, _PART_OF_FRAME * period_s, _GAIN_MOST)
        self._shown = can.split(start.product_s, can.longest_s)
        self._coming: deque[tuple[int, ExposureSetting]] = deque()
        self._exposures = 0
        drive.opened(can, self._shown)

    def expose(self) -> Taken:
        """Return how the next frame is taken; call it once for each, in order."""
        self._exposures += 1
        wanted = self._drive.take()
        if wanted is not None:
            newest = self._arrived()
            self._drive.changed(wanted, newest, newest)
            self._coming.append((self._exposures + _LAG_FRAMES, wanted))
        while self._coming and self._coming[0][0] <= self._exposures:
            self._shown = self._coming.popleft()[1]
        return Taken(self._shown, white_balance_k=self._white_balance_k)


def taken_with(light: Light, sensor: Sensor, taken: Taken) -> tuple[Light, Sensor]:
    """Return light and sensor of a frame: a longer exposure counts more light, a gain amplifies it with its noise."""
    ev = light.exposure_ev + math.log2(taken.light_fraction)
    if taken.setting is not None:
        gain = 2.0 ** (round(_STEPS_OF_GAIN * math.log2(taken.setting.gain)) / _STEPS_OF_GAIN)
        ev += math.log2(taken.setting.product_s / sensor.exposure_s)
        sensor = structs.replace(sensor, exposure_s=taken.setting.exposure_s, full_well_e=sensor.full_well_e / gain)
    if taken.white_balance_k is not None:
        light = structs.replace(light, balanced_for_k=taken.white_balance_k)
    return structs.replace(light, exposure_ev=min(max(ev, -10.0), 10.0)), sensor


_AS_IT_IS = Taken()


class Film:
    """Renders the frames of one flight in order.

    Args:
        link: the video link; one without a bit rate shows frames as the camera made them.
        seed: of the packets that the link loses.
    """

    def __init__(self, renderer: Renderer, automatics: Automatics, link: VideoSettings, seed: int) -> None:
        self._renderer, self._automatics = renderer, automatics
        size = renderer.camera.width, renderer.camera.height
        self._link = VideoLink(link, *size, seed) if link.bitrate_kbit_s > 0 else None
        self._adjusted: Adjusted | None = None
        self._ordered: deque[Callable[[], U8]] = deque()

    @property
    def camera(self) -> Camera:
        """The camera that the frames are from."""
        return self._renderer.camera

    @property
    def light(self) -> Light:
        """The light on the scene."""
        return self._renderer.light

    def order(self, shot: Exposure, rng: np.random.Generator, taken: Taken = _AS_IT_IS) -> Callable[[], U8]:
        """Put a frame in the order, as `render`, and return the function that renders it, after those ordered before."""
        made = cache(lambda: self.render(shot, rng, taken))
        self._ordered.append(made)

        def image() -> U8:
            while made in self._ordered:
                self._ordered.popleft()()
            return made()

        return image

    def render(self, shot: Exposure, rng: np.random.Generator, taken: Taken = _AS_IT_IS) -> U8:
        """Return the next frame, (H, W, 3) BGR.

        Args:
            taken: how it is taken; exposure and white balance that it does not name are the camera's own.
        """
        image = self._exposed(shot, rng, taken)
        return self._link.send(image) if self._link is not None else image

    def _exposed(self, shot: Exposure, rng: np.random.Generator, taken: Taken) -> U8:
        """Return the camera's own frame, and let the automatics follow it."""
        automatics, renderer = self._automatics, self._renderer
        if taken.setting is not None or not automatics.any:
            if taken == _AS_IT_IS:
                return renderer.render(shot, rng)
            return renderer.render(shot, rng, renderer.development(*taken_with(renderer.light, renderer.sensor, taken)))
        if self._adjusted is None:
            self._adjusted = Adjusted(shot.t_s, -self._renderer.light.daylight_ev)
            for _ in range(_LOOKS):
                look = renderer.render(shot, np.random.default_rng(0), self._development(self._adjusted, taken))
                self._adjusted = adjust(automatics, self._adjusted, look, shot.t_s, at_once=True)
        image = renderer.render(shot, rng, self._development(self._adjusted, taken))
        self._adjusted = adjust(automatics, self._adjusted, image, shot.t_s)
        return image

    def _development(self, adjusted: Adjusted, taken: Taken) -> Development:
        renderer = self._renderer
        light, sensor = taken_with(renderer.light, renderer.sensor, taken)
        return renderer.development(*settings(light, sensor, self._automatics, adjusted))


_SLICES = (1, 5)
"""NAL unit types of coded slices (ITU-T H.264, table 7-1)."""


class VideoLink:
    """Sends the frames of one camera, in order. The same frames and seed give the same pictures.

    Packets are lost in bursts (Gilbert, Bell System Technical Journal 39, 1960).
    """

    def __init__(self, settings: VideoSettings, width: int, height: int, seed: int) -> None:
        self._settings = settings
        self._rng = np.random.default_rng([seed, 0x264])
        self._lost = False
        self._shown: U8 = np.full((height, width, 3), 16, np.uint8)
        require_pyav("a scenario with a lossy video link")
        import av

        encoder = av.CodecContext.create("libx264", "w")
        decoder = av.CodecContext.create("h264", "r")
        assert isinstance(encoder, av.VideoCodecContext)
        assert isinstance(decoder, av.VideoCodecContext)
        encoder.width, encoder.height, encoder.pix_fmt = width, height, "yuv420p"
        encoder.time_base, encoder.framerate = Fraction(1, _FPS), Fraction(_FPS)
        encoder.bit_rate = round(1000 * settings.bitrate_kbit_s)
        encoder.thread_count = decoder.thread_count = 1
        every, rate = max(1, round(_KEYFRAME_S * _FPS)), round(settings.bitrate_kbit_s)
        encoder.options = {
            "preset": "ultrafast",
            "tune": "zerolatency",
            "profile": "baseline",
            "x264-params": f"annexb=1:repeat-headers=1:scenecut=0:keyint={every}:min-keyint={every}:sliced-threads=0"
            f":slice-max-size={_PACKET_BYTES}:vbv-maxrate={rate}:vbv-bufsize={max(1, rate // 5)}",
        }
        decoder.flags |= av.codec.context.Flags.output_corrupt | av.codec.context.Flags.low_delay
        self._encoder, self._decoder = encoder, decoder
        self._sent = 0

    def send(self, px: U8) -> U8:
        """Return the picture that the receiver shows after this frame (H, W, 3) BGR was sent: the last one if nothing arrived."""
        import av

        frame = av.VideoFrame.from_ndarray(px, format="bgr24")
        frame.pts = self._sent
        self._sent += 1
        coded = b"".join(bytes(packet) for packet in self._encoder.encode(frame))
        arrived = b"".join(unit for unit in _units(coded) if unit[4] & 31 not in _SLICES or not self._next_is_lost())
        if any(unit[4] & 31 in _SLICES for unit in _units(arrived)):
            try:
                shown = self._decoder.decode(av.Packet(arrived))
            except av.error.InvalidDataError:
                shown = []
            if shown:
                self._shown = np.asarray(shown[-1].to_ndarray(format="bgr24"), dtype=np.uint8)
        return self._shown.copy()

    def _next_is_lost(self) -> bool:
        """Return whether the link loses its next packet."""
        o = self._settings
        if o.loss == 0:
            return False
        leave, enter = 1.0 / o.burst_packets, min(1.0, o.loss / (o.burst_packets * (1.0 - o.loss)))
        chance = float(self._rng.random())
        self._lost = chance >= leave if self._lost else chance < enter
        return self._lost


def _units(stream: bytes) -> list[bytes]:
    """Return the NAL units of an Annex B byte stream, each with a start code of four bytes."""
    parts = stream.replace(b"\x00\x00\x00\x01", b"\x00\x00\x01").split(b"\x00\x00\x01")
    return [b"\x00\x00\x00\x01" + part for part in parts if part]


_MIRED = (100.0, 400.0)
"""Limits of the white balance: 10000 to 2500 K, in 1e6 / K."""


class Automatics(Struct, frozen=True):
    """The time constants of a camera's automatics, s; 0 where it has none."""

    exposure_lag_s: float = 0.0
    longest_s: float = 0.02
    """Longest exposure; with less light the camera amplifies."""
    balance_lag_s: float = 0.0

    @property
    def any(self) -> bool:
        """True if the camera has any automatic."""
        return self.exposure_lag_s > 0 or self.balance_lag_s > 0


class Adjusted(Struct, frozen=True):
    """Values that the camera's automatics have set, and when."""

    t_s: float
    ev: float = 0.0
    """Stops against the exposure of daylight."""
    mired: float = 1e6 / 6500.0
    """Colour of the light that is taken for white, 1e6 / K."""


def settings(light: Light, sensor: Sensor, automatics: Automatics, adjusted: Adjusted) -> tuple[Light, Sensor]:
    """Return light and sensor with what the automatics have set."""
    if automatics.balance_lag_s > 0:
        light = structs.replace(light, balanced_for_k=1e6 / adjusted.mired)
    if automatics.exposure_lag_s > 0:
        wanted = 2.0**adjusted.ev
        longest = max(sensor.exposure_s, automatics.longest_s) / max(sensor.exposure_s, 1e-6)
        longer = min(max(wanted, _SHORTEST), longest)
        amplified = min(max(wanted / longer, 1.0), _GAIN_MOST)
        steps = 2.0 ** (round(_STEPS_OF_GAIN * math.log2(amplified)) / _STEPS_OF_GAIN)
        sensor = structs.replace(sensor, exposure_s=sensor.exposure_s * longer, full_well_e=sensor.full_well_e / steps)
        light = structs.replace(light, exposure_ev=light.exposure_ev + math.log2(longer * amplified))
    return light, sensor


def adjust(automatics: Automatics, adjusted: Adjusted, image: U8, t_s: float, *, at_once: bool = False) -> Adjusted:
    """Return what the automatics set after a frame.

    Args:
        image: the frame (H, W, 3) BGR that they meter.
        t_s: time of the frame.
        at_once: without lag, as when the camera has looked at the scene for long.
    """
    blue, green, red = cv2.mean(cv2.resize(image, (32, 18), interpolation=cv2.INTER_AREA))[:3]
    dt = max(0.0, t_s - adjusted.t_s)
    ev, mired = adjusted.ev, adjusted.mired
    if automatics.exposure_lag_s > 0:
        seen = linear_light(np.array([0.114 * blue + 0.587 * green + 0.299 * red, _TARGET]))
        off = math.log2(float(seen[1]) / max(float(seen[0]), 1e-4))
        ev += off * (1.0 if at_once else 1.0 - math.exp(-dt / automatics.exposure_lag_s))
        ev = min(max(ev, math.log2(_SHORTEST)), 12.0)
    if automatics.balance_lag_s > 0:
        b, r = linear_light(np.array([blue, red])).clip(1e-4)
        # The colour that would make the picture grey: what is redder than white now is redder light than was assumed.
        ratios, mireds = _locus()
        wanted = float(np.interp(math.log(r / b) + np.interp(mired, mireds, ratios), ratios, mireds))
        mired += (wanted - mired) * (1.0 if at_once else 1.0 - math.exp(-dt / automatics.balance_lag_s))
    return Adjusted(t_s, ev, mired)


@lru_cache(maxsize=1)
def _locus() -> tuple[F64, F64]:
    """Return log(red / blue) of black bodies, rising, and their colours in mired."""
    mireds = np.linspace(*_MIRED, 61)
    rgb = np.array([planck_rgb(1e6 / m) for m in mireds])
    return np.log(rgb[:, 0] / rgb[:, 2]), mireds
