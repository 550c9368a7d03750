"""Fit the verification on rendered frames: `python -m benches.verification_fit [--frames N] [--workers K] [--keep FILE]`.

Half of the frames show a pad (of two kinds, 0.2 to 30 m, all conditions of `pad_scenes`), half show none. Every candidate of
every stage is an example; it is right if its pose keeps the verification's claim. The fit is logistic regression with a small
ridge; false candidates with a high score count several times, since a false pad costs more than a missed one. The output is the
coefficients in the form of estimator/vision/detect/verification.py, and the result on frames that were not used for the fit. With
`--registered` the examples are the registrations of the best candidates, on other frames, and the coefficients belong to
estimator/vision/detect/verification.py.
"""

import math
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benches.options import described, mapping, parsed
from benches.real import STAMP
from benches.search import SIGMA_ATTITUDE_RAD, SIGMA_DECK_RAD
from estimator.contracts.samples import Attitude
from estimator.vision.camera.pose import Orientation
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.verification import FEATURES, FITTED
from estimator.vision.pad.pad import Pad
from estimator.vision.register.registration import RegistrationOptions, look
from tests.support.deck_images import keeps_claim
from tests.support.pad_scenes import CONDITIONS, PadScene, acquire, empty_scene, load_camera, load_pad, pad_scene

F64 = NDArray[np.float64]
_CHUNK = 50
_REGISTERED_FROM = 10_000
"""First chunk of the frames of the second model; the first model was not fitted to them."""
_RIDGE = 1e-3
_FALSE_FROM, _FALSE_WEIGHT = 0.25, 8.0
_FALSE_FROM_REGISTERED, _FALSE_WEIGHT_REGISTERED = 0.02, 50.0
"""Probability from which a false candidate counts more, and its weight. For registrations a weight of fifty puts one right one in
seventy below 0.5, and a green disc with a ring and no H is not called a pad."""
_ONE_WAY = (
    "white", "disc_place", "template_score", "inliers", "disc_off", "ring_off", "h_off", "ring_unseen", "h_unseen", "rms",
    "dense_disc", "dense_orange",
)  # fmt: skip
"""Features whose sign a fit must not reverse."""


def scenes(seed: int, frames: int = _CHUNK) -> Iterator[tuple[int, bool, Pad, PadScene]]:
    """Yield the frame's number, whether it has a pad, the pad, and the scene, for one chunk of frames."""
    rng = np.random.default_rng([seed, 0x51DE])
    camera, pads = load_camera("sim"), [load_pad("thesis"), load_pad("printed")]
    for i in range(frames):
        height = float(np.exp(rng.uniform(math.log(0.2), math.log(30.0))))
        with_pad, pad = i % 2 == 0, pads[i // 2 % 2]
        scene = pad_scene(rng, camera, pad, height, str(rng.choice(CONDITIONS))) if with_pad else empty_scene(rng, camera, height)
        yield seed * _CHUNK + i, with_pad, pad, scene


def examples(seed: int, frames: int = _CHUNK) -> F64:
    """Return frame, 1 for a right candidate, 1 for a frame with a pad, and features, (n, 3 + len(FEATURES)), of one chunk."""
    cv2.setNumThreads(1)
    camera, rows = load_camera("sim"), []
    for frame, with_pad, pad, scene in scenes(seed, frames):
        for c in acquire(scene.px, camera, pad, scene.R_level_body, sure=2.0)[:4]:
            right = scene.truth is not None and keeps_claim(c.pose, scene.truth, camera, pad, c.yaw_ambiguous)
            rows.append([frame, float(right), float(with_pad), *c.aligned.features])
    return np.array(rows).reshape(-1, 3 + len(FEATURES))


def registered_examples(seed: int, frames: int = _CHUNK) -> F64:
    """Return the examples of registration, (n, 3 + len(FITTED)), in the form of `examples`."""
    cv2.setNumThreads(1)
    camera, rows = load_camera("sim"), []
    for frame, with_pad, pad, scene in scenes(seed, frames):
        R = scene.R_level_body
        attitude = None if R is None else Attitude(STAMP, R, np.eye(3) * SIGMA_ATTITUDE_RAD**2)
        orientation = Orientation.of(attitude, SIGMA_DECK_RAD)
        for c in acquire(scene.px, camera, pad, scene.R_level_body)[:2]:
            found = look(FrameView(Pyramid(scene.px), camera, pad), c.pose, orientation, RegistrationOptions(coarse=False))
            if found is None:
                continue
            right = scene.truth is not None and keeps_claim(found.pose, scene.truth, camera, pad, found.yaw_ambiguous)
            rows.append([frame, float(right), float(with_pad), *found.evidence[: len(FITTED)]])
    return np.array(rows).reshape(-1, 3 + len(FITTED))


def fit(x: F64, y: F64, weight: F64) -> F64:
    """Fit by Newton's method on the penalised likelihood."""
    b = np.zeros(x.shape[1])
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-np.clip(x @ b, -30, 30)))
        g = x.T @ (weight * (y - p)) - _RIDGE * len(x) * b * (np.arange(len(b)) > 0)
        Hm = (x * (weight * p * (1 - p))[:, None]).T @ x + np.diag(_RIDGE * len(x) * (np.arange(len(b)) > 0) + 1e-9)
        step = np.linalg.solve(Hm, g)
        b += step
        if np.abs(step).max() < 1e-8:
            break
    return b


