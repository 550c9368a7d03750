"""What C and Python share of the AR.Drone 1.0's video: the header of a UVLC picture, its decoder and its encoder."""

from __future__ import annotations

from .describe import Field, Function, integers

RESULTS = ("UVLC_DONE", "UVLC_SHORT", "UVLC_NO_PICTURE", "UVLC_SIZE", "UVLC_INTER", "UVLC_TORN", "UVLC_BAD_CODE")
"""The results of reading a picture: done, or why not. The data are shorter than a header; they do not begin as a picture does;
its size is none that is decoded; it is coded as the change of another one; they end before it does; they hold a code that the
format does not have."""
WIDTH_MAX, HEIGHT_MAX = 640, 480
"""The size of the largest picture, px."""

CONSTANTS = {
    **{name: value for value, name in enumerate(RESULTS)},
    "UVLC_WIDTH_MAX": WIDTH_MAX, "UVLC_HEIGHT_MAX": HEIGHT_MAX,
}  # fmt: skip
"""Numbers by their names in the header."""

STRUCTS: dict[str, tuple[Field, ...]] = {"uvlc_picture": integers("width", "height", "intra", "quantizer", "number")}
"""The structures. A `uvlc_picture` is a picture's header: `intra` is 1 if the picture needs no other one."""

FUNCTIONS = (
    Function(
        "uvlc_header",
        "int32_t",
        "const uint8_t *data, int32_t bytes, uvlc_picture *picture",
        "estimator/core/video/uvlc_decode.c",
    ),
    Function(
        "uvlc_decode",
        "int32_t",
        "const uint8_t *data, int32_t bytes, const uvlc_picture *picture, uint8_t *bgr",
        "estimator/core/video/uvlc_decode.c",
    ),
    Function(
        "uvlc_encode",
        "int32_t",
        "const uint8_t *bgr, const uvlc_picture *picture, int32_t room, uint8_t *out",
        "sitl/core/video/uvlc_encode.c",
    ),
)
"""Functions of the AR.Drone 1.0's video."""
