"""Measure the effect of single faults on the filter: its error, the error that it claims, and its recovery.

    python -m benches.estimator_faults [--seed 0] [--fault NAME]

Each is a rough flight over waves (tests/support/voyage_truth.py) with the fault at 12 s. Columns: largest error of the position
from there on and largest error over its standard deviation (of the 3-vector); the same from one second after the fault's end;
seconds after the fault's end until the error stays below 3 sigma; seconds in which it was beyond 4 sigma and called consistent.
"""

import argparse
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import replace

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from tests.support.voyage_faults import BEGIN_S, FAULTS, SCENE, suffered


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description="Single faults and the filter.")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--fault", choices=sorted(FAULTS), action="append")
    chosen = parser.parse_args(arguments)
    print("fault | worst error, sigma | from 1 s after: error, sigma, heading | itself again after | wrong and called consistent")
    for name in chosen.fault or FAULTS:
        s, end = suffered(name, replace(SCENE, seed=chosen.seed))
        t, error, sigma = np.array(s.t), np.array(s.error_m), np.array(s.sigma_m)
        ratio, after, late = error / sigma, t >= BEGIN_S, t >= end + 1.0
        wrong = t[after & (ratio > 3.0)]
        again = max(0.0, float(wrong[-1]) - end + 0.1) if wrong.size else 0.0
        claimed = 0.1 * int(np.sum(after & (ratio > 4.0) & np.array(s.consistent)))
        print(
            f"{name:22s} | {100 * error[after].max():6.1f} cm {ratio[after].max():5.1f} | {100 * error[late].max():5.1f} cm "
            f"{ratio[late].max():4.1f} {math.degrees(np.abs(np.array(s.yaw_error))[late].max()):5.1f} deg | {again:4.1f} s | "
            f"{claimed:.1f} s",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
