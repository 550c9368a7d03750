"""A scenario's tables of camera and gimbal: drops on the lens, lamps, the video link, light, and the mount."""

from typing import Annotated, Literal

from msgspec import Struct

from estimator.contracts.keys import CheckedOptions, choice, number

CLEAR_M = 100000.0
"""A visibility without any haze, m."""


class DropSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Water on the lens."""

    rain_per_minute: Annotated[float, number("drops that fall on the lens one by one", "per min", 0.0, 600.0)] = 0.0
    spray_per_minute: Annotated[float, number("gusts of spray that hit the lens, each with many drops", "per min", 0.0, 60.0)] = (
        0.0
    )


class LampSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Lamps on deck."""

    floods: Annotated[int, number("number of floodlights around the pad, the first ahead of it", "1", 0, 8)] = 0
    flood_level: Annotated[float, number("their light in the pad's middle, daylight is 1", "1", 0.0, 2.0)] = 0.05
    pad_lamps: Annotated[
        int, number("number of small lamps in a ring around the pad, the first where the arrow points", "1", 0, 24)
    ] = 0
    pad_lamps_level: Annotated[float, number("brightness of a small lamp, white paint in daylight is 1", "1", 0.0, 50.0)] = 1.0
    own_level: Annotated[
        float, number("brightness of the lamps that the pad's file names, 0 while they are off", "1", 0.0, 50.0)
    ] = 0.0


class VideoSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The video link: without a bit rate frames arrive as the camera made them."""

    bitrate_kbit_s: Annotated[float, number("bit rate of H.264; 0 for frames that are not encoded", "kbit/s", 0.0, 20000.0)] = 0.0
    loss: Annotated[float, number("fraction of the link's packets that are lost", "1", 0.0, 0.9)] = 0.0
    burst_packets: Annotated[float, number("packets lost in a row, on average", "1", 1.0, 200.0, "assumed")] = 4.0


class LightSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The light on the scene, and the exposure of the camera."""

    colour_temperature_k: Annotated[float, number("colour temperature of the light", "K", 1700.0, 25000.0)] = 6500.0
    exposure_ev: Annotated[float, number("stops against white paint at 80 % of full scale", "1", -6.0, 6.0)] = 0.0
    sun_elevation_deg: Annotated[float, number("elevation of the sun over the horizon", "deg", 3.0, 90.0)] = 55.0
    sun_azimuth_deg: Annotated[float, number("azimuth of the sun, clockwise from north", "deg", -360.0, 360.0)] = 140.0
    drone_shadow: Annotated[
        float, number("fraction of light missing in the vehicle's own shadow; 0 under clouds", "1", 0.0, 1.0)
    ] = 0.45
    glare: Annotated[float, number("brightness of the mirrored sun on the pad, in units of white paint", "1", 0.0, 10.0)] = 0.0
    wetness: Annotated[float, number("wetness of deck and pad, from 0 (dry) to 1 (soaked)", "1", 0.0, 1.0)] = 0.0
    daylight_ev: Annotated[float, number("stops of light against full daylight, -5 at dusk", "1", -12.0, 1.0)] = 0.0
    visibility_m: Annotated[float, number("meteorological visibility; less than 100 m is dense fog", "m", 5.0, CLEAR_M)] = CLEAR_M
    glint: Annotated[
        float, number("brightness of the sun mirrored by the sea, and by a wet deck, in units of white paint", "1", 0.0, 50.0)
    ] = 0.0
    mast_height_m: Annotated[float, number("height of the mast that casts a shadow; 0 for none", "m", 0.0, 60.0)] = 0.0
    mast_forward_m: Annotated[float, number("position of the mast from the pad, along the arrow", "m", -100.0, 100.0)] = 2.0
    mast_right_m: Annotated[float, number("position of the mast from the pad, to the right of the arrow", "m", -100.0, 100.0)] = (
        0.5
    )


class GimbalSettings(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """A gimbal; only an autopilot in miniature has one (`simulate --autopilot ...`)."""

    device_id: Annotated[
        int, number("its component id, or 1 to 6 for one that the autopilot itself drives; 0 for a fixed camera", "id", 0, 255)
    ] = 0
    start_pitch_deg: Annotated[float, number("its pitch at the start, against the horizon", "deg", -120.0, 45.0)] = 0.0
    lag_s: Annotated[float, number("time constant with which it follows its command", "s", 0.01, 5.0)] = 0.3
    wander_deg: Annotated[
        float, number("how far it swings about its command, in pitch, and half as far in roll", "deg", 0.0, 30.0)
    ] = 0.0
    wander_hz: Annotated[float, number("how often it does so", "Hz", 0.01, 5.0)] = 0.3
    leak: Annotated[
        float, number("fraction of the vehicle's roll and pitch that it does not take out", "1", 0.0, 1.0, "assumed")
    ] = 0.03
    yaw: Annotated[Literal["vehicle", "earth"], choice("whether it reports its yaw from the vehicle's heading or from north")] = (
        "vehicle"
    )
    report_delay_s: Annotated[float, number("delay of its reports, whose stamps are right", "s", 0.0, 0.5)] = 0.01
    leaves_at_s: Annotated[float, number("time at which somebody else points it ahead; 0 for never", "s", 0.0, 3600.0)] = 0.0
    silent_at_s: Annotated[float, number("time at which its reports end; 0 for never", "s", 0.0, 3600.0)] = 0.0

    @property
    def given(self) -> bool:
        """True if there is a gimbal."""
        return self.device_id != 0
