"""Check that the packages which the settings need are installed."""

from companion.settings.model import Settings
from drivers.ardrone.options import ArDroneOptions
from drivers.pyav import require_pyav


def check_installed(settings: Settings) -> None:
    """Check that what the settings switch on can run with the packages that are installed.

    Raises:
        BadInput: a package is missing; the message names the setting and how to install it.
    """
    vehicle, camera = settings.vehicle, settings.camera
    wanting = {
        f'vehicle.model = "{getattr(vehicle, "model", "")}"': isinstance(vehicle, ArDroneOptions)
        and camera.source == "vehicle"
        and vehicle.model != "1.0",
        'camera.source = "stream"': camera.source == "stream",
        'camera.format = "H264"': camera.source == "v4l2" and camera.format == "H264",
        'recorder.frames = "h264"': settings.recorder.enabled and settings.recorder.frames == "h264",
        "video_stream.to": bool(settings.video_stream.to),
    }
    for setting, wants in wanting.items():
        if wants:
            require_pyav(setting)
