"""What C and Python share of simulated frames: fixed-point factors, paints, functions."""

from __future__ import annotations

from .describe import Field, Function

GAIN_ONE = 16384
"""Value of a factor of one on simulated light."""
SCENE_ONE = 32768
"""Value of a scene's pixel that reflects all light, and of wear that does not change it."""
CELL_PX = 8
"""Distance between the rays at which planes are met exactly, px."""
LEVELS_BY_ONE = 512
"""Light up to so many counts is told apart by single counts when noise is added to it, then by four."""
COUNTS_BY_EIGHT = 4096
"""Light from so many counts on is told apart by eight."""
LEVELS_BY_EIGHT = LEVELS_BY_ONE + (COUNTS_BY_EIGHT - LEVELS_BY_ONE) // 4
"""The number of levels below that."""
LIGHT_LEVELS = 2048
"""The number of levels of light; the last one holds all light that is brighter."""
GRAIN_LEVELS = 32
"""The number of levels of noise."""
BLUR_RADIUS_MAX = 30
"""The widest blur of the simulated lens, px."""
PAINTS = ("PAD_NONE", "PAD_RIM", "PAD_DISC", "PAD_ORANGE", "PAD_WHITE", "PAD_UPPER")
"""The paints of a pad, in the order of their shares; the first is what lies around it."""
PAD_EDGE = 255
"""Kind of a pixel that shows several paints."""
REGION = ("PAD_SHAPE", "PAD_PAINT", "PAD_BELOW", "PAD_NEAREST", "PAD_FARTHEST")
"""The first numbers of a painted region: its shape, its paint, the paint that it lies on, and its least and largest distance from
the centre, m; then those of its shape.
"""
SHAPES = {
    "PAD_ANNULUS": ("PAD_ANNULUS_INNER", "PAD_ANNULUS_OUTER"),
    "PAD_RECTANGLE": ("PAD_RECTANGLE_U0", "PAD_RECTANGLE_U1", "PAD_RECTANGLE_V0", "PAD_RECTANGLE_V1"),
    "PAD_ARROW": ("PAD_ARROW_TIP", "PAD_ARROW_BASE", "PAD_ARROW_COS", "PAD_ARROW_SIN"),
    "PAD_POLYGON": ("PAD_POLYGON_SIDES", "PAD_POLYGON_FIRST", *(f"PAD_POLYGON_{k}" for k in range(1, 12))),
}
"""The shapes of regions, and their numbers: m from the centre, and the direction of the arrowhead's sides. A convex polygon of up
to four sides has for each its normal outward and its distance from the centre, m, one after the other from the first.
"""
REGION_NUMBERS = len(REGION) + max(map(len, SHAPES.values()))
REGIONS_MOST = 784
"""The largest number of regions: disc, rim, ring, arrowhead, and the rectangles and convex pieces of lettering of two paints."""
TILE_ONE = 4096
"""Value of one in a texture of the sea."""
SEA_WEIGHTS = ("SEA_SMALL", "SEA_LARGE", "SEA_CALM", "SEA_CAP", "SEA_SHADE", "SEA_WASH", "SEA_WAKE")
"""The strengths of what lies on the sea: small and large ripples, the height below which no crest breaks, the brightness of those
that do, the largest share of light that a ship's shade takes, and the brightness of full foam beside and behind her."""
SEA_OUTLINES = 3
"""The number of outlines of a ship on the water: her shadow, her hull, and her wake."""
SEA_OUTLINE_POINTS = 48
"""The largest number of points of one of them."""
LENS_WINDOW = ("LENS_X", "LENS_Y", "LENS_COLUMNS", "LENS_ROWS")
"""A part of the frame, px: its first column and row, and their numbers."""
LENS_BLOCK = 16
"""So many columns of a row are blurred exactly together, or left as they are."""
STROKE_NUMBERS = 36
"""Numbers of one part of an exposure: homographies in its middle, their change during it, in the first row and in the last."""

CONSTANTS = {
    "GAIN_ONE": GAIN_ONE, "SCENE_ONE": SCENE_ONE, "CELL_PX": CELL_PX, "BLUR_RADIUS_MAX": BLUR_RADIUS_MAX,
    "LEVELS_BY_ONE": LEVELS_BY_ONE, "COUNTS_BY_EIGHT": COUNTS_BY_EIGHT, "LEVELS_BY_EIGHT": LEVELS_BY_EIGHT,
    "LIGHT_LEVELS": LIGHT_LEVELS, "GRAIN_LEVELS": GRAIN_LEVELS,
    "TILE_ONE": TILE_ONE, "SEA_OUTLINES": SEA_OUTLINES, "SEA_OUTLINE_POINTS": SEA_OUTLINE_POINTS,
    "PAD_PAINTS": len(PAINTS), "PAD_EDGE": PAD_EDGE, "STROKE_NUMBERS": STROKE_NUMBERS, "LENS_BLOCK": LENS_BLOCK,
    "PAD_REGION": REGION_NUMBERS, "PAD_REGIONS_MOST": REGIONS_MOST,
    **{name: value for names in (PAINTS, SEA_WEIGHTS, REGION, SHAPES, LENS_WINDOW) for value, name in enumerate(names)},
    **{name: value for names in SHAPES.values() for value, name in enumerate(names, len(REGION))},
}  # fmt: skip
"""Numbers by their names in the header: what simulated frames are made of."""

STRUCTS: dict[str, tuple[Field, ...]] = {}

