"""The golden vectors: 8 headings x 3 tilts x both stacks, as bytes on the wire.

    python -m tests.companion.mavlink.golden     writes golden_landing_target.json again

The fields are computed here with one turn after the other (tests.companion.mavlink.receivers), not by the codec under test.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import mav
from tests.companion.mavlink.receivers import Vector, ned_to_body

FILE = Path(__file__).with_name("golden_landing_target.json")
HEADINGS_DEG = (0, 45, 90, 135, 180, -135, -90, -45)
TILTS_DEG = ((0.0, 0.0), (15.0, -7.0), (-11.0, 18.0))
D_NED: Vector = (0.83, -1.42, 4.1)
P_NED: Vector = (31.0, -52.0, -17.0)
ARROW_DEG = 25.0
RADIUS_M = 0.39
TIME_US = 1_234_567_890


@dataclass(frozen=True)
class Case:
    """One vector."""

    stack: str
    heading_deg: int
    roll_deg: float
    pitch_deg: float

    @property
    def name(self) -> str:
        return f"{self.stack} heading {self.heading_deg} roll {self.roll_deg:g} pitch {self.pitch_deg:g}"

    @property
    def rpy(self) -> Vector:
        return math.radians(self.roll_deg), math.radians(self.pitch_deg), math.radians(self.heading_deg)


CASES = [Case(stack, h, *tilt) for stack in ("ardupilot", "px4") for h in HEADINGS_DEG for tilt in TILTS_DEG]


def wire(case: Case) -> str:
    """Return the bytes of one case, hexadecimal."""
    x, y, z = ned_to_body(case.rpy, D_NED)
    distance = math.sqrt(x * x + y * y + z * z)
    size = 2 * math.atan(RADIUS_M / distance)
    if case.stack == "ardupilot":
        frame, place = 12, (x, y, z)
    else:
        frame, place = 1, (P_NED[0] + D_NED[0], P_NED[1] + D_NED[1], P_NED[2] + D_NED[2])
    message = mav.MAVLink_landing_target_message(
        TIME_US, 0, frame, math.atan(y / z), math.atan(-x / z), distance, size, size, *place, (0.0, 0.0, 0.0, 0.0), 3, 1
    )
    return Codec(7, 191).pack(message).hex()


if __name__ == "__main__":
    FILE.write_text(json.dumps({case.name: wire(case) for case in CASES}, indent=1) + "\n")
