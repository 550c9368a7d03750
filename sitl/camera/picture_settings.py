"""The keys of a scenario that make its frames those of a camera in weather: automatics, drops, lamps, the video link."""

from __future__ import annotations

from typing import Annotated

from msgspec import Struct

from estimator.contracts.keys import number

CLEAR_M = 100000.0
"""A visibility without any haze, m."""


class DropSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Water on the lens."""

    rain_per_minute: Annotated[float, number("drops that fall on the lens one by one", "per min", 0.0, 600.0)] = 0.0
    spray_per_minute: Annotated[float, number("gusts of spray that hit the lens, each with many drops", "per min", 0.0, 60.0)] = (
        0.0
    )
    spray_drops: Annotated[int, number("drops of a gust of spray", "1", 1, 60)] = 12
    radius_px: Annotated[float, number("radius of a drop's blurred disc, on average", "px", 2.0, 200.0, "assumed")] = 28.0
    stays_s: Annotated[float, number("time until a drop has run off, on average", "s", 0.2, 120.0, "assumed")] = 6.0


class LampSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Lamps on deck."""

    floods: Annotated[int, number("number of floodlights around the pad, the first ahead of it", "1", 0, 8)] = 0
    flood_level: Annotated[float, number("their light in the pad's middle, daylight is 1", "1", 0.0, 2.0)] = 0.05
    flood_distance_m: Annotated[float, number("their distance from the pad's centre", "m", 0.5, 30.0)] = 2.5
    flood_height_m: Annotated[float, number("their height over the deck", "m", 0.2, 20.0)] = 1.5
    flood_temperature_k: Annotated[float, number("their colour temperature", "K", 1700.0, 25000.0, "halogen lamps")] = 3200.0
    pad_lamps: Annotated[
        int, number("number of small lamps in a ring around the pad, the first where the arrow points", "1", 0, 24)
    ] = 0
    pad_lamps_radius_m: Annotated[float, number("radius of that ring", "m", 0.3, 10.0)] = 0.55
    pad_lamps_level: Annotated[float, number("brightness of a small lamp, white paint in daylight is 1", "1", 0.0, 50.0)] = 1.0
    own_level: Annotated[
        float, number("brightness of the lamps that the pad's file names, 0 while they are off", "1", 0.0, 50.0)
    ] = 0.0


class VideoSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The video link: without a bit rate frames arrive as the camera made them."""

    bitrate_kbit_s: Annotated[float, number("bit rate of H.264; 0 for frames that are not encoded", "kbit/s", 0.0, 20000.0)] = 0.0
    loss: Annotated[float, number("fraction of the link's packets that are lost", "1", 0.0, 0.9)] = 0.0
    burst_packets: Annotated[float, number("packets lost in a row, on average", "1", 1.0, 200.0, "assumed")] = 4.0
    keyframe_s: Annotated[
        float, number("time between two pictures that need no other", "s", 0.1, 10.0, "the AR.Drone's encoder")
    ] = 1.0
