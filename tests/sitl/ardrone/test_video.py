"""The encoder: what comes out is what an AR.Drone sends, and decodes frame by frame."""

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.geometry import Rotation
from sitl.emulators.ardrone.wire_pictures import IDR_EVERY, Encoder, front_view, split_annex_b

SPS, PPS, IDR, SLICE = 7, 8, 5, 1


def moving_image(n: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(7)
    coarse = (rng.random((45, 90, 3)) * 200).astype(np.uint8)
    return np.ascontiguousarray(cv2.resize(coarse, (720, 400), interpolation=cv2.INTER_CUBIC)[10:370, n : n + 640])


def test_every_access_unit_decodes_at_once_to_its_own_image() -> None:
    encoder = Encoder(640, 360, 30.0, 8000.0)
    decoder = av.CodecContext.create("h264", "r")
    assert encoder.coded_size == (640, 368)
    for n in range(2 * IDR_EVERY + 2):
        px = moving_image(2 * n)
        unit = encoder.encode(px)
        kinds = [kind for kind, _ in split_annex_b(unit.data)]
        if n % IDR_EVERY == 0:
            assert unit.idr
            assert kinds == [SPS, PPS, IDR]
            sps, pps = (part for _, part in split_annex_b(unit.data)[:2])
            assert (unit.sps_size, unit.pps_size) == (len(sps), len(pps))
            assert sps[4:6] == bytes([0x67, 66]), "baseline profile"
        else:
            assert not unit.idr
            assert kinds == [SLICE]
            assert unit.sps_size == unit.pps_size == 0
        (frame,) = decoder.decode(av.Packet(unit.data))
        decoded = frame.to_ndarray(format="bgr24")
        assert decoded.shape == (360, 640, 3)
        assert np.abs(decoded.astype(int) - px).mean() < 6.0
        assert unit.data.startswith(b"\0\0\0\1")


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.2, 0.0), (0.0, 0.15), (-0.1, -0.1)])
def test_front_view_puts_the_horizon_where_a_pinhole_would(roll: float, pitch: float) -> None:
    px = front_view(Rotation.from_rpy(roll, pitch, 1.0)).astype(int)
    sky = px.sum(axis=2) > 450
    f = 640 / 2 / 0.81
    for u in (40, 320, 600):
        x = (u - 319.5) / f
        # down component of the ray through (u, v): -sin(p) + cos(p) sin(r) x + cos(p) cos(r) y = 0
        y = (np.tan(pitch) - np.sin(roll) * x) / np.cos(roll)
        v = 179.5 + f * y
        assert abs(int(sky[:, u].sum()) - v) < 2.0
