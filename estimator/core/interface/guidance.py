"""What C and Python share of the law that follows the deck: its gains, its memory, and what it takes and gives in a cycle."""

from __future__ import annotations

from .describe import Field, Function, doubles, integers

UNDER_WAY_MAX = 132
"""The largest number of commands that the law remembers: 0.65 s at 200 cycles a second."""

CONSTANTS = {"UNDER_WAY_MAX": UNDER_WAY_MAX}

STRUCTS: dict[str, tuple[Field, ...]] = {
    "law_params": (
        *integers("remembered", "over_ground", "keeps_in_view", "looks_ahead"),
        *doubles(
            period_s=1, frequency_rad_s=1, damping=1, lag_s=1, tilt_max_m_s2=1, climb_lag_s=1, climb_max_m_s=1,
            view_forward_m=1, view_right_m=1, half_forward_rad=1, half_right_rad=1,
        ),
    ),
    "law_gains": (
        *integers("n", "tilt_delay", "climb_delay"),
        *doubles(slowness_s=1, p=1, w=1, a=1, rate=1, lag=1, under_way=UNDER_WAY_MAX),
    ),
    "law_axis": doubles(p=1, w=1, d=1, b=1, lean=1, rate=1, lag=1, under_way=UNDER_WAY_MAX),
    "axis_measured": doubles(p=1, w=1, lean=1, rate=1, a_body=1, a_deck=1),
    "law_own": doubles(own=1, lean=1, rate=1),
    "law_memory": (
        *integers("begun", "has_turn"),
        *doubles(pushed_down_m_s2=1, turn_yaw_rad=1, turn_rate_rad_s=1, climbs=UNDER_WAY_MAX),
        Field("axes", "law_axis", 2),
        Field("own", "law_own", 2),
    ),
    "law_cycle": (
        *integers("goes_on", "steers", "has_deck", "horizons", "has_yaw", "has_rate", "has_wanted_yaw", "has_lean_max"),
        *doubles(
            dt=1, share=1, forecast_age_s=1, heading_rad=1, d=3, v=3, yaw_rad=1, a_body=3, w_body=3, lean=2, v_deck=3, a_deck=3,
            wanted=3, rate_m_s=1, rate_max_m_s=1, speed_max_m_s=1, wanted_yaw_rad=1, lean_max_rad=1,
        ),
    ),
    "law_command": doubles(a=2, trim=2, v=3, yaw_rate_rad_s=1),
}  # fmt: skip
"""`companion.guidance.law_records` says what the members mean where their names do not. Vectors are written in `level`, axes and
commands under way in axes that do not turn with the nose; delays are numbers of periods, commands come newest first."""

FUNCTIONS = (
    Function(
        "law_observe",
        "void",
        "const law_params *o, const double *observer, double dt, double arrived, const law_axis *before, const axis_measured *z, "
        "law_axis *after",
        "estimator/core/law/axis.c",
    ),
    Function(
        "law_tilt",
        "double",
        "const law_axis *x, const law_gains *gains, double off_m, double a_deck, double a_deck_then",
        "estimator/core/law/axis.c",
    ),
    Function(
        "law_step",
        "void",
        "const law_params *o, const law_gains *gains, const law_gains *gains_before, const double *observer, "
        "const law_cycle *in, const double *horizons_s, const double *rates_m_s, const law_memory *before, law_memory *after, "
        "law_command *out",
        "estimator/core/law/law.c",
    ),
)
"""One axis of the law, which its stability margins ask too, and one whole cycle."""
