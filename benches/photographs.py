"""Measure registration on the photographs of the real pad against labels by hand: `python -m benches.photographs`.

The truth of each photograph is the pose by which the labels of ring and H both fit best: thirteen corners and the ring's centre
and inner radius, clicked by hand, with errors whose sizes are estimated from what the fits leave. Where the ring's labels lie
beside the H's is the same in all photographs and is taken out, and so is the same of the radius. The truth has a covariance of
its own; what registration is off beyond it comes from a deconvolution of both, by the distribution that makes the differences
likeliest. Registration starts 4 % too far away and 3 degrees turned, without an attitude.
"""

import csv
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from estimator.contracts.geometry import F64, Rotation  # noqa: E402
from estimator.vision.camera import Camera  # noqa: E402
from estimator.vision.pad import Pad  # noqa: E402
from estimator.vision.pad_pose import PadPose  # noqa: E402
from estimator.vision.register.registration import RegistrationOptions, register  # noqa: E402
from tests.support.pad_scenes import DATA, load_camera, load_pad  # noqa: E402

FOLDER = DATA / "pad_photos"
ROUNDS = 6
CORNERS, STATES = 13, 6
MAD = 1.4826
"""A normal number's standard deviation over its median absolute deviation."""


@dataclass(frozen=True, eq=False)
class Labels:
    """Clicked points of one photograph."""

    corners_px: F64
    """(13, 2): the corners of the H and the arrow's tip."""
    circle_px: F64
    """(3,) centre and radius of the ring's inner edge."""
    start: F64
    """A pose near the truth, (6,): place in m and rotation vector."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Label errors that are the same in all photographs, one sigma."""

    ring_px: F64
    """(3,) of the ring's centre against the H, and of its radius."""
    sigma_px: F64
    """(3,) of a corner, of the ring's centre (along one axis), and of its radius."""


def table(name: str) -> dict[str, F64]:
    with (FOLDER / name).open() as file:
        rows = list(csv.reader(file))[1:]
    return {row[0]: np.array([float(cell) for cell in row[1:]]) for row in rows}


def read_labels() -> dict[str, Labels]:
    corners, circles, poses = table("corner_labels.csv"), table("circle_labels.csv"), table("pose.csv")
    return {name: Labels(corners[name].reshape(CORNERS, 2), circles[name], poses[name][:6]) for name in sorted(poses)}


def off(x: F64, labels: Labels, camera: Camera, pad: Pad) -> F64:
    """Return how far the labels lie from a pose's image, (29,) px: corners, ring's centre, ring's radius."""
    pose = PadPose(Rotation.from_rotvec(x[3:]), x[:3])
    # The labels go round the H the other way.
    marks = np.r_[pad.markings.h_corners()[::-1], [[pad.markings.arrow_tip_m, 0.0, 0.0]]]
    ring = camera.project(pose.points(pad.circle(pad.markings.ring_inner_m, 180)))
    centre = ring.mean(axis=0)
    circle = np.append(centre, np.hypot(*(ring - centre).T).mean())
    return np.append((labels.corners_px - camera.project(pose.points(marks))).ravel(), labels.circle_px - circle)


def solved(labels: Labels, start: F64, errors: Errors, camera: Camera, pad: Pad) -> tuple[F64, F64]:
    """Return the pose of the labels, (6,), and its covariance, (6, 6), rotation vectors included."""
    weight = 1.0 / np.r_[np.full(2 * CORNERS, errors.sigma_px[0]), np.full(2, errors.sigma_px[1]), errors.sigma_px[2]]
    common = np.r_[np.zeros(2 * CORNERS), errors.ring_px]
    fit = least_squares(lambda x: weight * (off(x, labels, camera, pad) - common), start, loss="huber", f_scale=1.5, x_scale=0.01)
    return fit.x, np.linalg.inv(fit.jac.T @ fit.jac)


