"""What C and Python share of a pad's lamps: their pattern, where it is expected, and what is seen of it."""

from __future__ import annotations

from .describe import Field, Function, doubles, integers

LAMPS = 40
"""The largest number of lamps of a pad."""
LAMP_PAIRS = 20
"""The largest number of pairs of lamps that a search tries."""
LAMP_SPOTS = 40
"""The brightest so many spots of a frame are kept."""

CONSTANTS = {"LAMPS": LAMPS, "LAMP_PAIRS": LAMP_PAIRS, "LAMP_SPOTS": LAMP_SPOTS}
"""Numbers by their names in the header."""

STRUCTS: dict[str, tuple[Field, ...]] = {
    "lamp_pattern": (
        *integers("lamps", "pairs"), Field("pair", "int64_t", 2 * LAMP_PAIRS),
        *doubles(x_m=LAMPS, y_m=LAMPS, radius_m=LAMPS, size_sigma_m=1, t_body_cam=3),
    ),
    "lamps_expected": (Field("pose", "pad_pose"), *doubles(reach_px=1)),
    "lamps_seen": (
        *integers("lit"), Field("pose", "pad_pose"), Field("seen", "level_sighting"),
        *doubles(cov=36, confidence=1, log10_odds=1, uv_px=2 * LAMP_SPOTS),
    ),
}  # fmt: skip
"""The structures. A `lamp_pattern` has places and radii of the lamps, the pairs that a search tries, the standard deviation of
the pattern's size at its outermost lamp, and the camera's place in the body. `reach_px` is how far the pad may be from where it
is expected. In `lamps_seen`, `cov` is of the place and of a small rotation of the pad, both in `cam`; `log10_odds` are those that
these spots are the pad's lamps and no other lights; `uv_px` has the `lit` spots that are lamps."""

FUNCTIONS = (
    Function("lamps_room", "int64_t", "const camera_lens *camera", "estimator/core/vision/lamps/lamps.c"),
    Function(
        "find_lamps",
        "int32_t",
        "const camera_lens *camera, const uint8_t *frame, const uint16_t *light, const lamp_pattern *pad, "
        "const tilt_prior *prior, const lamps_expected *at, uint32_t *scratch, lamps_seen *out",
        "estimator/core/vision/lamps/lamps.c",
    ),
)
"""The functions of lamps. `light` has the linear light of each value of a pixel, full scale 65535; `at` may be null; `scratch`
has the numbers that `lamps_room` asks for. `find_lamps` looks where the pad is expected, and searches the whole frame if it is
not there. It returns 1 if the pad is seen, 0 if not, and -1 if the frame has more bright places than a dark deck."""
