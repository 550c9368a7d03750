"""The options of a camera that is not part of the vehicle: what the table [camera] says of a device, a stream or a file.

With them stand those of the exposure of a camera that we drive: the table [camera.exposure].
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, get_args

from estimator.contracts.keys import CheckedOptions, choice, text, tuning

DRIVEN_SOURCES = ("v4l2", "libcamera")
"""Sources of frames whose exposure can be driven from here."""


class ExposureOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Exposure time, gain and white balance of the camera: who sets them, and their limits."""

    mode: Annotated[
        Literal["camera", "pad"],
        choice(
            "camera: the camera's own automatics, or what camera.controls fixes; pad: the service sets exposure time and gain by "
            "the light on the pad, and fixes the white balance (v4l2 and libcamera)",
            public=True,
            page=True,
        ),
    ] = "camera"
    blur_px: Annotated[
        float, tuning("largest smear of the picture during the exposure, by turn rate and motion over the pad", "px", 0.2, 20)
    ] = 1.5
    longest_s: Annotated[
        float, tuning("longest exposure time, however still the vehicle is; at most 0.8 of a frame's time", "s", 1e-4, 0.1)
    ] = 0.02
    gain_ratio: Annotated[
        float,
        tuning(
            "v4l2: amplification at the upper end of the camera's gain control against the lower end, between which it is taken "
            "as linear; 1 leaves the gain alone",
            "1",
            1.0,
            256.0,
            "assumed",
        ),
    ] = 8.0
    settle_frames: Annotated[
        int, tuning("frames after a change that may still show the exposure before it", "frames", 1, 10, "UVC cameras: 2 to 4")
    ] = 4
    white_balance_k: Annotated[
        int, tuning("colour temperature that is taken for white, as near as the camera can", "K", 2000, 10000, "daylight")
    ] = 6500

    @property
    def driven(self) -> bool:
        """True if the service sets the exposure."""
        return self.mode == "pad"


Format = Literal["YUYV", "NV12", "MJPG", "H264", "GREY"]
FORMATS: tuple[Format, ...] = get_args(Format)
"""The supported pixel formats of a V4L2 device, in the order in which `auto` prefers them: raw colour, compressed, grey."""
SOURCES = ("v4l2", "libcamera", "gstreamer", "stream", "ros2")
"""Sources of frames that are not the vehicle's."""
Size = tuple[int, int]
"""The width and height of a frame, px."""
Lens = Sequence[float] | None
"""fx, fy, cx, cy of a camera file, px, which a topic's camera_info must have; None compares nothing."""
_DRIVEN = frozenset(
    {
        "auto_exposure", "exposure_auto", "exposure_time_absolute", "exposure_absolute", "gain", "gain_automatic",
        "white_balance_automatic", "white_balance_temperature_auto", "white_balance_temperature", "AeEnable", "ExposureTime",
        "AnalogueGain", "ExposureTimeMode", "AnalogueGainMode", "AwbEnable", "AwbMode", "ColourTemperature", "ColourGains",
    }
)  # fmt: skip
"""Controls, by their present and former names, that are set with `exposure.mode` "pad"."""


class CameraOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The source of frames, their format and rate, and the limits at which a camera counts as lost.

    Raises:
        ValueError: a number outside its range, controls that cannot be read, or keys that do not go together.
    """

    source: Annotated[
        Literal["vehicle", "v4l2", "libcamera", "gstreamer", "stream", "ros2"],
        choice(
            "where frames come from: the vehicle; a camera of this computer by V4L2, libcamera (Raspberry Pi) or GStreamer "
            "(Jetson); a network camera or a video file; an image topic of ROS 2",
            public=True,
        ),
    ] = "vehicle"
    device: Annotated[
        str,
        text(
            "v4l2: a path under /dev/v4l/by-id or a part of its name; libcamera: number or part of a name, empty for the "
            "only one; gstreamer: the pipeline up to raw frames, as nvarguscamerasrc ! nvvidconv; stream: an address "
            "(rtsp://...), its description (.sdp), a named pipe or a file; ros2: a topic such as /camera/image_raw",
            4096,
            shortest=0,
            public=True,
        ),
    ] = ""
    format: Annotated[
        Literal["auto", Format],
        choice(
            "pixel format of v4l2; auto: the first of these that the camera offers in this size and rate", public=True, page=True
        ),
    ] = "auto"
    rate_hz: Annotated[
        float,
        tuning(
            "frame rate requested from v4l2 and libcamera; of gstreamer, what its pipeline gives", "Hz", 0.1, 1000.0, public=True
        ),
    ] = 30.0
    controls: Annotated[
        str,
        text(
            "controls of v4l2 or libcamera that are fixed, as name=value with commas between; all others stay the camera's. "
            "For a steady frame: auto_exposure=1, exposure_time_absolute=50 (v4l2)",
            4096,
            shortest=0,
            public=True,
            page=True,
        ),
    ] = ""
    buffers: Annotated[int, tuning("frames of v4l2 that the kernel may hold", "buffers", 2, 32)] = 4
    repeat: Annotated[bool, choice("whether a video file starts again at its end", public=True, page=True)] = False
    latency_s: Annotated[
        float,
        tuning(
            "v4l2 and libcamera: delay of the kernel's stamp after the end of the exposure (after its start, "
            "where the driver stamps that); gstreamer: from mid-exposure to the buffer's stamp, below zero where that is "
            "the start of the exposure; stream: from mid-exposure to arrival",
            "s",
            -0.1,
            0.5,
            public=True,
        ),
    ] = 0.0
    latency_sigma_s: Annotated[float, tuning("one standard deviation of it", "s", 0.0, 0.2, public=True)] = 0.005
    arrival_sigma_s: Annotated[
        float,
        tuning(
            "the same for frames of v4l2 and gstreamer that come without a stamp, whose time of arrival is used", "s", 0.0, 0.5
        ),
    ] = 0.02
    exposure_s: Annotated[
        float,
        tuning(
            "exposure time, 0 if unknown; a time reported by v4l2 takes precedence, libcamera sets it", "s", 0.0, 0.5, public=True
        ),
    ] = 0.0
    silence_s: Annotated[float, tuning("time without a frame after which the camera is opened again", "s", 0.02, 30.0)] = 2.0
    reconnect_first_s: Annotated[float, tuning("first back-off before a lost camera is opened again", "s", 0.01, 60.0)] = 0.2
    reconnect_most_s: Annotated[float, tuning("longest back-off; each is twice the one before", "s", 0.01, 60.0)] = 2.0

    exposure: ExposureOptions = ExposureOptions()

    ORDER = ("reconnect_first_s <= reconnect_most_s",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.source not in ("vehicle", "libcamera") and not self.device:
            raise ValueError(f'device must be given with source "{self.source}"')
        if self.source == "ros2" and not self.device.startswith("/"):
            raise ValueError(f"device must be a topic such as /camera/image_raw, got {self.device!r}")
        if self.source == "vehicle" and self.device:
            raise ValueError(f"device {self.device!r} is given, so source must be one of: {', '.join(SOURCES)}")
        if self.latency_s < 0.0 and self.source != "gstreamer":
            raise ValueError(f'latency_s ({self.latency_s:g} s) may be below zero with source "gstreamer" alone')
        if self.exposure.driven and (both := sorted(_DRIVEN & set(self.control_values()))):
            raise ValueError(f'controls: exposure.mode "pad" sets {both[0]!r}: leave it out, or let exposure.mode be "camera"')
        self.control_values()

    @property
    def is_live(self) -> bool:
        """True if the device is an address, the description of one (.sdp) or a named pipe, as opposed to a file."""
        return "://" in self.device or self.device.lower().endswith(".sdp") or Path(self.device).is_fifo()

    def control_values(self) -> dict[str, int | bool | str]:
        """Return the controls by name: whole numbers, true or false, or an entry of the control's menu by its label.

        Raises:
            ValueError: a part of `controls` that is not name=value, or a name that is there twice.
        """
        out: dict[str, int | bool | str] = {}
        for part in self.controls.split(",") if self.controls.strip() else ():
            name, equals, value = (piece.strip() for piece in part.partition("="))
            if not (name and equals and value) or name in out:
                raise ValueError(f"controls: {part.strip()!r} is not name=value, or its name is there twice")
            try:
                out[name] = {"true": True, "false": False}[value] if value in ("true", "false") else int(value)
            except ValueError:
                out[name] = value
        return out


def check_size(size: Size) -> Size:
    """Return the size of frames that is requested from a camera.

    Raises:
        ValueError: the width or height is out of range.
    """
    width, height = size
    if not (16 <= width <= 8192 and 16 <= height <= 8192):
        raise ValueError(f"a frame of {width}x{height} px is out of range (16..8192)")
    return size
