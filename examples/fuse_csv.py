"""Fuse IMU, attitude and sightings from a CSV file, and compare with truth: `python -m examples.fuse_csv [FILE]`."""

import csv
import sys

import numpy as np

from decklander import Attitude, Imu, RelativeEstimator, Rotation, Sighting, Stamp, shipped

path = sys.argv[1] if len(sys.argv) > 1 else str(shipped("examples/landing.csv"))
estimator, errors_m = RelativeEstimator(), []
with open(path, newline="") as file:
    for row in csv.reader(file):
        if row[0] == "kind":
            continue
        stamp = Stamp.from_seconds(float(row[1]), float(row[2]), sigma_s=0.002)
        values = np.array(row[3:], dtype=float)
        if row[0] == "imu":
            estimator.on_imu(Imu(stamp, w_body=values[:3], f_body=values[3:6]))
        elif row[0] == "attitude":
            estimator.on_attitude(Attitude(stamp, Rotation.from_rpy(*values[:3]), cov_body=np.eye(3) * np.radians(0.5) ** 2))
        elif row[0] == "sighting":
            cov, yaw_rad = np.diag(values[4:] ** 2), float(values[3])
            estimator.on_sighting(Sighting(stamp, 0, "fused", values[:3], yaw_rad, False, cov, confidence=1.0))
        elif row[0] == "truth" and (state := estimator.at(stamp.measured_at)) is not None:
            errors_m.append(float(np.linalg.norm(state.d_body_pad_level - values[:3])))
            forward, right, down = state.d_body_pad_level
            print(
                f"{float(row[1]):5.2f} s: pad at {forward:5.2f} {right:5.2f} {down:5.2f} m, error {errors_m[-1] * 1000:3.0f} mm"
            )
if estimator.lost:
    print(f"left out: {'; '.join(estimator.lost)}")
print(f"median error {np.median(errors_m) * 1000:.0f} mm")
