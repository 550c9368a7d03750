"""The 3D scene of a recording: the pad's paints as triangles, the ellipsoid, and what a viewer finds after a seek."""

import math
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from companion.recording.scene import SIGMAS, error_ellipsoid, filled, fixed_scene
from companion.settings.load import shipped
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.time import MonoNs
from estimator.vision.regions import PaintedDisc, PaintedRing, outlines_of
from tests.fly import record_to
from tests.support.shipped import shipped_pad


def polygon_area(line):
    x, y = line.T
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


@pytest.mark.parametrize("name", shipped("pads"))
def test_triangles_fill_each_region_once(name: str) -> None:
    for region in shipped_pad(name).regions:
        points, faces = filled(region)
        a, b, c = (points[[face[k] for face in faces]] for k in range(3))
        areas = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        match region:
            case PaintedDisc():
                want = math.pi * region.radius_m**2
            case PaintedRing():
                want = math.pi * (region.outer_m**2 - region.inner_m**2)
            case _:
                want = sum(polygon_area(line) for line in outlines_of(region))
        assert areas.sum() == pytest.approx(want, rel=0.01)
        assert areas.min() > 0.0


def test_the_ellipsoid_has_the_estimates_covariance() -> None:
    R = Rotation.from_rpy(0.3, -0.2, 0.7)
    cov = np.eye(7)
    cov[:3, :3] = R.matrix @ np.diag([0.01, 0.04, 0.0025]) @ R.matrix.T
    state = RelativeState(MonoNs(1), "ekf", np.zeros(3), np.zeros(3), 0.0, cov, MonoNs(1), True)
    (sphere,) = error_ellipsoid(1, state).entities[0].spheres
    q = sphere.pose.orientation
    axes = Rotation.from_quat([q.w, q.x, q.y, q.z]).matrix
    half = np.array([sphere.size.x, sphere.size.y, sphere.size.z]) / 2.0 / SIGMAS
    np.testing.assert_allclose(axes @ np.diag(half**2) @ axes.T, cov[:3, :3], atol=1e-9)


def test_a_scene_without_a_pad_is_the_drone_alone() -> None:
    assert [entity.id for entity in fixed_scene(1, None).entities] == ["drone"]
    assert [entity.id for entity in fixed_scene(1, shipped_pad("h")).entities] == ["drone", "deck", "pad"]


def test_what_never_changes_is_found_within_a_second_of_any_seek(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    record_to(path, seconds=3.2)
    with path.open("rb") as stream:
        times: dict[str, list[int]] = {}
        for _, channel, message in make_reader(stream).iter_messages(topics=["/tf_static", "/scene", "/camera/calibration"]):
            times.setdefault(channel.topic, []).append(message.log_time)
    assert set(times) == {"/tf_static", "/scene", "/camera/calibration"}
    for found in times.values():
        assert len(found) >= 4
        assert max(np.diff(found)) <= 1.1e9