def fit_one_way(x: F64, y: F64, weight: F64, one_way: NDArray[np.bool_]) -> F64:
    """Fit with the signs of some features fixed, because there are few examples of them.

    An H that is not whiter than the disc is rare among pads and among false candidates, and an unseen H is most often under
    glare.
    """
    on = np.ones(x.shape[1], np.bool_)
    while True:
        b = np.zeros(x.shape[1])
        b[on] = fit(x[:, on], y, weight)
        wrong = on & one_way & (b < 0.0)
        if not wrong.any():
            return b
        on &= ~wrong


def main() -> None:
    parser = described(__doc__)
    parser.add_argument("--frames", type=int, default=6000)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--registered", action="store_true")
    parser.add_argument("--keep", type=Path, help="write the examples here, or read them if the file is there")
    args = parsed(parser, "--frames 24")
    names, work, first = (FITTED, registered_examples, _REGISTERED_FROM) if args.registered else (FEATURES, examples, 0)
    if args.keep is not None and args.keep.exists():
        data = np.load(args.keep)
    else:
        with mapping(args.workers) as mapped:
            parts = []
            each = min(_CHUNK, args.frames // 2)
            for i, part in enumerate(mapped(partial(work, frames=each), range(first, first + args.frames // each))):
                parts.append(part)
                print(f"\r{(i + 1) * each} frames", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)
        data = np.concatenate(parts)
        if args.keep is not None:
            np.save(args.keep, data)
    frame, y, with_pad, x = data[:, 0].astype(int), data[:, 1], data[:, 2], data[:, 3:]
    train = (frame // _CHUNK) % 4 != 0
    weight = np.ones(len(x))
    one_way = np.array([name in _ONE_WAY for name in names])
    low, times = (_FALSE_FROM_REGISTERED, _FALSE_WEIGHT_REGISTERED) if args.registered else (_FALSE_FROM, _FALSE_WEIGHT)
    b = fit_one_way(x[train], y[train], weight[train], one_way)
    for _ in range(4 if args.registered else 3):
        p = 1.0 / (1.0 + np.exp(-x @ b))
        weight = np.where((y == 0) & (with_pad == 0) & (p > low), times, 1.0)
        b = fit_one_way(x[train], y[train], weight[train], one_way)
    print("_COEFFICIENTS = np.array([" + ", ".join(f"{v:.3f}" for v in b) + "])")
    for name, v, s in zip(names, b, x.std(axis=0), strict=True):
        print(f"  {name:16s} {v:8.3f}   times its spread {v * s:7.2f}")
    p = 1.0 / (1.0 + np.exp(-x @ b))
    test = ~train
    print(f"examples {len(x)}, right {int(y.sum())}; held out: {int(test.sum())}")
    print("called      n   right")
    for low, high in ((0.0, 0.1), (0.1, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.85), (0.85, 0.95), (0.95, 1.001)):
        k = test & (p >= low) & (p < high)
        if k.any():
            print(f"{low:.2f}-{min(high, 1):.2f} {int(k.sum()):6d}  {y[k].mean():.3f}   (mean called {p[k].mean():.3f})")
    worst = np.argsort(-p * (with_pad == 0))[:8]
    print("highest scores without a pad:", ", ".join(f"{p[i]:.2f} (frame {frame[i]})" for i in worst))


if __name__ == "__main__":
    main()
