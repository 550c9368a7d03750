"""Colours that stay apart for the colour-blind, on paper and on a dark screen.

Source: Okabe & Ito, Color Universal Design, 2008; blue and green lifted a little for dark backgrounds. Marker shapes repeat the
distinction where colours would stand alone.
"""

SERIES: dict[str, str] = {
    "ellipse": "#1f86c9",
    "arrow": "#e69f00",
    "corners": "#0a9d76",
    "registration": "#cc79a7",
    "lamps": "#56b4e9",
    "selected": "#d55e00",
    "fused": "#8a63d2",
    "median_mean": "#56b4e9",
    "dead_reckoning": "#d55e00",
    "ekf": "#8a63d2",
    "constant_velocity": "#0a9d76",
}
MARKERS: dict[str, str] = {"ellipse": "o", "arrow": "^", "corners": "s", "registration": "D", "lamps": "*", "selected": "x"}
OTHER = "#888888"
OUTLINE = "#f0e442"
"""The colour of the estimated pad in the video."""

FUSED, REFUSED = "#1f86c9", "#d55e00"
THREE = ("#1f86c9", "#e69f00", "#cc79a7")
"""Three quantities in one plot."""
STAGES = ("#888888", "#1f86c9", "#56b4e9", "#e69f00", "#cc79a7", "#0a9d76", "#8a63d2")
"""The stages of a frame."""
FLIGHTS = ("#1f86c9", "#d55e00")
"""Two flights that are compared."""


def colour(series: str) -> str:
    """Return the hex colour of a method or path."""
    return SERIES.get(series, OTHER)


def bgr(hex_colour: str) -> tuple[int, int, int]:
    """Return the colour `#rrggbb` as the tuple that OpenCV takes."""
    value = int(hex_colour[1:], 16)
    return value & 255, value >> 8 & 255, value >> 16
