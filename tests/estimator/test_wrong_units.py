"""An inertial sensor in other units or axes is named within seconds, and the estimate goes on without it."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from estimator import Attitude, Imu, RelativeEstimator, Rotation, Sighting, Stamp
from estimator.contracts.geometry import F64

DATA = Path(__file__).parents[2] / "configs/examples/landing.csv"
Wrong = Callable[[F64, F64], tuple[F64, F64]]


def fused(wrong: Wrong, angles: Callable[[F64], F64] = np.asarray) -> tuple[float, dict[str, float]]:
    """Return the median error, m, and the time from which each sentence about a lost sensor stood, s."""
    estimator, errors, lost = RelativeEstimator(), list[float](), dict[str, float]()
    with DATA.open(newline="") as file:
        rows = list(csv.reader(file))[1:]
    for kind, measured_s, received_s, *texts in rows:
        stamp, v = Stamp.from_seconds(float(measured_s), float(received_s), sigma_s=0.002), np.array(texts, dtype=float)
        if kind == "imu":
            w, f = wrong(v[:3], v[3:6])
            estimator.on_imu(Imu(stamp, w_body=w, f_body=f))
        elif kind == "attitude":
            estimator.on_attitude(Attitude(stamp, Rotation.from_rpy(*angles(v[:3])), cov_body=np.eye(3) * np.radians(0.5) ** 2))
        elif kind == "sighting":
            estimator.on_sighting(Sighting(stamp, 0, "fused", v[:3], float(v[3]), False, np.diag(v[4:] ** 2), confidence=1.0))
        elif (state := estimator.at(stamp.measured_at)) is not None:
            errors.append(float(np.linalg.norm(state.d_body_pad_level - v[:3])))
        for text in estimator.lost:
            lost.setdefault(text, float(received_s) - float(rows[0][2]))
    return float(np.median(errors)), lost


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda w, f: (w, f / 9.81), "it may be in g"),
        (lambda w, f: (w, -f), "reads the thrust downward"),
        (lambda w, f: (w * [1, -1, -1], f * [1, -1, -1]), "its axes have to be forward, right, down"),
        (lambda w, f: (np.degrees(w), f), "it may be in degrees"),
        (lambda w, f: (w[[1, 0, 2]] * [1, -1, 1], f), "turns about forward as the attitude does about right"),
        (lambda w, f: (w, f[[2, 0, 1]]), "its axes may be exchanged"),
    ],
)
def test_other_units_or_axes_are_named_and_cost_little(wrong: Wrong, words: str) -> None:
    error_m, lost = fused(wrong)
    assert min(at_s for text, at_s in lost.items() if words in text) < 3.0
    assert error_m < 0.2


def test_a_right_sensor_is_not_accused() -> None:
    assert fused(lambda w, f: (w, f))[1] == {}


def test_an_attitude_in_degrees_is_named_alone() -> None:
    ((text, at_s),) = fused(lambda w, f: (w, f), np.degrees)[1].items()
    assert text.startswith("the attitude leans")
    assert at_s < 3.0
