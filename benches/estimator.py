"""Measure the filter in rough seas: `python -m benches.estimator [--runs 6] [--first 0] [--sea NAME] [--ideal]`.

Truth and sensors are those of tests/support/voyage_truth.py, which share nothing with the simulator: rough seas, a turning ship,
and every sensor error at once. Each row is the mean of its flights: position rms of the filter, and of the two other paths on the
same events; NEES over the filter's 7 degrees of freedom, the fraction of it inside the central 95 % of chi-square, that of
true values inside the 68 / 95 % bands of the forecast position and vertical speed, and the rms error of the forecast vertical
speed over the rms of the true one (a forecast of zero would give 1). The delay's columns are the rms error (estimated minus true)
and the same in estimated sigmas.
"""

import os
from collections.abc import Callable, Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from benches.options import described, parsed
from estimator.dead_reckoning import DeadReckoningPath
from estimator.median_mean import MedianMeanPath
from estimator.options import EstimatorOptions
from tests.support import voyage_truth
from tests.support.voyage_score import HORIZONS_S, Score, fly_voyage
from tests.support.voyage_truth import SEAS, VoyageScene

PATHS: dict[str, Callable[[], MedianMeanPath | DeadReckoningPath]] = {
    "median_mean": lambda: MedianMeanPath(),
    "dead_reckoning": lambda: DeadReckoningPath(EstimatorOptions()),
}


def row(name: str, scores: Sequence[Score]) -> str:
    cells = [
        f"{name:15s} {100 * np.mean([s.rms_m for s in scores]):5.1f} cm",
        " ".join(f"{100 * np.sqrt(np.mean(np.concatenate([s.others_m[path] for s in scores]) ** 2)):5.1f}" for path in PATHS),
        f"NEES {np.mean([np.mean(s.nees) for s in scores]) / 7:5.2f}",
        f"{100 * np.mean([s.inside for s in scores]):3.0f} % (worst {100 * min(s.inside for s in scores):3.0f})",
    ]
    for what in ("d_body_pad_level", "rise_m_s"):
        shares = []
        for h in HORIZONS_S:
            inside = [100 * np.mean([np.mean(s.bands[what, h, p]) for s in scores]) for p in (0.68, 0.95)]
            shares.append(f"{inside[0]:3.0f}/{inside[1]:3.0f}")
        cells.append(" ".join(shares))
    rise = np.concatenate([np.array(s.rise) for s in scores])
    ratio = np.sqrt(np.mean(rise[:, :3] ** 2, axis=0) / np.maximum(np.mean(rise[:, 3:] ** 2, axis=0), 1e-12))
    cells.append(" ".join(f"{x:.2f}" for x in ratio))
    delay = np.array([s.delay_error_s / s.delay_sigma_s for s in scores])
    cells.append(
        f"delay off {1e3 * np.sqrt(np.mean([s.delay_error_s**2 for s in scores])):4.1f} ms"
        f" = {np.sqrt(np.mean(delay**2)):.1f} sigma  moving {np.mean([s.moving for s in scores]):.2f}"
    )
    return " | ".join(cells)


def main() -> None:
    """Print a row for each sea."""
    parser = described(__doc__)
    parser.add_argument("--runs", type=int, default=6, help="number of flights in each sea")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--sea", choices=sorted(SEAS), action="append")
    parser.add_argument("--ideal", action="store_true", help="white sensor noise alone")
    args = parsed(parser, "--runs 1 --sea calm")
    head = ("sea", "position rms", ", ".join(PATHS), "NEES/7", "inside 95 %", "position bands 1, 2, 3 s 68/95")
    print(" | ".join((*head, "rise bands", "rise error over truth")))
    for sea in args.sea or [name for name in SEAS if name != "calm"]:
        scores = []
        for seed in range(args.first, args.first + args.runs):
            scene = VoyageScene(seed=seed, sea=sea, hidden_delay_s=0.03 if seed % 4 < 2 else -0.03)
            flown = voyage_truth.without_errors(scene) if args.ideal else scene
            scores.append(fly_voyage(flown, others={name: make() for name, make in PATHS.items()}))
        print(row(sea, scores), flush=True)


if __name__ == "__main__":
    main()
