"""Facts that every source of a ship's reports shares: noise, words for refusals, and how lines of its logs look."""

import math
import re

import numpy as np

from estimator.contracts.samples import UNKNOWN_VAR, BaselineFix

HEADING_SIGMA_RAD = math.radians(2.0)
"""Standard deviation of a ship's compass."""
COV_SPEED = np.diag([0.2**2, 0.2**2, UNKNOWN_VAR])
"""(3, 3) (m/s)^2 covariance of a ship's velocity by her GNSS receiver, which has no vertical one."""
COV_SPEED.setflags(write=False)
FLOOR_M: dict[BaselineFix, tuple[float, float, float]] = {"fixed": (0.01, 0.01, 0.02), "float": (0.3, 0.3, 0.5)}
"""Standard deviation of what no receiver states, north, east and down, by the kind of the solution, m (assumed)."""
RATE_MAX = 1000.0  # sentences that are read each second
SOURCE_MAX = 0.25
"""Share of both that one source may have: a storm of one kind by one talker leaves time for the others, and one of all kinds
leaves time for the flight."""
SENTENCE = re.compile(
    rb"(\\[^\\]*\\)?[$!][A-Za-z]{4,6},[ -~]*?(?:\*[0-9A-Fa-f]{2}|$)|:[0-9A-Fa-f]{6} [- ]\d{4}[A-Za-z][- ]\d{4} [- ]\d{4}"
)
"""A sentence of NMEA 0183 or AIS in a line, with its tag block."""
NETWORK_LINE = re.compile(
    rb"\d{4}-\d\d-\d\d[T-][\d:.]+Z?(?:,\d+){5}(?:,[0-9a-fA-F]{2})+"
    rb"|\(\d+\.\d+\) +\S+ +[0-9a-fA-F]{8}#[0-9a-fA-F]*"
    rb"|\d\d:\d\d:\d\d\.\d+ +[RT](?: +[0-9a-fA-F]{8})(?: +[0-9a-fA-F]{2})+"
    rb'|\{"timestamp":.*"pgn":.*\}'
)
"""A line of a log whose time `logger_s` finds."""

REFUSED_FOR = {
    "no_fix": "the receiver has no fix",
    "no_heading": "the compass has no heading yet",
    "typed_in": "her place was typed in by hand",
    "simulated": "it says that it is simulated; for a rehearsal set expert.vessel.nmea_simulated",
    "reckoned": "its velocity is reckoned from an old place",
    "impossible": "it holds a number that no ship has",
    "no_variation": "a heading or course from magnetic north, and no variation",
    "not_over_ground": "a wind over the water, whose current is not known",
    "bad_quality": "the sensor says that its data are not good",
    "other_receiver": "another of her receivers is used",
    "repeated": "the same receiver says it in a sentence that has more about it",
    "no_way": "an apparent wind without her heading and velocity",
    "too_many": f"more than {RATE_MAX:.0f} sentences a second, or {SOURCE_MAX * RATE_MAX:.0f} of one source",
}
"""Meanings of reasons whose names alone are not clear."""
