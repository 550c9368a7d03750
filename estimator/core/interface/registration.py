"""What C and Python share of registration: the pad's drawing as regions, the camera, what is expected, and what is found."""

from __future__ import annotations

from .describe import Field, Function, doubles, integers

EDGE_KINDS = 5
"""Kinds of edges, by the paints that meet."""
PAD_CONTRASTS = 5
"""The largest number of regions whose paint differs from the one below."""
REGION_CIRCLES = 2
"""The largest number of circles that bound a region."""
PAD_FIGURES = 4
"""The largest number of figures made of rectangles and of what straight sides of any direction enclose."""
FIGURE_CUTS = 64
"""The largest number of limits of a figure's rectangles along one axis."""
FIGURE_RECTANGLES = 320
"""The largest number of rectangles of a figure."""
FIGURE_SIDES = 64
"""The largest number of a figure's straight sides of any direction."""
WEDGE_SIDES = 4
"""The largest number of sides of a wedge."""
POINTER_MARKS = 4
"""Number of points of the pointer, one of which is in the frame if it can be seen."""
PROFILE_PIXELS = 24
"""The largest number of pixels of a profile and of what fills its group up."""
FIT_ROWS = 148
"""Rows of floats, each as long as the largest number of pixels, that a registration works on."""

CONSTANTS = {
    "EDGE_KINDS": EDGE_KINDS, "PAD_CONTRASTS": PAD_CONTRASTS, "REGION_CIRCLES": REGION_CIRCLES, "PAD_FIGURES": PAD_FIGURES,
    "FIGURE_CUTS": FIGURE_CUTS, "FIGURE_RECTANGLES": FIGURE_RECTANGLES, "FIGURE_SIDES": FIGURE_SIDES,
    "WEDGE_SIDES": WEDGE_SIDES, "FIT_ROWS": FIT_ROWS,
    "POINTER_MARKS": POINTER_MARKS,
}  # fmt: skip
"""Numbers by their names in the header: the largest sizes of a drawing."""

