"""The page's thirty lines run as they stand there."""

import csv
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from estimator.contracts.estimates import Sighting
from estimator.contracts.samples import Imu
from estimator.ekf import at
from tests.support.estimator_truth import EPOCH_NS, Setting, TruthFlight, events, ns

PAGE = Path(__file__).parents[3] / "docs" / "estimator.md"


def test_thirty_lines_on_a_csv(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    block = re.search(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert block is not None
    assert sum(bool(line.strip()) for line in block[1].splitlines()) <= 33
    example = ModuleType("example")
    exec(compile(block[1], str(PAGE), "exec"), example.__dict__)

    flight = TruthFlight(Setting(seed=2, sea=2, duration_s=6.0, imu_hz=100.0, attitude_wander_deg=0.01, attitude_bias_deg=0.0))
    path = tmp_path / "flight.csv"
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["kind", "measured_at_s", "received_at_s", *"abcdef"])
        for e in events(flight):
            times = [f"{(x - EPOCH_NS) * 1e-9 + 5.0:.9f}" for x in (e.stamp.measured_at, e.stamp.received_at)]
            if isinstance(e, Imu):
                out.writerow(["imu", *times, *e.w_body, *e.f_body])
            elif isinstance(e, Sighting):
                out.writerow(["sighting", *times, *e.d_body_pad_level, e.yaw_rad, "", ""])
    ekf = example.__dict__["follow"](path)
    state = at(ekf, ns(5.9))
    assert state is not None
    truth = flight.relative(np.array([5.9]))[0][0]
    assert np.linalg.norm(state.d_body_pad_level - truth) < 0.2  # at 5.6 m, with no attitude but the accelerometer's
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) >= 5
    assert "deck in 2 s" in printed[-1]
