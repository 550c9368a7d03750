"""The interface between camera drivers and readers of frames: the open camera, and the error of a lost one."""

from drivers.camera.counters import CameraCounters
from drivers.camera.exposure import ExposureDrive
from drivers.mailbox import Latest
from estimator.contracts.errors import Recoverable
from estimator.contracts.samples import Frame


class CameraLost(Recoverable):
    """The camera was unplugged, fell silent or is absent; `reason` is one word for counting.

    A channel raises it with the reason `ended` when a file is over, and that file is not opened again.
    """

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class VideoSource:
    """An open camera. It may be absent at the moment: see `down`.

    Args:
        exposure: connects who drives the exposure with the driver; None where the camera does that itself.
    """

    def __init__(self, exposure: ExposureDrive | None = None) -> None:
        self.exposure = exposure
        """The exposure that we drive; None where the camera does."""
        self.frames: Latest[Frame] = Latest()
        """The newest frame. The end of a video file ends it with `CameraLost`."""
        self.counters = CameraCounters()
        self.down: str | None = "not yet opened"
        """The reason why no frames arrive, None while they do."""
