"""Registration on photographs of the printed pad, against hand labels."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.pad_pose import PadPose
from estimator.vision.register.registration import RegistrationOptions, register
from tests.support.shipped import shipped_camera, shipped_pad

DATA = Path(__file__).parents[3] / "../shared/data/pad_photos"


def table(name: str) -> dict[str, F64]:
    with (DATA / name).open() as file:
        rows = list(csv.reader(file))[1:]
    return {row[0]: np.array([float(cell) for cell in row[1:]]) for row in rows}


@pytest.mark.skipif(not DATA.exists(), reason="the photographs of the pad are not on this machine")
def test_the_corners_of_the_h() -> None:
    camera, pad = shipped_camera("photos"), shipped_pad("printed")
    labels, poses = table("corner_labels.csv"), table("pose.csv")
    found, median, aside, headings = 0, [], [], 0
    names = sorted(poses)[::2]
    for name in names:
        px = cv2.imread(str(DATA / "images" / name))
        assert px is not None
        p = poses[name]
        # From a start that is wrong by several pixels in place, size and heading.
        start = PadPose(Rotation.from_rotvec(p[3:6]) @ Rotation.from_rpy(0.0, 0.0, 0.06), p[:3] * 1.04)
        result = register(px.astype(np.uint8), camera, pad, start, None, RegistrationOptions())
        if result is None or result.inliers < 0.5:
            continue
        found += 1
        headings += not result.yaw_ambiguous
        # The labels go round the H the other way.
        off = camera.project(result.pose.points(pad.markings.h_corners())) - labels[name][:24].reshape(12, 2)[::-1]
        median.append(float(np.median(np.hypot(*off.T))))
        aside.append(np.median(off, axis=0))
    assert found >= 0.98 * len(names)
    assert headings >= 0.95 * len(names)
    assert float(np.median(median)) < 1.0
    # Half of that is the labels' own: they sit to the right of and below the paint's edges, alike in all photographs.
    assert np.median(aside, axis=0) == pytest.approx([-0.42, -0.66], abs=0.25)
