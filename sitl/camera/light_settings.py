"""What a scenario says of the light on the scene."""

from __future__ import annotations

from typing import Annotated

from msgspec import Struct

from estimator.contracts.keys import number
from sitl.camera.picture_settings import CLEAR_M


class LightSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The light on the scene, and the white balance of the camera."""

    colour_temperature_k: Annotated[float, number("colour temperature of the light", "K", 1700.0, 25000.0)] = 6500.0
    balanced_for_k: Annotated[float, number("colour temperature that the camera takes for white", "K", 1700.0, 25000.0)] = 6500.0
    gain_red: Annotated[float, number("white-balance error on red beyond that; 1 for none", "1", 0.2, 5.0)] = 1.0
    gain_blue: Annotated[float, number("white-balance error on blue beyond that; 1 for none", "1", 0.2, 5.0)] = 1.0
    exposure_ev: Annotated[float, number("stops against white paint at 80 % of full scale", "1", -6.0, 6.0)] = 0.0
    vignetting: Annotated[float, number("fraction of light lost in the corners", "1", 0.0, 1.0)] = 0.2
    sun_elevation_deg: Annotated[float, number("elevation of the sun over the horizon", "deg", 3.0, 90.0)] = 55.0
    sun_azimuth_deg: Annotated[float, number("azimuth of the sun, clockwise from north", "deg", -360.0, 360.0)] = 140.0
    drone_shadow: Annotated[
        float, number("fraction of light missing in the vehicle's own shadow; 0 under clouds", "1", 0.0, 1.0)
    ] = 0.45
    glare: Annotated[float, number("brightness of the mirrored sun on the pad, in units of white paint", "1", 0.0, 10.0)] = 0.0
    wetness: Annotated[float, number("wetness of deck and pad, from 0 (dry) to 1 (soaked)", "1", 0.0, 1.0)] = 0.0
    wear: Annotated[float, number("standard deviation of the paint's brightness", "1", 0.0, 0.5)] = 0.06
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
    mast_shadow: Annotated[float, number("fraction of light missing in the mast's shadow", "1", 0.0, 1.0)] = 0.6
