"""What a person can set about the camera: its file, and where its frames come from."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Struct

from estimator.contracts.keys import choice, number, text


class CameraSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Which camera looks down and where its frames come from; intrinsics, distortion and mount are in a file of their own."""

    file: Annotated[str, text("camera file: the name of a shipped one, or a path relative to the settings file", 4096)]
    source: Annotated[
        Literal["vehicle", "v4l2", "stream"],
        choice("where frames come from: the vehicle itself; a camera of this computer; a network camera or a video file"),
    ] = "vehicle"
    device: Annotated[
        str,
        text(
            "of v4l2: a path under /dev/v4l/by-id or a part of its name; of stream: an address (rtsp://...) or a file",
            4096,
            "",
            0,
        ),
    ] = ""
    format: Annotated[
        Literal["auto", "YUYV", "NV12", "MJPG", "H264", "GREY"],
        choice("pixel format of v4l2; auto is the first of these that the camera offers in the camera file's size at this rate"),
    ] = "auto"
    rate_hz: Annotated[float, number("frames a second asked of v4l2", "Hz", 0.1, 1000.0)] = 30.0
    controls: Annotated[
        str,
        text(
            "controls of v4l2 that are fixed, as name=value with commas between; all others stay the camera's. "
            "For a steady frame: auto_exposure=1, exposure_time_absolute=50",
            4096,
            "",
            0,
        ),
    ] = ""
    latency_s: Annotated[
        float,
        number(
            "v4l2: how much later than half an exposure after its middle the kernel stamps (or after half an exposure before it, "
            "where the driver stamps the start); stream: from mid-exposure to arrival",
            "s",
            0.0,
            0.5,
        ),
    ] = 0.0
    latency_sigma_s: Annotated[float, number("one standard deviation of it", "s", 0.0, 0.2)] = 0.005
    exposure_s: Annotated[
        float, number("how long the shutter is open, 0 when not known; a time that v4l2 itself tells goes before", "s", 0.0, 0.5)
    ] = 0.0
    silence_s: Annotated[float, number("without a frame for this long the camera is opened anew", "s", 0.1, 30.0)] = 2.0
    reconnect_first_s: Annotated[float, number("rest before a lost camera is opened again", "s", 0.01, 60.0)] = 0.2
    reconnect_most_s: Annotated[float, number("longest rest; each is twice the one before", "s", 0.01, 60.0)] = 2.0

    def fault(self) -> str | None:
        """What does not go together, in one line; None when all does."""
        if self.source != "vehicle" and not self.device:
            return f'device must be given with source "{self.source}"'
        if self.source == "vehicle" and self.device:
            return f'device {self.device!r} is given, so source must be "v4l2" or "stream"'
        if self.reconnect_most_s < self.reconnect_first_s:
            return (
                f"reconnect_most_s ({self.reconnect_most_s:g} s) must not be shorter than reconnect_first_s "
                f"({self.reconnect_first_s:g} s)"
            )
        return None
