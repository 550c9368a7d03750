"""A vehicle that differs from its model: what is true of one airframe, against its file and the settings.

A scenario's table `[wrong_model]` says the differences, and `sigma` draws them for each seed within what an owner's
identification leaves (docs/sitl.md has the sources). The service still uses the file.
"""

import math
from typing import Annotated

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict, replace

from estimator.contracts.keys import number

_STREAM = 0x3B0D
_FARTHEST = 2.5
"""No difference is drawn beyond this many standard deviations."""

Factor = Annotated[float, number("true value over that of the model", "1", 0.3, 3.0)]
Degrees = Annotated[float, number("true angle less that of the camera's file", "deg", -10.0, 10.0)]


class WrongModel(Struct, frozen=True, forbid_unknown_fields=True):
    """The differences; without any the vehicle is as its file says."""

    sigma: Annotated[float, number("differences drawn by the seed, by their standard deviations; 0 for none", "1", 0.0, 5.0)] = (
        0.0
    )
    tilt_frequency: Factor = 1.0
    tilt_damping: Factor = 1.0
    tilt_gain: Factor = 1.0
    thrust: Factor = 1.0
    drag: Factor = 1.0
    downwash: Factor = 1.0
    focal_length: Factor = 1.0
    accelerometer_scale: Factor = 1.0
    gyro_scale: Factor = 1.0
    command_delay_s: Annotated[float, number("additional delay of commands", "s", -0.2, 0.5)] = 0.0
    video_delay_s: Annotated[float, number("delay of frames that their stamps do not know", "s", -0.2, 0.5)] = 0.0
    video_jitter_s: Annotated[float, number("largest additional delay of a frame's arrival, drawn for each", "s", 0.0, 0.5)] = 0.0
    mount_roll_deg: Degrees = 0.0
    mount_pitch_deg: Degrees = 0.0
    mount_yaw_deg: Degrees = 0.0

    @property
    def any(self) -> bool:
        """True if something differs."""
        return self != WrongModel()

    def drawn(self, seed: int) -> "WrongModel":
        """Return the differences of a seed, on top of those that are given; they are drawn no more."""
        if self.sigma == 0.0:
            return self
        rng = np.random.default_rng([seed, _STREAM])
        values = asdict(self)
        for name, spread in SPREADS.items():
            z = self.sigma * float(np.clip(rng.standard_normal(), -_FARTHEST, _FARTHEST))
            if name == "video_jitter_s":
                z = abs(z)
            values[name] = float(f"{values[name] * math.exp(spread * z) if _is_factor(name) else values[name] + spread * z:.5g}")
        return replace(WrongModel(**values), sigma=0.0)

    def as_json(self) -> dict[str, float]:
        """Return what differs."""
        usual = asdict(WrongModel())
        return {name: value for name, value in asdict(self).items() if value != usual[name]}


SPREADS: dict[str, float] = {
    "tilt_frequency": 0.10,
    "tilt_damping": 0.12,
    "tilt_gain": 0.04,
    "thrust": 0.05,
    "drag": 0.20,
    "downwash": 0.40,
    "focal_length": 0.005,
    "accelerometer_scale": 0.01,
    "gyro_scale": 0.01,
    "command_delay_s": 0.010,
    "video_delay_s": 0.010,
    "video_jitter_s": 0.020,
    "mount_roll_deg": 0.5,
    "mount_pitch_deg": 0.5,
    "mount_yaw_deg": 1.0,
}
"""Standard deviations: of a factor's logarithm, or in the key's own unit."""


def _is_factor(name: str) -> bool:
    return not name.endswith(("_s", "_deg"))
