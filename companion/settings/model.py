"""The model of the settings: one immutable struct for each table of the settings file.

Every key has its unit, its range, its meaning and, if that helps, the origin of its default. Ranges hold for values that are read
from a file (`companion.settings.load.load`); code that builds these structs itself is trusted. Defaults describe a real
AR.Drone 2.0 indoors.
"""

from typing import Annotated, Literal

from msgspec import Struct

from companion.settings.guidance import GuidanceOptions
from companion.settings.http import HttpSettings
from companion.settings.limits import LimitOptions
from companion.settings.mavlink import BridgeOptions, OutputOptions
from companion.settings.mqtt import MqttSettings
from companion.settings.operator import OperatorOptions
from companion.settings.recorder import RecorderOptions
from companion.settings.restart import RestartOptions
from companion.settings.vessel import VesselOptions
from companion.settings.video import VideoStreamOptions
from drivers.ardrone.options import ArDroneOptions
from drivers.camera.exposure_options import DRIVEN_SOURCES
from drivers.camera.options import CameraOptions
from drivers.mavlink.gimbal_options import GimbalOptions
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import choice, number, text
from estimator.contracts.ports import SAMPLE_QUEUE_ITEMS
from estimator.options import EstimatorOptions
from estimator.vision.options import TrackerOptions

_TUNED = "tuned in simulation"
_SHIPPED_OR_PATH = "the name of a shipped one, or a path relative to the settings file"


class CameraSettings(CameraOptions, frozen=True, forbid_unknown_fields=True):
    """The camera that looks down and the source of its frames; intrinsics, distortion and mount are in a file of their own."""

    file: Annotated[str, text(f"camera file: {_SHIPPED_OR_PATH}", 4096, public=True)]
    gimbal: GimbalOptions = GimbalOptions()


class PadSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The pad on the deck; its drawing is in a file of its own."""

    file: Annotated[str, text(f"pad file: {_SHIPPED_OR_PATH}", 4096, public=True)]


class VisionSettings(TrackerOptions, frozen=True, forbid_unknown_fields=True):
    """The processing of frames."""

    threads: Annotated[int, number("threads OpenCV may use for one frame", "threads", 1, 64, public=True)] = 1
    core_fraction: Annotated[
        float,
        number(
            "largest fraction of a core that looking at frames may take; beyond it frames are skipped; 1 skips none",
            "1",
            0.1,
            1.0,
            public=True,
        ),
    ] = 0.7


class ServiceSettings(RestartOptions, frozen=True, forbid_unknown_fields=True):
    """The process: logging, queues, restarts, health."""

    log_level: Annotated[
        Literal["debug", "info", "warning", "error"], choice("least important messages that are logged", public=True)
    ] = "info"
    sample_queue_items: Annotated[
        int, number("inertial samples that may wait; the oldest is dropped and counted", "samples", 16, 100_000)
    ] = SAMPLE_QUEUE_ITEMS
    health_period_s: Annotated[float, number("how often health is written to the log; 0 for never", "s", 0.0, 3600.0)] = 10.0


class Settings(Struct, frozen=True, forbid_unknown_fields=True):
    """All settings. `companion.settings.load.load` reads them from a file."""

    vehicle: ArDroneOptions | AutopilotOptions
    camera: CameraSettings
    pad: PadSettings
    vision: VisionSettings = VisionSettings()
    estimator: EstimatorOptions = EstimatorOptions()
    guidance: GuidanceOptions = GuidanceOptions()
    service: ServiceSettings = ServiceSettings()
    recorder: RecorderOptions = RecorderOptions()
    mqtt: MqttSettings = MqttSettings()
    http: HttpSettings = HttpSettings()
    video_stream: VideoStreamOptions = VideoStreamOptions()
    landing_target: OutputOptions = OutputOptions()
    bridge: BridgeOptions = BridgeOptions()
    operator: OperatorOptions = OperatorOptions()
    limits: LimitOptions = LimitOptions()
    vessel: VesselOptions = VesselOptions()

    def fault(self) -> str | None:
        """Return the reason why keys do not go together, beginning with the key, or None if they do."""
        if isinstance(self.vehicle, AutopilotOptions):
            if self.camera.source == "vehicle":
                return 'camera.source must be "v4l2", "gstreamer" or "stream": an autopilot has no frames'
            if self.bridge.links:
                return "bridge.links must be empty: an autopilot speaks MAVLink itself"
        if self.camera.exposure.driven and self.camera.source not in DRIVEN_SOURCES:
            return (
                f'camera.exposure.mode must be "camera" with camera.source "{self.camera.source}": '
                f'only that of a camera with source "v4l2" can be driven'
            )
        if self.vessel.mqtt and (self.mqtt.transport == "off" or self.mqtt.commands == "off"):
            return "vessel.mqtt needs mqtt.transport and mqtt.commands: reports come from whom commands may come"
        return None


def ardrone_options(settings: Settings) -> ArDroneOptions:
    """Return the options of the AR.Drone.

    Raises:
        BadInput: the vehicle is of another kind.
    """
    v = settings.vehicle
    if not isinstance(v, ArDroneOptions):
        raise BadInput('vehicle.kind must be "ardrone" here')
    return v
