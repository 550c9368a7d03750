"""Measure how far a calibration's own word holds: `python -m benches.calibration [--sets N] [--images] [--fisheye] [--views V]`.

A camera looks at a printed board from views as a person takes them, set after set. The corners have a tenth of a pixel of noise
that half is common to a view's neighbours; with `--images` the board is rendered and its corners are found. The output is how
often the true distances lie within "Distances are right to" (95 % is claimed), how large that error is, and both for a flat set.
"""

import argparse
from collections import Counter

import numpy as np

from benches.options import described, parsed
from companion.tools.calibrate.board import Board, BoardView, Collection
from companion.tools.calibrate.guide import assess
from companion.tools.calibrate.solve import Solution, distance_errors, solve
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera.camera import Camera
from tests.support.calibration_images import Studio, lens

BENT = (-0.14, 0.07, 0.0009, -0.0006, 0.0)
BOARD = Board()


def true_camera(rng: np.random.Generator, fisheye: bool) -> Camera:
    """Return a camera of 480x320 px with a focal length and a distortion of its own."""
    f = float(rng.uniform(330.0, 420.0))
    if not fisheye:
        return lens(480, 320, f, tuple(np.array(BENT) * rng.uniform(0.3, 1.3)))
    k = np.array([-0.02, 0.004, -0.001, 0.0002]) * rng.uniform(0.3, 1.3)
    straight = lens(480, 320, 0.55 * f, (0.0,) * 5)
    return Camera(480, 320, straight.fx, straight.fy, straight.cx, straight.cy, k, straight.T_body_cam, lens="fisheye")


def poses(rng: np.random.Generator, camera: Camera, views: int, tilt_deg: float) -> list[tuple[Rotation, F64]]:
    """Return where a person holds the board: over all of the image, near and far, tilted up to some angle."""
    out, middle = [], np.array([BOARD.columns, BOARD.rows, 0.0]) * BOARD.square_m / 2
    for k in range(views):
        at = (np.array([0.5, 0.5]) if k % 5 == 0 else rng.uniform(0.18, 0.82, 2)) * (camera.width, camera.height)
        lean = tilt_deg * (rng.uniform(-1.0, 1.0, 2) if tilt_deg < 5.0 else rng.choice([-1.0, 1.0], 2) * rng.uniform(0.4, 1.0, 2))
        R = Rotation.from_rpy(*np.radians([*lean, rng.uniform(-90.0, 90.0)]))
        distance_m = rng.uniform(0.2, 0.4) * camera.fx / 350.0 * (1.8 if camera.lens == "fisheye" else 1.0)
        out.append((R, distance_m * np.append(camera.rays(at[None])[0], 1.0) - R.matrix @ middle))
    return out


def corners(rng: np.random.Generator, camera: Camera, held: list[tuple[Rotation, F64]]) -> list[BoardView]:
    """Return the views' corners with their errors, as far as they lie in the image."""
    out = []
    for k, (R, p) in enumerate(held):
        uv = camera.project(BOARD.corners_m @ R.matrix.T + p)
        rough = rng.normal(0.0, 0.05, (4, 3, 2)).repeat(3, axis=0).repeat(2, axis=1).reshape(-1, 2)[: len(uv)]
        seen = np.all((uv > 3.0) & (uv < np.array([camera.width, camera.height]) - 4.0), axis=1)
        if seen.sum() >= 8:
            out.append(BoardView(str(k), np.flatnonzero(seen), (uv + rng.normal(0.0, 0.087, uv.shape) + rough[: len(uv)])[seen]))
    return out


def solved(rng: np.random.Generator, args: argparse.Namespace, tilt_deg: float) -> tuple[Camera, Solution]:
    camera = true_camera(rng, args.fisheye)
    held = poses(rng, camera, args.views, tilt_deg)
    if not args.images:
        return camera, solve(corners(rng, camera, held), BOARD, (480, 320), lens="fisheye" if args.fisheye else "brown")
    studio, collection = Studio(camera, BOARD, int(rng.integers(1 << 30))), Collection(BOARD, moving=False)
    for k, (R, p) in enumerate(held):
        collection.add(str(k), studio.image(R, p))
    return camera, solve(collection.views, BOARD, (480, 320))


def main() -> None:
    parser = described(__doc__)
    parser.add_argument("--sets", type=int, default=40)
    parser.add_argument("--views", type=int, default=15)
    parser.add_argument("--images", action="store_true", help="render the board and find its corners")
    parser.add_argument("--fisheye", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    args = parsed(parser, "--sets 1 --views 6")
    for name, tilt_deg in (("tilted to 30 degrees", 30.0), ("flat, 0.6 degrees", 0.6)):
        rows, grades, models = [], [], []
        for k in range(args.sets):
            try:
                camera, found = solved(np.random.default_rng([args.seed, k, round(tilt_deg)]), args, tilt_deg)
            except BadInput:
                grades.append("refused")
                continue
            off = distance_errors(found.camera, camera)
            rows.append((found.distances_right_to, off[0], off[found.worst_place], np.abs(off).max()))
            grades.append(assess(found, (480, 320)).grade)
            models.append(found.model)
        if not rows:
            print(f"{name}: all refused")
            continue
        shown, middle, worst, most = 100.0 * np.abs(np.array(rows)).T
        within = [100.0 * np.mean(off <= shown) for off in (worst, middle, most)]
        print(f"{name}: right to {np.median(shown):.2f} % (median), {shown.max():.2f} at most")
        print(
            "  truth within it: {:.0f} % at the place that is said, {:.0f} % in the middle, {:.0f} % at all five".format(*within)
        )
        print(f"  off by {np.median(worst):.2f} % (median), {most.max():.2f} at most")
        print("  " + ", ".join(f"{value} {n}" for value, n in Counter(grades + models).items()), flush=True)


if __name__ == "__main__":
    main()