STRUCTS: dict[str, tuple[Field, ...]] = {
    "pad_region": (
        *integers("circles", "figure", "has_wedge"),
        *doubles(radius_m=REGION_CIRCLES, sign=REGION_CIRCLES),
    ),
    "pad_figure": (
        *integers("rectangles", "x_cuts", "y_cuts", "sides"),
        Field("x0", "int64_t", FIGURE_RECTANGLES), Field("x1", "int64_t", FIGURE_RECTANGLES),
        Field("y0", "int64_t", FIGURE_RECTANGLES), Field("y1", "int64_t", FIGURE_RECTANGLES),
        *doubles(
            x_m=FIGURE_CUTS, y_m=FIGURE_CUTS, from_x_m=FIGURE_SIDES, from_y_m=FIGURE_SIDES, to_x_m=FIGURE_SIDES,
            to_y_m=FIGURE_SIDES,
        ),
    ),
    "pad_wedge": (
        *integers("sides"), *doubles(nx=WEDGE_SIDES, ny=WEDGE_SIDES, offset_m=WEDGE_SIDES, beyond_m=1),
    ),
    "edge_zone": (
        *integers("on_figure", "beside_figure"), *doubles(inside_m=1, outside_m=1, thinnest_m=1, box_m=4, box_radius_m=1),
    ),
    "pad_shape": (
        *integers("contrast_count", "pointer_kind", "pointer_contrast", "pointer_figure"),
        Field("lies_on", "int64_t", PAD_CONTRASTS), Field("contrast_of_kind", "int64_t", EDGE_KINDS),
        Field("paint_of_kind", "int64_t", EDGE_KINDS),
        *doubles(
            disc_radius_m=1, half_length_m=1, pointer_clear_m=1, gap_m=1,
            pointer_marks_m=2 * POINTER_MARKS, nominal=3 * EDGE_KINDS,
        ),
        Field("contrasts", "pad_region", PAD_CONTRASTS), Field("kinds", "pad_region", EDGE_KINDS),
        Field("figures", "pad_figure", PAD_FIGURES), Field("wedge", "pad_wedge"), Field("zones", "edge_zone", EDGE_KINDS),
    ),
    "camera_lens": (
        *integers("width", "height", "distorted"), *doubles(fx=1, fy=1, cx=1, cy=1, distortion=5, R_body_cam=9),
    ),
    "tilt_prior": (*integers("given"), *doubles(roll_rad=1, pitch_rad=1, cov_tilt=4, sigma_deck_rad=1)),
    "fit_options": (
        *integers("max_profiles", "dense_pixels"),
        *doubles(blur_px=1, edge_sigma_px=1, dense_edge_sigma_px=1, size_sigma_m=1, coded_px=1, noise=1, cut=3),
    ),
    "fit_state": doubles(R=9, t=3, blur_px2=3, m_per_px=1, depth_m=1),
    "edge_support": doubles(contrast_bgr=3, snr=1, in_view=1, inliers=1, likeness=1),
    "fit_solved": (
        *integers("dense", "arrow_seen", "doubted"),
        *doubles(H=81, cov=81, noise_light=1, edge_rms_px=1, visible=1, inliers=1, last_step_px=1),
        Field("state", "fit_state"), Field("edges", "edge_support", EDGE_KINDS),
    ),
    "registration": (
        *integers("dense", "yaw_ambiguous"),
        *doubles(
            R=9, t=3, cov=36, information=36, blur_px2=3, noise_light=1, edge_rms_px=1, visible=1, inliers=1, last_step_px=1,
        ),
        Field("edges", "edge_support", EDGE_KINDS),
    ),
    "camera_sighting": doubles(
        roll_rad=1, pitch_rad=1, cov_tilt=4, sigma_deck_rad=1, R_body_cam=9, t_body_cam=3, R_cam_pad=9, t_cam_pad=3, cov_pose=36,
    ),
    "level_sighting": doubles(d=3, R_level_pad=9, cov_pose=36, yaw_rad=1, cov=16),
}  # fmt: skip
"""A `pad_region` is what its circles (sums with a sign), its figure's rectangles, and the wedge cover. A figure's rectangles lie
between its limits along both axes, which ascend; its sides, whose inside is to the right of their direction seen from above, go
around what else it covers, which no rectangle does. A wedge is where all n p < offset, beyond a circle about the centre. A
`pad_shape` has the regions as painted (`contrasts`: paint over the one that each `lies_on`, -1 for the surroundings) and the
inside of each kind of edge (`kinds`); an `edge_zone` is where an edge of another kind is too near: within and outside of two
radii, in a box, anywhere if the blur is too wide for something thin, where the figure `on_figure` does not cover a pixel wholly,
and where `beside_figure` covers any of it (-1 for neither). The `pointer` is the part of the drawing that tells its two headings
apart. The other structures have what `Camera`, `Orientation`, `RegistrationOptions` and `Registration` have; the
covariances of `fit_solved` are in `pad`. A `camera_sighting` is a pose in `cam` with the attitude and the mount; a
`level_sighting` is the same pose in `level`: its place, rotation and their covariance, the body's heading against the arrow, and
the covariance of place and heading."""

FUNCTIONS = (
    Function(
        "register_pad",
        "int32_t",
        "const camera_lens *camera, const double *rays, const uint8_t *frame, const float *light, const pad_shape *pad, "
        "int32_t points, const double *edges, const int32_t *edge_of, const tilt_prior *prior, const fit_options *o, "
        "const double *start, int32_t room, float *scratch, registration *out, double *outline",
        "estimator/core/vision/register/register.c",
    ),
    Function(
        "sighting_in_level", "void", "const camera_sighting *in, level_sighting *out", "estimator/core/vision/sighting_level.c"
    ),
)
"""The functions of registration. `rays` are those of all pixels if the lens distorts, else null; `light` is the linear light of
each pixel value; `edges` has place, normal and distance to the next of each point of an edge, `edge_of` its kind and piece;
`start` is a rotation and a place; `scratch` has room for `FIT_ROWS` rows of `room` floats; `outline` takes the pixel of every
fourth point."""
