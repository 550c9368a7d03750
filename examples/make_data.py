"""Make the data of the examples with the simulator: `python -m examples.make_data --out DIR`. It writes over nothing.

pad.jpg is one rendered image, attitude.csv the vehicle's tilt at its exposure; landing.csv holds the sensors, sightings and truth
of a few seconds of the demo's flight. The same seed gives the same files.
"""

from __future__ import annotations

import argparse
import csv
import math
from pathlib import Path

import cv2

from companion.base.observer import NullObserver, ProcessedFrame
from companion.guidance.pilot import make_pilot
from companion.settings.load import load
from decklander import Attitude, Imu, Sighting
from estimator.contracts.samples import Sample
from sitl.flight.stepped import new_flight
from sitl.scenario.scenario import load as load_scenario
from sitl.world.truth import Truth

IMAGE_AT_S, CSV_FROM_S, CSV_FOR_S = 4.0, 2.0, 4.0
ATTITUDE_EACH = 4
"""Every fourth attitude is kept: 50 a second."""
HEADER = ("kind", "measured_s", "received_s", *(f"v{i}" for i in range(8)))


class Tape(NullObserver):
    """Writes down samples, sightings and the first image after `IMAGE_AT_S`."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, float, float, tuple[float, ...]]] = []
        self.image: tuple[ProcessedFrame, Attitude] | None = None
        self.start = self.attitudes = 0

    def seconds(self, instant: int) -> float:
        return (instant - self.start) * 1e-9

    def on_sample(self, sample: Sample) -> None:
        if isinstance(sample, Imu):
            self._row("imu", sample, (*sample.w_body, *sample.f_body))
        elif isinstance(sample, Attitude):
            self.attitudes += 1
            if self.attitudes % ATTITUDE_EACH == 0:
                self._row("attitude", sample, sample.R_ned_body.rpy_rad)

    def on_frame(self, processed: ProcessedFrame) -> None:
        seen = None if processed.detection is None else processed.detection.selected
        if seen is None or seen.yaw_rad is None or processed.attitude is None:
            return
        sigmas = (math.sqrt(v) for v in seen.cov.diagonal())
        self._row("sighting", seen, (*seen.d_body_pad_level, seen.yaw_rad, *sigmas))
        if self.image is None and self.seconds(seen.stamp.measured_at) >= IMAGE_AT_S:
            self.image = processed, processed.attitude

    def on_truth(self, truth: Truth) -> None:
        t = self.seconds(truth.at)
        self.rows.append(("truth", t, t, (*truth.d_body_pad_level, truth.yaw_rad)))

    def _row(self, kind: str, what: Imu | Attitude | Sighting, values: tuple[float, ...]) -> None:
        stamp = what.stamp
        self.rows.append((kind, self.seconds(stamp.measured_at), self.seconds(stamp.received_at), tuple(map(float, values))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the three files")
    folder = parser.parse_args().out
    if there := [name for name in ("pad.jpg", "attitude.csv", "landing.csv") if (folder / name).exists()]:
        parser.error(f"--out {folder}: there is {there[0]} already: name another folder")
    settings, tape = load("sim"), Tape()
    flight = new_flight(load_scenario("demo"), 1, settings, make_pilot(settings), observers=[tape])
    tape.start = flight.world.started
    while tape.seconds(flight.world.at) < CSV_FROM_S + CSV_FOR_S and flight.step():
        if round(tape.seconds(flight.world.at) * 1000) % 200 == 0:
            tape.on_truth(flight.world.truth())
    folder.mkdir(parents=True, exist_ok=True)
    assert tape.image is not None
    processed, attitude = tape.image
    cv2.imwrite(str(folder / "pad.jpg"), processed.frame.px, [cv2.IMWRITE_JPEG_QUALITY, 90])
    roll, pitch, _ = (math.degrees(a) for a in attitude.R_ned_body.rpy_rad)
    with (folder / "attitude.csv").open("w", newline="") as file:
        rows = [("source", "roll_deg", "pitch_deg"), ("pad.jpg", f"{roll:.3f}", f"{pitch:.3f}")]
        csv.writer(file, lineterminator="\n").writerows(rows)
    with (folder / "landing.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(HEADER)
        for kind, measured_s, received_s, values in sorted(tape.rows, key=lambda row: row[2]):
            if measured_s >= CSV_FROM_S:
                table.writerow((kind, f"{measured_s:.4f}", f"{received_s:.4f}", *(f"{v:.5g}" for v in values)))


if __name__ == "__main__":
    main()
