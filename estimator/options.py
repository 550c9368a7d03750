"""The estimator's options: which path steers, what is refused at the door, and the numbers of each path."""

from typing import Annotated

from estimator.contracts.estimates import UNSURE, PathName
from estimator.contracts.keys import CheckedOptions, choice, tuning
from estimator.ekf.options import EkfOptions
from estimator.integrity.options import IntegrityOptions

_AR_DRONE = "AR.Drone 2.0"


class DeadReckoningOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Carrying the last sighting on by the drone's own velocity and acceleration."""

    calibration_s: Annotated[
        float,
        tuning(
            "time over which biases are averaged while the drone is still on the ground; 0 for no averaging",
            "s",
            0.0,
            60.0,
            "off in the thesis' code, 10 s in its section 4.3",
        ),
    ] = 0.0
    calibration_samples: Annotated[
        int, tuning("least number of accelerometer samples of this average", "samples", 1, 1_000_000, "thesis section 4.3")
    ] = 1000
    calibration_velocity_max_m_s: Annotated[
        float, tuning("largest measured velocity of a drone at rest; a larger one restarts the calibration", "m/s", 0.001, 10.0)
    ] = 0.15
    calibration_acceleration_max_m_s2: Annotated[
        float,
        tuning("the same for acceleration", "m/s^2", 0.01, 20.0, "an AR.Drone 2.0 at rest shows up to 0.8"),
    ] = 1.5
    velocity_dead_band_m_s: Annotated[
        float, tuning("velocity below which it counts as zero", "m/s", 0.0, 0.5, "3 mm/s in the thesis' code")
    ] = 0.003
    acceleration_dead_band_m_s2: Annotated[
        float, tuning("horizontal acceleration below which it counts as zero", "m/s^2", 0.0, 5.0, "0.5 m/s^2 in the thesis' code")
    ] = 0.5
    velocity_scale: Annotated[
        float, tuning("factor of the measured velocity: one over the ratio at which the vehicle reads it", "1", 0.1, 10.0)
    ] = 1.0
    sigma_velocity_scale: Annotated[
        float, tuning("one standard deviation of the scale that remains", "1", 0.0, 10.0, "AR.Drone 2.0 over several floors")
    ] = 0.2
    sigma_pad_v_m_s: Annotated[
        float, tuning("standard deviation of the pad's own velocity along each horizontal axis", "m/s", 0.0, 10.0)
    ] = 0.15
    sigma_heading_rate_rad_s: Annotated[
        float, tuning("drift of the vehicle's heading against the pad's: one standard deviation", "rad/s", 0.0, 1.0)
    ] = 0.01
    sigma_unknown_v_m_s: Annotated[
        float, tuning("standard deviation of a velocity without a recent sample", "m/s", 0.0, 100.0)
    ] = 1.0
    sigma_vertical_v_m_s: Annotated[
        float, tuning("one standard deviation of a vertical velocity that has leaked to zero", "m/s", 0.0, 100.0)
    ] = 0.3
    vertical_tau_s: Annotated[
        float, tuning("within this time the vertical velocity is pulled towards the sightings' rate", "s", 0.01, 60.0, _AR_DRONE)
    ] = 0.35
    vertical_leak_s: Annotated[
        float, tuning("within this time the vertical velocity leaks to zero without sightings", "s", 0.01, 60.0)
    ] = 1.0
    vertical_mean_s: Annotated[
        float, tuning("the accelerometer's mean over this long is taken for its vertical bias", "s", 0.01, 600.0)
    ] = 5.0
    hold_s: Annotated[float, tuning("time for which a measured velocity or acceleration is used", "s", 0.001, 10.0)] = 0.25
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
    max_gap_s: Annotated[
        float,
        tuning("gap after which the moving median and mean start again", "s", 0.05, 10.0),
    ] = 0.5
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
