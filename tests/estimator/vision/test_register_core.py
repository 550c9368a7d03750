"""The native core registers as the numpy oracle does."""

from __future__ import annotations

import math

import cv2
import numpy as np

from estimator.contracts.geometry import Rotation
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import Registration, RegistrationOptions, register
from tests.estimator.vision.oracle.registration import register as register_in_numpy
from tests.support.pad_images import sim_camera
from tests.support.pad_scenes import CONDITIONS, load_camera, load_pad, pad_scene

TRACK = RegistrationOptions(coarse=False)
SETTLED_PX = 0.05
"""The last step of a fit that converged. One that wanders is stopped after so many steps, and rounding decides where."""


def both(
    seed: int, height_m: float, condition: str, blur_px: float, lens: str, pad_name: str
) -> tuple[Registration | None, Registration | None]:
    rng = np.random.default_rng([31, seed])
    camera = load_camera("sim") if lens == "straight" else sim_camera(distortion=(-0.25, 0.08, 0.002, -0.001, 0.0))
    pad = load_pad(pad_name)
    scene = pad_scene(rng, camera, pad, height_m, condition)
    assert scene.truth is not None
    px = scene.px if blur_px < 0.2 else np.asarray(cv2.GaussianBlur(scene.px, (0, 0), blur_px), np.uint8)
    t = scene.truth.t_cam_pad
    off = rng.normal(0.0, 0.4, 3) * (t[2] / camera.fx)
    # Nearer or farther by so much that the disc's edge is off by as many pixels.
    off[2] *= t[2] / min(pad.disc_radius_m, 0.6 * t[2])
    turn = Rotation.from_rpy(0.0, 0.0, float(rng.normal(0.0, 0.01)) + math.pi * (seed % 5 == 0))
    start = PadPose(scene.truth.R_cam_pad @ turn, t + off)
    prior = Orientation.of(None)
    if scene.R_level_body is not None:
        prior = Orientation(*scene.R_level_body.rpy_rad[:2], np.eye(2) * 0.017**2, 0.035, True)
    own = prior if seed % 7 else None
    return register(px, camera, pad, start, own, TRACK), register_in_numpy(px, camera, pad, start, own, TRACK)


def test_registrations_are_the_oracles() -> None:
    """Both stop at a step below a bound and leave pixels out by decisions: where one is taken otherwise, they end apart."""
    rng, apart, spread = np.random.default_rng(30), [], []
    for k in range(36):
        height_m = math.exp(rng.uniform(math.log(0.3), math.log(20.0)))
        lens, pad_name = ("straight", "bent")[k % 2], ("thesis", "printed")[k // 2 % 2]
        seed, blur_px = int(rng.integers(10_000)), float(rng.uniform(0.0, 1.5))
        ours, oracle = both(seed, height_m, CONDITIONS[k % len(CONDITIONS)], blur_px, lens, pad_name)
        assert (ours is None) == (oracle is None)
        if ours is None or oracle is None or oracle.last_step_px > SETTLED_PX:
            continue
        e = np.concatenate([
            ours.pose.t_cam_pad - oracle.pose.t_cam_pad, (ours.pose.R_cam_pad @ oracle.pose.R_cam_pad.inv).rotvec_rad
        ])  # fmt: skip
        sigma = np.sqrt(np.diag(oracle.cov))
        apart.append(np.abs(e / sigma).max())
        spread.append(np.abs((ours.cov - oracle.cov) / np.outer(sigma, sigma)).max())
        assert abs(ours.inliers - oracle.inliers) < 0.01
        assert (ours.dense, ours.yaw_ambiguous) == (oracle.dense, oracle.yaw_ambiguous)
        for kind, evidence in oracle.edges.items():
            assert abs(ours.edges[kind].inliers - evidence.inliers) < 0.01
            assert abs(ours.edges[kind].in_view - evidence.in_view) < 1e-6
            assert abs(ours.edges[kind].snr - evidence.snr) < 0.05 * (1.0 + evidence.snr)
    assert len(apart) > 15
    assert np.median(apart) < 0.002
    assert np.median(spread) < 0.0005
    assert np.sort(apart)[-3] < 0.05
    assert max(apart) < 1.0