FUNCTIONS = (
    Function(
        "render_meet",
        "void",
        "int32_t count, const float *rays, const double *plane_from_ray, double most, float *places",
        "sitl/core/render/meet.c",
    ),
    Function(
        "render_bounds",
        "void",
        "int32_t h, int32_t w, const uint8_t *mask, int32_t *covered, int32_t *open",
        "sitl/core/render/bounds.c",
    ),
    Function(
        "render_deck",
        "void",
        "int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const float *cells, int32_t columns, const uint16_t *texels, "
        "int32_t texel_rows, int32_t texel_columns, const uint8_t *mask, uint16_t *scene",
        "sitl/core/render/deck.c",
    ),
    Function(
        "render_fill",
        "void",
        "int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const uint8_t *mask, const uint16_t *colour, uint16_t *scene",
        "sitl/core/render/deck.c",
    ),
    Function(
        "render_shadow",
        "void",
        "int32_t h, int32_t w, const float *cells, int32_t columns, const float *shape, float soft, float share, "
        "const uint8_t *mask, int16_t *gain, int32_t *part",
        "sitl/core/render/shadow.c",
    ),
    Function(
        "render_smear",
        "void",
        "int32_t h, int32_t w, const uint16_t *scene, int32_t count, const int32_t *shifts, const uint16_t *weights, "
        "uint16_t *smeared",
        "sitl/core/render/smear.c",
    ),
    Function(
        "render_average",
        "void",
        "int32_t h, int32_t w, const uint16_t *scene, const int32_t *shifts, uint16_t *averaged",
        "sitl/core/render/smear.c",
    ),
    Function(
        "render_sea",
        "void",
        "int32_t h, int32_t w, const uint8_t *mask, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const float *cells, "
        "int32_t columns, const int16_t *small_texels, const int16_t *large_texels, const int16_t *caps_texels, "
        "const int16_t *streak_texels, const int32_t *sizes, const double *drift, const float *weights, const float *slow, "
        "const double *outlines, const int32_t *outline_points, const float *soft_m, uint8_t *codes",
        "sitl/core/sea/surface.c",
    ),
    Function(
        "render_swell",
        "void",
        "int32_t rows, int32_t columns, const float *rays, const double *R_ned_cam, const double *plane_from_ray, "
        "const double *to_sun, double t_s, int32_t harmonics, const wave *waves, float *light",
        "sitl/core/sea/swell.c",
    ),
    Function(
        "render_water",
        "void",
        "int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const uint8_t *codes, const uint16_t *colours, "
        "const uint8_t *mask, uint16_t *scene",
        "sitl/core/sea/surface.c",
    ),
    Function(
        "render_pad_kinds",
        "int32_t",
        "int32_t h, int32_t w, const float *rays, const float *change, int32_t bent, const float *middles, const float *whole, "
        "int32_t rolling, int32_t regions, const float *pad, uint8_t *kinds, int32_t *edges",
        "sitl/core/render/pad.c",
    ),
    Function(
        "render_pad_shares",
        "void",
        "int32_t h, int32_t w, const float *rays, const float *change, int32_t bent, int32_t strokes, "
        "const float *stroke_numbers, int32_t rolling, int32_t regions, const float *pad, int32_t fine, int32_t count, "
        "const int32_t *edges, float *shares, float *parts",
        "sitl/core/render/pad_shares.c",
    ),
    Function(
        "render_pad_lens",
        "void",
        "int32_t w, const int32_t *window, const uint8_t *kinds, int32_t edges, const int32_t *where, "
        "const float *shares, int32_t fine, const float *parts, int32_t reach, const float *exact, const float *sampled, "
        "const uint16_t *scene, const int16_t *gain, const float *exposure, const uint16_t *pad_scene, int32_t *places, "
        "float *room, int16_t *added",
        "sitl/core/render/pad_lens.c",
    ),
    Function(
        "render_expose",
        "void",
        "int32_t pixels, const uint16_t *scene, const uint8_t *kinds, const int16_t *gain, const float *exposure, "
        "const uint16_t *pad_scene, int16_t *light",
        "sitl/core/render/light.c",
    ),
    Function(
        "render_mix",
        "void",
        "int32_t edges, const int32_t *where, const float *shares, const uint16_t *scene, const int16_t *gain, "
        "const float *exposure, const uint16_t *pad_scene, int16_t *light",
        "sitl/core/render/light.c",
    ),
    Function(
        "render_blur",
        "void",
        "int32_t h, int32_t w, const int16_t *light, int32_t radius, const uint16_t *taps, const int32_t *window, "
        "const int16_t *added, uint16_t *scratch, int16_t *out",
        "sitl/core/render/lens.c",
    ),
    Function(
        "render_frame",
        "void",
        "int32_t h, int32_t w, const int16_t *light, int32_t radius, const uint16_t *taps, const int32_t *window, "
        "const int16_t *added, const uint8_t *noise, const uint8_t *codes, uint16_t *scratch, uint8_t *frame",
        "sitl/core/render/lens.c",
    ),
    Function(
        "render_image",
        "void",
        "int32_t h, int32_t w, const uint16_t *scene, const uint8_t *kinds, const int16_t *gain, const float *exposure, "
        "const uint16_t *pad_scene, int32_t edges, const int32_t *where, const float *shares, int32_t radius, "
        "const uint16_t *taps, const int32_t *window, const int16_t *added, const uint8_t *noise, const uint8_t *codes, "
        "uint16_t *scratch, uint8_t *frame",
        "sitl/core/render/lens.c",
    ),
)
"""Functions that render a frame, stage by stage."""
