"""The options of the exposure of a camera that we drive: what the table [camera.exposure] says."""

from typing import Annotated, Literal

from msgspec import Struct

from estimator.contracts.keys import check_ranges, choice, number

DRIVEN_SOURCES = ("v4l2",)
"""Sources of frames whose exposure can be driven from here."""


class ExposureOptions(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Exposure time, gain and white balance of the camera: who sets them, and their limits.

    Raises:
        ValueError: a number outside its range.
    """

    mode: Annotated[
        Literal["camera", "pad"],
        choice(
            "camera: the camera's own automatics, or what camera.controls fixes; pad: the service sets exposure time and gain by "
            'the light on the pad, and fixes the white balance (source "v4l2" alone)',
            public=True,
        ),
    ] = "camera"
    blur_px: Annotated[
        float,
        number("largest smear of the picture during the exposure, by turn rate and motion over the pad", "px", 0.2, 20),
    ] = 1.5
    longest_s: Annotated[
        float, number("longest exposure time, however still the vehicle is; at most 0.8 of a frame's time", "s", 1e-4, 0.1)
    ] = 0.02
    gain_ratio: Annotated[
        float,
        number(
            "amplification at the upper end of the camera's gain control against the lower end, between which it is taken as "
            "linear; 1 leaves the gain alone",
            "1",
            1.0,
            256.0,
            "assumed",
        ),
    ] = 8.0
    settle_frames: Annotated[
        int, number("frames after a change that may still show the exposure before it", "frames", 1, 10, "UVC cameras: 2 to 4")
    ] = 4
    white_balance_k: Annotated[
        int, number("colour temperature that is taken for white, as near as the camera can", "K", 2000, 10000, "daylight")
    ] = 6500

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def driven(self) -> bool:
        """True if the service sets the exposure."""
        return self.mode == "pad"
