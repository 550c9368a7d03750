"""Set ArUco, AprilTag, the thesis' methods and ours side by side: `python -m benches.peers [--frames N]`.

One run of `benches.vision`'s frames. A cell has the median distance between the measured and the true place of the pad and the
median processor time of a whole look that knows nothing of the pad's place; below nine finds in ten frames it says how many. The
thesis' cell has the best of its three methods, which share one time. The table is README's.
"""

import argparse
import os
import sys

import cv2
import numpy as np

from benches.vision import APRILTAG, ARUCO, LOOK, THESIS, Tally, at_height

HEIGHTS_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
COLUMNS = {"ArUco (OpenCV, sub-pixel)": (ARUCO,), "AprilTag": (APRILTAG,), "the thesis' methods": THESIS, "Decklander": (LOOK,)}


def cell(tallies: list[Tally]) -> str:
    """Return error, time and, if few, finds of the tally with the least error."""
    often = [tally for tally in tallies if 2 * len(tally.d_m) >= tally.tried]
    found = [(float(np.median(np.linalg.norm(tally.d_m, axis=1))), tally) for tally in often]
    ms = f"{np.median(tallies[0].ms):.1f} ms"
    if not found:
        return f"not found, {ms}"
    error_m, best = min(found, key=lambda pair: pair[0])
    few = "" if 10 * len(best.d_m) >= 9 * best.tried else f", {100 * len(best.d_m) // best.tried} % found"
    return f"{1e3 * error_m:{'.0f' if error_m > 0.1 else '.2g'}} mm, {ms}{few}"


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=20, help="frames at each height")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    print("| height | " + " | ".join(COLUMNS) + " |\n|" + "---|" * (1 + len(COLUMNS)))
    for height_m in HEIGHTS_M:
        tallies, _, _ = at_height(height_m, args.frames, seed=1)
        cells = (cell([tallies[name] for name in names]) for names in COLUMNS.values())
        print(f"| {height_m:g} m | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)
