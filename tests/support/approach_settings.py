"""The seeded approaches of `estimator_truth` that the filter's bench and its tests fly, and the filter's options for them."""

import math

import numpy as np

from estimator import ekf
from tests.support.estimator_truth import Setting

LEGS = (
    (0.0, 2.5, 1.5, 5.0), (3.0, 2.5, 1.5, 5.0), (9.0, 0.3, -0.2, 2.0), (26.0, 0.2, 0.2, 2.0), (31.0, -0.6, 0.6, 4.0),
    (36.0, 0.1, 0.0, 2.0),
)  # fmt: skip
DURATION_S = 40.0
OPTIONS = ekf.EkfOptions(
    asd_gyro_rad_s=0.0025,
    asd_accel_m_s2=0.02,
    sigma_accel_bias_m_s2=0.15,
    sigma_accel_bias_down_m_s2=0.15,
    sigma_gyro_bias_rad_s=0.005,
    sigma_attitude_bias_rad=math.radians(0.2),
    asd_attitude_bias_rad_s=2e-4,
    sigma_mount_rad=math.radians(0.4),
)
"""The filter is told what a data sheet would tell of these sensors, and nothing of the errors drawn."""


def setting(seed: int) -> Setting:
    rng = np.random.default_rng([seed, 7])
    mount = 0.4 * rng.standard_normal(3)
    return Setting(
        seed=seed,
        sea=(0, 2, 4)[seed % 3],
        duration_s=DURATION_S,
        imu_hz=100.0,
        attitude_hz=50.0,
        velocity_hz=25.0,
        sighting_hz=(10.0, 30.0)[seed // 3 % 2],
        legs=LEGS,
        hidden_delay_s=float(rng.uniform(-0.02, 0.02)),
        mount_deg=(float(mount[0]), float(mount[1]), float(mount[2])),
        velocity_scale=float(rng.uniform(0.8, 1.1)),
        velocity_over=("ground", "pad")[seed // 6 % 2],
        pose6=seed // 12 % 2 == 0,
        outliers=0.02,
    )
