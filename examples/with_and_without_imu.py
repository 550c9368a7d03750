"""Fuse one recording with and without its IMU, the pad seen rarely or hidden at times, and compare both with the truth.

    decklander simulate weather_3 --perception model --record flight.mcap --record-frames none
    python -m examples.with_and_without_imu flight.mcap

Sightings are thinned out, or hidden for a while after each two seconds. The errors of the first seconds do not count: until then
the filter learns the biases of the accelerometer. Of hidden sightings only what is estimated meanwhile counts.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from companion.facts.records import TruthRecord
from companion.recording.reading import Event, RecordedFrame, instant, open_recording
from decklander import Attitude, EstimatorOptions, Imu, RelativeEstimator

LEARNS_S, SEEN_S = 4.0, 2.0
ONE_PAD = replace(EstimatorOptions(), integrity=replace(EstimatorOptions().integrity, pads_apart_m=20.0))
"""No second pad is near: what comes back far from where it was expected is the same one."""
SENSORS = {"camera and attitude": (Attitude, Imu), "every sensor": (object,)}


class Looks(NamedTuple):
    """The camera sees the pad every `each_s`, but for `hidden_s` after each `SEEN_S` not at all."""

    name: str
    each_s: float = 0.0
    hidden_s: float = 0.0

    def hides(self, t_s: float) -> bool:
        return t_s > LEARNS_S and self.hidden_s > 0.0 and (t_s - LEARNS_S) % (self.hidden_s + SEEN_S) < self.hidden_s


LOOKS = (
    Looks("every frame"),
    *(Looks(f"{1.0 / each_s:.0f} a second", each_s) for each_s in (0.2, 0.5, 1.0)),
    *(Looks(f"hidden for {hidden_s:.0f} s", hidden_s=hidden_s) for hidden_s in (1.0, 2.0, 3.0)),
)


def error_m(events: list[Event], looks: Looks, kinds: tuple[type, ...], *, imu: bool) -> float:
    """Return the root mean square of the position's error, m."""
    estimator, squares, next_s = RelativeEstimator(ONE_PAD), list[float](), 0.0
    for event in events:
        t_s = (instant(event) - instant(events[0])) * 1e-9
        if isinstance(event, TruthRecord):
            state = estimator.at(instant(event))
            if state is not None and t_s > LEARNS_S and (looks.hides(t_s) or looks.hidden_s == 0.0):
                squares.append(float(np.sum((state.d_body_pad_level - event.d_body_pad_level) ** 2)))
        elif isinstance(event, RecordedFrame):
            found = event.detection()
            if found is not None and found.selected is not None and t_s >= next_s and not looks.hides(t_s):
                estimator.on_sighting(found.selected)
                next_s = t_s + looks.each_s
        elif isinstance(event, kinds) and (imu or not isinstance(event, Imu)) and hasattr(event, "stamp"):
            estimator.put((event,), wanted=False)
    return float(np.sqrt(np.mean(squares)))


def main(path: Path) -> None:
    """Print a table of the errors."""
    events = list(open_recording([path]).events())
    print(f"{'the pad is seen':16}" + "".join(f"{name + ':':>22} with IMU   without" for name in SENSORS))
    for looks in LOOKS:
        row = [[error_m(events, looks, kinds, imu=imu) for imu in (True, False)] for kinds in SENSORS.values()]
        print(f"{looks.name:16}" + "".join(f"{with_m * 1000:28.0f} mm{without_m * 1000:7.0f} mm" for with_m, without_m in row))


if __name__ == "__main__":
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_file():
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
