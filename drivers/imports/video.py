"""Read the frames of a video file, at its own time stamps; of one without any (raw H.264, MJPEG), at its frame rate."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from av.error import FFmpegError

from drivers.camera.images import ImageRefused
from drivers.camera.videos import has_times, open_video, predicts_frames
from drivers.imports.stamps import FRAME_DELAY_S, stamp
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Frame


def frames(path: Path, size: tuple[int, int] | None = None) -> Iterator[Frame]:
    """Yield every frame in order, the first at 0; a truncated file ends where it breaks off, and damaged frames are left out.

    Args:
        size: width and height that are expected; frames that are far larger are refused before they are decoded.

    Raises:
        BadInput: the file cannot be read, holds no video, or not one frame of it decodes.
    """
    try:
        container = open_video(str(path), size)
    except (FFmpegError, OSError, ImageRefused) as why:
        raise BadInput(f"{path}: not a readable video: {getattr(why, 'strerror', None) or why}") from why
    with container:
        if len(container.streams.video) == 0:
            raise BadInput(f"{path}: holds no video")
        first_s: float | None = None
        number, coded, timed = 0, predicts_frames(container), has_times(container)
        rate_hz = float(container.streams.video[0].average_rate or 0.0) or 25.0
        try:
            for image in container.decode(video=0):
                number += 1
                if image.is_corrupt:
                    continue
                time_s = float(image.time) if timed and image.time is not None else number / rate_hz
                first_s = time_s if first_s is None else first_s
                px = np.asarray(image.to_ndarray(format="bgr24"), dtype=np.uint8)
                yield Frame(stamp(round((time_s - first_s) * 1e9), FRAME_DELAY_S), number, px, coded=coded)
        except FFmpegError as why:
            if number == 0:
                raise BadInput(f"{path}: no frame of it decodes: {why}") from why
        if number == 0:
            raise BadInput(f"{path}: no frame of it decodes")
