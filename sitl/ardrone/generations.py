"""Differences between an AR.Drone 1.0 and a 2.0, beside the video: keys, navdata options and the views of its channels.

Source: a configuration that a 1.0 with firmware 1.7.4 sent; Parrot's developer guides of SDK 1.7 and 2.0.
"""

from collections.abc import Iterator, Mapping
from typing import Literal

from msgspec import Struct, structs

from estimator.contracts.errors import BadInput
from estimator.vision.camera import Camera
from sitl.ardrone.config import KEYS, Key, Scope

Name = Literal["1.0", "2.0"]
UVLC, P264 = "32", "64"
"""Values of video:video_codec of a 1.0."""
_LATER = (
    "general:drone_serial", "general:localtime", "control:hovering_range", "control:magneto_offset", "video:codec_fps",
    "video:max_bitrate", "video:bitrate_storage", "video:video_on_usb", "video:video_slices", "video:video_live_socket",
    "userbox:userbox_cmd", "gps:latitude", "gps:longitude", "gps:altitude",
)  # fmt: skip
"""Keys that came with the 2.0."""
_OF_THE_FIRST = {
    "general:num_version_mb": "17",
    "general:num_version_soft": "1.7.4",
    "general:soft_build_date": "2011-07-13 09:52",
    "network:ssid_single_player": "ardrone_simulated",
    "network:ssid_multi_player": "ardrone_v1.7.4",
    "pic:pic_version": "100925505",
    "video:bitrate": "6172",
    "video:bitrate_ctrl_mode": "1",
    **{f"general:motor{n}_{part}": value for n in range(1, 5) for part, value in (("soft", "1.20"), ("hard", "3.0"))},
}
_OPTIONS_OF_THE_FIRST = 21


def _keys_of_the_first() -> Iterator[Key]:
    for name, key in KEYS.items():
        if name in _LATER:
            continue
        if name == "video:video_codec":
            yield Key(name, P264, scope=Scope.SESSION, choices=frozenset({UVLC, P264}))
            yield Key("video:camif_buffers", "2", writable=False)
            yield Key("video:num_trackers", "12", writable=False)
        else:
            yield structs.replace(key, default=_OF_THE_FIRST.get(name, key.default))


class Generation(Struct, frozen=True):
    """One generation of the drone."""

    name: Name
    keys: Mapping[str, Key]
    options: int
    """Mask of the navdata options that it sends."""
    frame_rate: str
    """The key that holds the rate of the video's frames, Hz."""
    film_keys: tuple[str, ...]
    """Keys that choose its camera and its codec."""
    bottom_px: tuple[int, int] | None = None
    """Width and height of its bottom camera; None if it sends frames of any size."""

    def check_model(self, model: Name) -> None:
        """Refuse settings for the other generation.

        Raises:
            BadInput: `vehicle.model` of the settings is not this drone's.
        """
        if model != self.name:
            camera = "ardrone1_bottom" if model == "1.0" else "sim"
            raise BadInput(
                f'vehicle.model is "{model}", and the scenario flies an AR.Drone {self.name}: set vehicle.model = "{self.name}", '
                f'or the scenario\'s vehicle.generation = "{model}" with camera.file = "{camera}"'
            )

    def check_camera(self, camera: Camera) -> None:
        """Refuse a scenario's camera that this drone cannot have.

        Raises:
            BadInput: its frames are of another size.
        """
        if self.bottom_px is not None and (camera.width, camera.height) != self.bottom_px:
            raise BadInput(
                f"scenario: camera.file must describe {self.bottom_px[0]}x{self.bottom_px[1]} px, the bottom camera of an "
                f'AR.Drone {self.name}, found {camera.width}x{camera.height} px; "ardrone1_bottom" does'
            )


SECOND = Generation("2.0", KEYS, (1 << 28) - 1, "video:codec_fps", ("video:video_channel", "video:max_bitrate"))
FIRST = Generation(
    "1.0",
    {key.name: key for key in _keys_of_the_first()},
    (1 << _OPTIONS_OF_THE_FIRST) - 1,
    "video:camif_fps",
    ("video:video_channel", "video:video_codec"),
    (176, 144),
)
GENERATIONS: Mapping[Name, Generation] = {"1.0": FIRST, "2.0": SECOND}
