"""The estimator's options: which path steers, what is refused at the door, and the numbers of each path."""

from typing import Annotated, ClassVar

from estimator.contracts.estimates import UNSURE, PathName
from estimator.contracts.keys import CheckedOptions, choice, tuning
from estimator.ekf.options import EkfOptions
from estimator.integrity.options import IntegrityOptions


class DeadReckoningOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Carrying the last sighting on by the drone's own velocity and acceleration."""

    velocity_dead_band_m_s: ClassVar[float] = 0.003  # Velocity below which it counts as zero (3 mm/s in the thesis' code)
    acceleration_dead_band_m_s2: ClassVar[float] = 0.5
    """Horizontal acceleration below which it counts as zero (0.5 m/s^2 in the thesis' code)."""
    velocity_scale: Annotated[
        float, tuning("factor of the measured velocity: one over the ratio at which the vehicle reads it", "1", 0.1, 10.0)
    ] = 1.0
    sigma_velocity_scale: Annotated[
        float, tuning("one standard deviation of the scale that remains", "1", 0.0, 10.0, "AR.Drone 2.0 over several floors")
    ] = 0.2
    sigma_pad_v_m_s: ClassVar[float] = 0.15  # Standard deviation of the pad's own velocity along each horizontal axis
    sigma_heading_rate_rad_s: ClassVar[float] = 0.01  # Drift of the vehicle's heading against the pad's: one standard deviation
    sigma_unknown_v_m_s: ClassVar[float] = 1.0  # Standard deviation of a velocity without a recent sample
    sigma_vertical_v_m_s: ClassVar[float] = 0.3  # One standard deviation of a vertical velocity that has leaked to zero
    vertical_tau_s: ClassVar[float] = 0.35
    """Within this time the vertical velocity is pulled towards the sightings' rate (drift of an AR.Drone in its own hover)."""
    vertical_leak_s: ClassVar[float] = 1.0  # Within this time the vertical velocity leaks to zero without sightings
    vertical_mean_s: ClassVar[float] = 5.0  # The accelerometer's mean over this long is taken for its vertical bias
    hold_s: ClassVar[float] = 0.25  # Time for which a measured velocity or acceleration is used
    history_s: Annotated[
        float, tuning("largest delay of a sighting; estimator.max_delay_s if that is longer", "s", 0.05, 30.0)
    ] = 1.5


class EstimatorOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The estimator that turns samples and sightings into the estimate for guidance.

    Raises:
        ValueError: a number outside its range, or a history shorter than the delay that is allowed.
    """

    path: Annotated[
        PathName,
        choice(
            "estimator that steers: the error-state filter; filtered sightings; these propagated by dead reckoning; or a Kalman "
            "filter of constant velocity (extra compare)",
            public=True,
            page=True,
        ),
    ] = "ekf"
    min_confidence: Annotated[float, tuning("least confidence of a sighting; 1 is certain", "1", 0.0, 1.0)] = UNSURE
    max_delay_s: Annotated[float, tuning("largest age of a frame on arrival; an older one is refused", "s", 0.05, 5.0)] = 0.5
    history_s: Annotated[float, tuning("time for which attitudes are kept for late frames", "s", 0.1, 30.0)] = 2.0
    ekf: EkfOptions = EkfOptions()
    dead_reckoning: DeadReckoningOptions = DeadReckoningOptions()
    integrity: IntegrityOptions = IntegrityOptions()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.history_s <= self.max_delay_s:
            raise ValueError(
                f"history_s ({self.history_s:g} s) must exceed max_delay_s ({self.max_delay_s:g} s), or the oldest frames "
                "accepted would find no attitude"
            )
