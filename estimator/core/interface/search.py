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
POLAR_RADII, POLAR_ANGLES = 18, 48
"""Polar cells of the drawing."""

CONSTANTS = {
    "SEARCH_BLOCK": SEARCH_BLOCK, "SEARCH_CELL": SEARCH_CELL, "SEARCH_RADII": SEARCH_RADII, "SEARCH_SECTORS": SEARCH_SECTORS,
    "POLAR_RADII": POLAR_RADII, "POLAR_ANGLES": POLAR_ANGLES,
}  # fmt: skip
"""Numbers by their names in the header."""

STRUCTS: dict[str, tuple[Field, ...]] = {
    "search_image": (*integers("width", "height", "stride", "room", "margin"), *doubles(R_cam_plane=9)),
    "search_radii": (*integers("radii", "most"), *doubles(least=1, ratio=1)),
    "search_circle": (
        *integers("bright_inside", "points"), *doubles(centre=2, radius=1, support=1, outline_px=2 * SEARCH_SECTORS),
    ),
    "polar_pad": doubles(
        xy_m=2 * POLAR_RADII * POLAR_ANGLES, area_inside=POLAR_RADII, ring=POLAR_RADII,
        h_marking=POLAR_RADII * POLAR_ANGLES, arrow=POLAR_RADII * POLAR_ANGLES, polarity=1,
    ),
    "polar_fit": doubles(turn_rad=1, score=1, arrow=1, in_view=1),
}  # fmt: skip
"""The structures. A `search_image` is a grey image, room for so many edges, the margin around it in which centres may lie, px,
and the plane that the pad is taken to lie in, at unit distance from the lens. Radii of a search are `least` in that plane and
those that follow, each `ratio` times the one before. A `search_circle` lies in the plane; `support` is the fraction of its
outline with an edge, and `outline_px` has the pixels of these. A `polar_pad` has the drawing in polar cells, radius by radius:
places, area within the disc's paint, and coverage. `polarity` is 1 where the H is brighter than the disc, else -1."""

FUNCTIONS = (
    Function(
        "search_room",
        "int64_t",
        "const search_image *image",
        "search_circles.c",
    ),
    Function(
        "search_circles",
        "int32_t",
        "const search_image *image, const uint8_t *grey, const float *rays, const search_radii *radii, float *scratch, "
        "search_circle *out",
        "search_circles.c",
    ),
    Function(
        "search_heading",
        "int32_t",
        "const camera_lens *c, const polar_pad *pad, const pad_pose *pose, int32_t step, int32_t width, int32_t height, "
        "const uint8_t *px, int32_t stride, const double *side, polar_fit *out",
        "search_heading.c",
    ),
)
"""Functions of the search. `rays` are those of the corners of the blocks, (rows + 1, columns + 1, 2); `scratch` has the floats
that `search_room` asks for. `side` is null, or the direction on the pad of the half of the disc that counts."""