def truths(labels: dict[str, Labels], camera: Camera, pad: Pad) -> tuple[dict[str, tuple[F64, F64]], Errors]:
    """Return the poses of the labels with their covariances, and what the labels are off."""
    errors, poses = Errors(np.zeros(3), np.full(3, 0.6)), {name: (each.start, np.eye(STATES)) for name, each in labels.items()}
    # Of 29 numbers a pose takes six.
    free = math.sqrt((2 * CORNERS + 3 - STATES) / (2 * CORNERS + 3))
    for _ in range(ROUNDS):
        poses = {name: solved(each, poses[name][0], errors, camera, pad) for name, each in labels.items()}
        left = np.array([off(poses[name][0], each, camera, pad) for name, each in labels.items()])
        corners = left[:, : 2 * CORNERS].reshape(-1, CORNERS, 2)
        aside = np.median(corners, axis=1)
        ring = np.median(np.c_[left[:, -3:-1] - aside, left[:, -1]], axis=0)
        spread = [corners - aside[:, None], left[:, -3:-1] - aside - ring[:2], left[:, -1] - ring[2]]
        errors = Errors(ring, np.array([MAD * np.median(np.abs(each)) / free for each in spread]))
    return poses, errors


def beyond(differences: F64, sigmas: F64) -> F64:
    """Return median and 95th percentile of an error, (2,), to which errors of these sigmas were added.

    Source: Laird, Nonparametric maximum likelihood estimation of a mixing distribution, JASA 73, 1978; here symmetric.
    """
    most = 1.5 * float(np.abs(differences).max())
    places = np.linspace(-most, most, 601)
    likely = np.exp(-0.5 * ((differences[:, None] - places) / sigmas[:, None]) ** 2)
    share = np.full(len(places), 1.0 / len(places))
    for _ in range(2000):
        of = likely * share
        share = (of / of.sum(axis=1, keepdims=True)).mean(axis=0)
        share = 0.5 * (share + share[::-1])
    order = np.argsort(np.abs(places))
    below = np.cumsum(share[order])
    return np.abs(places)[order][np.searchsorted(below, (0.5, 0.95))]


def main() -> None:
    if not FOLDER.exists():
        print("the photographs of the pad are not on this machine")
        return
    cv2.setNumThreads(1)
    camera, pad, labels = load_camera("photos"), load_pad("printed"), read_labels()
    poses, errors = truths(labels, camera, pad)
    print("labels off at one sigma, px: corner {:.2f}, ring's centre {:.2f}, radius {:.2f}".format(*errors.sigma_px))
    rows = []
    for name in labels:
        x, cov = poses[name]
        px = cv2.imread(str(FOLDER / "images" / name))
        assert px is not None
        start = PadPose(Rotation.from_rotvec(x[3:]) @ Rotation.from_rpy(0.0, 0.0, 0.06), x[:3] * 1.04)
        found = register(np.asarray(px, np.uint8), camera, pad, start, None, RegistrationOptions())
        if found is None or found.inliers < 0.5:
            continue
        r = float(np.linalg.norm(x[:3]))
        along = x[:3] / r
        own, ours = (math.sqrt(along @ c[:3, :3] @ along) / r for c in (cov, found.cov))
        rows.append((r, float(along @ (found.pose.t_cam_pad - x[:3])) / r, own, ours))
    v = np.array(rows)
    r, e, own, ours = v.T
    z = e / np.hypot(own, ours)
    print(f"registered: {len(v)} of {len(labels)}")
    median, most = 100 * np.percentile(np.abs(e), (50, 95))
    print(f"range off, % of range: median {median:.2f}, 95th percentile {most:.2f}, mean {100 * e.mean():+.2f}")
    print(f"sigma of the range, %, median: labels {100 * np.median(own):.2f}, said of registration {100 * np.median(ours):.3f}")
    print("range off beyond the labels' own error, %: median {:.2f}, 95th percentile {:.2f}".format(*100 * beyond(e, own)))
    print(f"difference over both sigmas: median of squares {np.median(z * z):.2f} (0.45), mean {np.mean(z * z):.2f} (1), "
          f"within 2: {100 * np.mean(np.abs(z) < 2):.0f} % (95)")  # fmt: skip
    for low, high in ((0.0, 1.0), (1.0, 1.6), (1.6, 2.5), (2.5, 5.0)):
        k = (r > low) & (r <= high)
        rms = [100 * math.sqrt(float((a[k] ** 2).mean())) for a in (e, own, ours)]
        print("{:g} to {:g} m, {} photographs, rms in %: off {:.2f}, labels {:.2f}, said {:.3f}".format(low, high, k.sum(), *rms))


if __name__ == "__main__":
    main()
