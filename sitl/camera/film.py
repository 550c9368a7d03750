"""The frames of one camera one after the other: automatics that follow the picture, and a link that loses parts of it.

A renderer makes each frame for itself. What a camera and its link remember from frame to frame is here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from estimator.vision.camera import Camera
from sitl.camera.automatic import Adjusted, Automatics, adjust, settings
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.driven_exposure import Taken, taken_with
from sitl.camera.light import Development, Light
from sitl.camera.video_link import VideoLink, VideoLinkOptions

U8 = NDArray[np.uint8]

_AS_IT_IS = Taken()
_LOOKS = 6
"""Number of times that the automatics meter the first scene before its frame: the camera has been on for a while."""


class Film:
    """Renders the frames of one flight in order.

    Args:
        link: the video link; None if frames arrive as the camera made them.
        seed: of the packets that the link loses.
    """

    def __init__(self, renderer: Renderer, automatics: Automatics, link: VideoLinkOptions | None, seed: int) -> None:
        self._renderer, self._automatics = renderer, automatics
        self._link = VideoLink(link, renderer.camera.width, renderer.camera.height, seed) if link is not None else None
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

    def order(self, shot: Exposure, rng: np.random.Generator) -> Callable[[], U8]:
        """Put a frame in the order, and return the function that renders it, after those ordered before."""
        made = cache(lambda: self.render(shot, rng))
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
