"""The disturbances of the vehicle: gusts, errors of its sensors, the draw of their numbers, effects, and a model that is wrong.

Standard normal numbers for the steps of the physics are rows, drawn in blocks and read by the core. A scenario's table
`[effects]` switches unkind effects on, each with its source; all are off by default. Their formulae are the core's
(`sitl/core/physics`), their sources in docs/sitl.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct, structs

from estimator.contracts.geometry import F64
from estimator.contracts.keys import check_order, number
from sitl.core.library import SIM

BLOCK = 256
"""Rows of a block."""
_WRONG_STREAM = 0x3B0D  # stream of random numbers of the errors of a vehicle's file
_FARTHEST = 2.5
"""No difference is drawn beyond this many standard deviations."""


class Wind(Struct, frozen=True):
    """Steady wind with gusts, uniform around the vehicle.

    Each component of the gust is a first-order Gauss-Markov process, whose spectrum is Dryden's longitudinal one
    (MIL-F-8785C, 3.7.1.2) with a correlation time of length scale over airspeed.
    """

    v_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the steady air in ned, m/s."""
    gust_sigma_m_s: float = 0.0
    """Sigma of each horizontal component; the vertical component has half of it."""
    gust_time_s: float = 2.0


def keep_and_fresh(sigma: float, time_s: float, step_s: float) -> tuple[float, float]:
    """Return the factors of x' = keep x + fresh n, a first-order Gauss-Markov process that is exact for any step length.

    Args:
        sigma: standard deviation of x.
        time_s: correlation time.
    """
    keep = math.exp(-step_s / time_s)
    return keep, sigma * math.sqrt(1.0 - keep**2)


class NoiseRows:
    """Rows of standard normal numbers, one for each step.

    Args:
        draw: draws the next block of `BLOCK` rows, contiguous.
    """

    def __init__(self, draw: Callable[[], F64]) -> None:
        self._draw = draw
        self._rows: F64 = np.empty((0, 0))
        self._first: Any = None
        self._at = self._end = 0

    @staticmethod
    def of(seed: np.random.SeedSequence, width: int) -> NoiseRows:
        """Return rows of this many numbers, all from one generator."""
        rng = np.random.Generator(np.random.PCG64(seed))
        return NoiseRows(lambda: rng.standard_normal((BLOCK, width)))

    def prepare(self) -> int:
        """Draw the next block if none is left; return the number of rows that lie ready at `row`, 1 or more."""
        if self._at == self._end:
            self._rows = self._draw()
            self._first = SIM.array("double", self._rows)
            self._at, self._end = 0, len(self._rows)
        return self._end - self._at

    @property
    def row(self) -> Any:
        """The next row as the core reads it, after `prepare`."""
        return self._first + self._at * self._rows.shape[1]

    def used(self, rows: int) -> None:
        """Note that the next rows are used."""
        self._at += rows

    def next(self) -> list[float]:
        """Use one row and return it."""
        self.prepare()
        row: list[float] = self._rows[self._at].tolist()
        self._at += 1
        return row


class EffectSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Effects that a vehicle's file does not hold."""

    rotor_saturation: Annotated[
        bool, Meta(description="whether no rotor gives more than its part of the largest thrust, or less than none")
    ] = False
    battery_sag: Annotated[
        float,
        number(
            "share of its voltage that the battery loses at full thrust", "1", 0.0, 0.4, "3S, 1 Ah, 60 to 100 mOhm: 0.14 to 0.2"
        ),
    ] = 0.0
    rotor_drag: Annotated[
        bool, Meta(description="whether the linear drag goes with the rotors' speed, instead of staying when they stand still")
    ] = False
    drag_per_m: Annotated[
        float, number("quadratic drag: deceleration by the square of the airspeed", "1/m", 0.0, 0.1, "frontal area of 0.015 m^2")
    ] = 0.0
    downwash_m_s2: Annotated[
        float,
        number(
            "turbulence of the own downwash below 0.6 m over the deck, standard deviation aside", "m/s^2", 0.0, 3.0, "0.5 to 1"
        ),
    ] = 0.0
    moving_deck: Annotated[
        bool, Meta(description="whether the ground effect lags and a deck that comes closer pushes, instead of by height alone")
    ] = False
    vibration_m_s2: Annotated[
        float, number("amplitude of the rotors' vibration in the accelerometer, sampled without a filter", "m/s^2", 0.0, 30.0)
    ] = 0.0
    loop_climb_sigma_m_s: Annotated[
        float, number("standard deviation of the wandering error of the climb rate by which the loops fly", "m/s", 0.0, 1.0)
    ] = 0.0
    loop_rate_sigma_deg_s: Annotated[
        float,
        number("standard deviation of the turn rates by which the loops fly, each step", "deg/s", 0.0, 20.0, "AR.Drone: 1.9"),
    ] = 0.0
    unknown_mass_kg: Annotated[float, number("mass that the loops do not know of", "kg", -5.0, 10.0)] = 0.0
    thing_height_m: Annotated[float, number("height of a thing that lies on the pad; 0 for none", "m", 0.0, 0.2)] = 0.0
    thing_radius_m: Annotated[float, number("its radius", "m", 0.01, 1.0)] = 0.05
    thing_forward_m: Annotated[float, number("its place along the arrow from the centre", "m", -5.0, 5.0)] = 0.0
    thing_right_m: Annotated[float, number("its place to starboard of the arrow", "m", -5.0, 5.0)] = 0.0
    video_least_s: Annotated[
        float, number("least delay of a frame, which wanders up to the most; 90 ms for all if both are 0", "s", 0.0, 1.0)
    ] = 0.0
    video_most_s: Annotated[float, number("most delay of a frame", "s", 0.0, 1.0, "AR.Drone 2.0: 0.06 to 0.15")] = 0.0

    def __post_init__(self) -> None:
        check_order(self, "video_least_s <= video_most_s")


Factor = Annotated[float, number("true value over that of the model", "1", 0.3, 3.0)]
Degrees = Annotated[float, number("true angle less that of the camera's file", "deg", -10.0, 10.0)]


class WrongModel(Struct, frozen=True, forbid_unknown_fields=True):
    """The differences of a vehicle from its model, as one airframe has them; without any it is as its file says.

    A scenario's table `[wrong_model]` says them, and `sigma` draws them for each seed within what an owner's identification
    leaves (docs/sitl.md has the sources). The service still uses the file.
    """

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

    def drawn(self, seed: int) -> WrongModel:
        """Return the differences of a seed, on top of those that are given; they are drawn no more."""
        if self.sigma == 0.0:
            return self
        rng = np.random.default_rng([seed, _WRONG_STREAM])
        values = structs.asdict(self)
        for name, spread in SPREADS.items():
            z = self.sigma * float(np.clip(rng.standard_normal(), -_FARTHEST, _FARTHEST))
            if name == "video_jitter_s":
                z = abs(z)
            is_factor = not name.endswith(("_s", "_deg"))
            values[name] = float(f"{values[name] * math.exp(spread * z) if is_factor else values[name] + spread * z:.5g}")
        return structs.replace(WrongModel(**values), sigma=0.0)

    def as_json(self) -> dict[str, float]:
        """Return what differs."""
        usual = structs.asdict(WrongModel())
        return {name: value for name, value in structs.asdict(self).items() if value != usual[name]}


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
