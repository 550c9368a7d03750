"""The field of view of a camera fixed to the body, in which the law keeps the pad (estimator/core/law/law.c)."""

from typing import NamedTuple


class FieldOfView(NamedTuple):
    """The camera's field, in the body's axes."""

    forward_m: float
    """The camera ahead of the body's origin."""
    right_m: float
    half_forward_rad: float
    """Half the field ahead and astern."""
    half_right_rad: float
