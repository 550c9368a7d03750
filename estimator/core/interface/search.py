"""What C and Python share of the search for the pad in a whole frame: circles from edges, and the drawing at all headings."""

from __future__ import annotations

from .describe import Field, Function, doubles, integers

SEARCH_BLOCK = 16
"""Side of the blocks of a frame in which contrast is compared and the plane is taken as flat, px."""
SEARCH_CELL = 2
"""Side of the cells that votes are counted in, px."""
SEARCH_RADII = 12
"""The largest number of radii of one search."""
SEARCH_SECTORS = 36
"""Sectors of a circle in which an edge is looked for; each gives one point of the outline."""
SEARCH_LEVELS = 5
"""Sizes of a frame that guesses are compared at: full, half, quarter ... size."""
POLAR_RADII, POLAR_ANGLES = 18, 48
"""Polar cells of the drawing."""

CONSTANTS = {
    "SEARCH_BLOCK": SEARCH_BLOCK, "SEARCH_CELL": SEARCH_CELL, "SEARCH_RADII": SEARCH_RADII, "SEARCH_SECTORS": SEARCH_SECTORS,
    "SEARCH_LEVELS": SEARCH_LEVELS, "POLAR_RADII": POLAR_RADII, "POLAR_ANGLES": POLAR_ANGLES,
}  # fmt: skip
"""Numbers by their names in the header."""

STRUCTS: dict[str, tuple[Field, ...]] = {
    "search_image": (*integers("width", "height", "stride", "room", "margin", "step"), *doubles(R_cam_plane=9)),
    "search_radii": (*integers("radii", "most", "only_bright"), *doubles(least=1, ratio=1)),
    "search_circle": (
        *integers("bright_inside", "points"), *doubles(centre=2, radius=1, support=1, outline_px=2 * SEARCH_SECTORS),
    ),
    "polar_pad": doubles(
        xy_m=2 * POLAR_RADII * POLAR_ANGLES, area_inside=POLAR_RADII, ring=POLAR_RADII,
        h_marking=POLAR_RADII * POLAR_ANGLES, arrow=POLAR_RADII * POLAR_ANGLES, polarity=1, radius_m=1,
    ),
    "polar_fit": doubles(turn_rad=1, score=1, arrow=1, in_view=1),
    "search_frame": (
        *integers("levels", "plane_known", "radii"),
        *(Field(name, "int64_t", SEARCH_LEVELS) for name in ("width", "height", "stride")),
        *doubles(R_cam_plane=9, radius_m=4, sign=4),
    ),
    "pad_strokes": doubles(length_m=1, width_m=1, leg_m=1, bar_m=1, margin_m=1),
    "strokes_image": (*integers("width", "height", "stride", "step", "bright", "plane_known"), *doubles(R_cam_plane=9)),
    "blob_image": (
        *integers("width", "height", "stride", "full_width", "full_height", "full_stride", "grey", "most"),
        *doubles(noise=1, R_cam_plane=9),
    ),
    "search_guess": (*integers("known", "one_sided"), *doubles(R=9, t=3, turn_rad=1, drawing=1, support=1, side=2)),
}  # fmt: skip
"""The structures.

A `search_image` is a grey image `step` times smaller than the frame, room for so many edges, the margin around it in which
centres may lie, px, and the plane that the pad is taken to lie in, at unit distance from the lens. Radii of a search are
`least` in that plane and those that follow, each `ratio` times the one before; it may be for circles that are bright inside
only. A `search_circle` lies in the plane; `support`
is the fraction of its outline with an edge, and `outline_px` has their places in the frame, px.

A `polar_pad` has the drawing in polar cells, radius by radius: places, area within the disc's paint, and coverage. `polarity`
is 1 where the H is brighter than the disc, else -1. A `search_frame` describes the sizes of a frame, the plane, and the circles
of the drawing: radius, and 1 if it is brighter inside, -1 if darker, 0 if that depends on the deck. A `search_guess` is a pose,
the angle by which it is to be turned about its own z axis, the fraction of the variance that the drawing explains there, the
support of the circle that it came from, and in x and y of the turned pad the direction of the half of the disc that counts, if
only one does.

`pad_strokes` are the sizes of the H and the width of the disc around it that counts, and a `strokes_image` is a BGR image
`step` times smaller than the frame, in which the marks may be bright or dark.

A `blob_image` is a BGR image of half the frame's size and the frame itself; whether all channels are equal; the largest number of
blobs; the noise's standard deviation in the half-size image, values of a pixel; and the plane that the pad is taken to lie in.
"""

FUNCTIONS = (
    Function(
        "search_room",
        "int64_t",
        "const search_image *image",
        "estimator/core/vision/search/circles.c",
    ),
    Function(
        "search_circles",
        "int32_t",
        "const search_image *image, const uint8_t *grey, const float *rays, const search_radii *radii, float *scratch, "
        "search_circle *out",
        "estimator/core/vision/search/circles.c",
    ),
    Function(
        "search_heading",
        "int32_t",
        "const camera_lens *c, const polar_pad *pad, const pad_pose *pose, int32_t step, int32_t width, int32_t height, "
        "const uint8_t *px, int32_t stride, const double *side, polar_fit *out",
        "estimator/core/vision/search/heading.c",
    ),
    Function(
        "search_guesses",
        "int32_t",
        "const camera_lens *c, const polar_pad *pad, const search_frame *frame, const uint8_t *const *levels, int32_t circles, "
        "const search_circle *circle, int64_t *rated, const search_guess *before, int32_t most, search_guess *out",
        "estimator/core/vision/search/guesses.c",
    ),
    Function(
        "search_strokes_room",
        "int64_t",
        "const strokes_image *image",
        "estimator/core/vision/search/strokes.c",
    ),
    Function(
        "search_strokes",
        "int32_t",
        "const camera_lens *c, const strokes_image *image, const pad_strokes *h, const uint8_t *px, float *scratch, "
        "int32_t most, search_guess *out",
        "estimator/core/vision/search/strokes.c",
    ),
    Function(
        "search_blobs_room",
        "int64_t",
        "const blob_image *image",
        "estimator/core/vision/search/blobs.c",
    ),
    Function(
        "search_blobs",
        "int32_t",
        "const camera_lens *c, const blob_image *image, const uint8_t *half, const uint8_t *full, float *scratch, "
        "search_circle *out",
        "estimator/core/vision/search/blobs.c",
    ),
)
"""Functions of the search. `rays` are those of the corners of the blocks, (rows + 1, columns + 1, 2); `scratch` has the floats
that `search_room`, `search_strokes_room` or `search_blobs_room` asks for. `side` is null, or the direction on the pad of the half
of the disc that counts. `levels` are the pixels of the frame at full, half, quarter ... size, `half` and `full` those of a
`blob_image`. `rated` has for each circle how many guesses of it are in `before`, one circle's after the other's, or -1; it gets
that number for each circle whose guesses were computed and are complete.
"""
