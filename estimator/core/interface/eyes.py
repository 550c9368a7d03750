"""What C and Python share of alignment: the pad's drawing as maps, its alignment with a frame, and the verification."""

from __future__ import annotations

from .describe import Field, Function, doubles, integers

FRAME_LEVELS = 5
"""The highest level of a frame's pyramid: level k is 2**k times smaller."""
TEMPLATE_BLURS = 5
"""Number of maps of the drawing, each blurred more than the one before."""
TEMPLATE_ONE = 16384
"""Value of full coverage in a map."""
LOCAL_MAX = 128
"""The widest neighbourhood of a pixel whose mean light is subtracted, px to either side."""
SAMPLE_LANES = 8
"""Samples are handled in groups of so many, and their rows are as long as whole groups."""
APPROACH_SAMPLES = 1000
"""Largest number of samples in the disc's bounding box on the way to a registration."""
APPROACH_STEPS = 6
"""Steps of Gauss and Newton on that way."""
FINAL_SAMPLES = 2600
"""Largest number of samples in the disc's bounding box for verification."""
SCRATCH_ROWS = 35
"""Number of floats for each pixel of the part of a frame that is aligned, beside a row of it with `LOCAL_MAX` at either end."""
FEATURES = (
    "one", "h_marking", "ring", "edge", "h_marking_all", "ring_all", "edge_all",
    "h_and_ring", "h_and_edge", "ring_and_edge", "two_of_three", "some_ring", "some_edge", "some_two", "h_alone", "no_h",
    "no_ring", "no_edge", "ring_lags", "flanks", "arrow", "no_arrow",
    "template_gain", "inliers", "white", "orange_place", "orange_odd", "disc_place", "size", "in_view", "tilt",
)  # fmt: skip
"""Names of the verification's features, in order; `estimator.vision.detect.verification` says what they are."""

CONSTANTS = {
    "FRAME_LEVELS": FRAME_LEVELS, "TEMPLATE_BLURS": TEMPLATE_BLURS, "TEMPLATE_ONE": TEMPLATE_ONE, "LOCAL_MAX": LOCAL_MAX,
    "SAMPLE_LANES": SAMPLE_LANES, "SCRATCH_ROWS": SCRATCH_ROWS, "APPROACH_SAMPLES": APPROACH_SAMPLES,
    "APPROACH_STEPS": APPROACH_STEPS, "FINAL_SAMPLES": FINAL_SAMPLES, "FEATURES": len(FEATURES),
    **{f"FEATURE_{name.upper()}": value for value, name in enumerate(FEATURES)},
}  # fmt: skip
"""Numbers by their names in the header."""

STRUCTS: dict[str, tuple[Field, ...]] = {
    "frame_part": integers("level", "left", "top", "width", "height"),
    "pad_pose": doubles(R=9, t=3),
    "pad_template": (
        *integers("n", "disc_channel", "arrow_rows", "arrow_columns", "disc_drawn"),
        *doubles(
            per_m=1, log_blur=TEMPLATE_BLURS, local_m=1, reach_m=1, disc_radius_m=1, disc_edge_m=1,
            h_half_length_m=1, h_half_width_m=1, ring_inner_m=1, ring_outer_m=1,
            arrow_tip_m=1, arrow_depth_m=1, arrow_half_base_m=1, arrow_margin_m=1, arrow_pitch_m=1, orange_place=3, h_side=3,
        ),
    ),
    "alignment": (*integers("steps", "local", "one_side"), *doubles(sigma_tilt_rad=1, side=2, cut=3, noise=1)),
    "frame_quality": doubles(noise=1, contrast=1, chroma=1),
    "cover_line": doubles(cut=3, gain=1, left=1),
    "aligned_pad": doubles(
        paints=12, local_paints=12, sample_m=1, in_view=1, tilt_sigmas=1, arrow=6, features=len(FEATURES),
        light_n=4, light_mean=12, light_var=12,
    ),
}  # fmt: skip
"""The structures. A `frame_part` is a part of one level of a pyramid, px of that level. A `pad_pose` takes the pad's axes to
the camera's. In `pad_template`, a map has n rows along x and n columns along y, and the centre in its middle; `log_blur` are
the logarithms of the maps' standard deviations, m; `h_side` is -1 in a channel in which the H is darker than the disc, else 1.
In `aligned_pad`, paints are (4, 3); `arrow` has found, seen and clear at its place and at the opposite one; `light_*` are
number, mean and variance of the light's logarithm where one paint shows alone. A `cut` is a line across the frame: rays (x, y)
with `cut[0] x + cut[1] y + cut[2] < 0` do not count, so that zeros cut nothing off; the first two are a unit vector. In
`cover_line`, `gain` is by how much the logarithm of the residuals' variance falls, on average, if what lies beyond the cut is
another thing of one colour, and `left` the share of the light's variation that the drawing leaves on this side of it."""

_FROM = "const float *light, const frame_part *part, const uint8_t *px, int32_t stride, "
FUNCTIONS = (
    Function(
        "align_view",
        "int32_t",
        "const camera_lens *c, const pad_template *p, const pad_pose *pose, int32_t most, frame_part *out",
        "estimator/core/vision/align/view.c",
    ),
    Function(
        "align_arrow_view",
        "void",
        "const camera_lens *c, const pad_template *p, const pad_pose *pose, frame_part *out",
        "estimator/core/vision/align/view.c",
    ),
    Function(
        "align_move",
        "int32_t",
        f"const camera_lens *c, const pad_template *p, const int16_t *maps, {_FROM}"
        "const alignment *how, pad_pose *pose, double *tilt_sigmas, float *scratch",
        "estimator/core/vision/align/move.c",
    ),
    Function(
        "align_fit",
        "int32_t",
        f"const camera_lens *c, const pad_template *p, const int16_t *maps, const int16_t *local_maps, {_FROM}"
        "const frame_part *arrow_part, const uint8_t *arrow_px, int32_t arrow_stride, const pad_pose *pose, "
        "double tilt_sigmas, const double *cut, const frame_quality *of, float *scratch, aligned_pad *out",
        "estimator/core/vision/align/fit.c",
    ),
    Function(
        "frame_noise",
        "void",
        "const uint8_t *px, int32_t stride, int32_t width, int32_t height, frame_quality *out",
        "estimator/core/vision/frame_noise.c",
    ),
    Function(
        "align_cover",
        "int32_t",
        f"const camera_lens *c, const pad_template *p, const int16_t *maps, {_FROM}"
        "const pad_pose *pose, float *scratch, cover_line *out",
        "estimator/core/vision/align/cover.c",
    ),
)
"""Functions of alignment."""
