"""What C and Python share of a look: the drawing registered from a start pose, and whether it is the pad that lies there."""

from __future__ import annotations

from .describe import Field, Function, doubles, integers
from .eyes import FEATURES

FITTED = (
    "one", "template_score", "inliers", "disc_off", "ring_off", "h_off", "ring_unseen", "h_unseen", "dense", "dense_inliers",
    "rms", "visible", "dense_template_score", "dense_disc", "dense_orange",
)  # fmt: skip
"""Names of the inputs of the verification of a registration whose weights are fitted, in order."""
HAND_SET = (
    "no_ring", "no_h", "disc_unseen", "painted", "no_disc", "h_contrast_odd", "disagrees", "not_brighter", "corner",
    "edges_astray", "h_astray", "half_disagrees", "no_h_in_view", "h_disagrees",
)  # fmt: skip
"""Names of the further inputs, whose weights are set by hand; `estimator.vision.register.fit_verification` says what they are."""
EVIDENCE = (*FITTED, *HAND_SET)
"""Names of all inputs, in order."""

CONSTANTS = {
    "EVIDENCE": len(EVIDENCE), **{f"EVIDENCE_{name.upper()}": value for value, name in enumerate(EVIDENCE)},
}  # fmt: skip
"""Numbers by their names in the header."""

STRUCTS: dict[str, tuple[Field, ...]] = {
    "pad_judge": (
        *integers("has_field", "has_ring", "has_letters", "has_fiducials", "disc_has_colour"),
        *doubles(orange_side=3, orange_place=3, template_weights=len(FEATURES), weights=len(EVIDENCE)),
    ),
    "look_options": (*integers("coarse"), *doubles(sigma_tilt_rad=1, t_body_cam=3)),
    "pad_paint": doubles(mean=12, var=12, trust=1),
    "looked_pad": (
        Field("found", "registration"), Field("aligned", "aligned_pad"), Field("seen", "level_sighting"),
        Field("paint", "pad_paint"), *doubles(evidence=len(EVIDENCE), log_odds=1),
    ),
}  # fmt: skip
"""A `pad_judge` has what the verification knows of a pad, by channel the H's nominal side of the disc and the ring's place
between disc (0) and H (1), and the weights of both models. With `coarse` a start is approached on a reduced frame first, with a
tilt of so much. A `pad_paint` has what is known of the logarithm of each paint's light, (4, 3). In a `looked_pad`, `paint` is
what is known of the paints if this is the pad, and `log_odds` is without priors."""

FUNCTIONS = (
    Function(
        "look_at_pad",
        "int32_t",
        "const camera_lens *camera, const double *rays, const uint8_t *frame, const float *light, const float *lights, "
        "const pad_shape *shape, int32_t points, const double *edges, const int32_t *edge_of, const pad_template *drawn, "
        "const int16_t *maps, const int16_t *local_maps, const pad_judge *judge, const tilt_prior *prior, "
        "const fit_options *fit, const frame_quality *quality, const look_options *how, const pad_paint *known, "
        "const double *start, int32_t room, float *scratch, uint8_t *parts, looked_pad *out, double *outline",
        "estimator/core/vision/look/look.c",
    ),
)
"""The function of a look. Its parameters are those of `register_pad` and of alignment: `light` is a table of linear light,
`lights` are three (linear, its root, its logarithm). `scratch` has room for both (`FIT_ROWS` rows of `room` floats), `parts` for
half of the frame's bytes and 24 more for each of its columns."""
