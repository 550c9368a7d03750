"""Lettering on lettering, and slanted sides: each edge pixel of the simulated camera shows each paint as much as it covers."""

import numpy as np
import pytest

from estimator.vision.pad import Pad
from estimator.vision.regions import covers, part_of
from sitl.camera.projection import lens_of
from sitl.camera.render.pad import PadPainter, Stroke
from sitl.core.abi import DL_PAD_PAINTS
from sitl.core.library import SIM
from tests.sitl.images import PLAIN, pad_pose, shot
from tests.support.shipped import shipped_pad

FINE = 24
"""Rays along a pixel's side that the coverage is counted with."""
PAINTS = SIM.names("dl_sim_paint")
_PART = {
    "rim": "DL_PAD_RIM",
    "disc": "DL_PAD_DISC",
    "ring": "DL_PAD_ORANGE",
    "letter": "DL_PAD_WHITE",
    "triangle": "DL_PAD_WHITE",
}
SLANTED = Pad.from_mapping({
    "name": "slanted", "paints": {"grey": [60, 60, 60], "white": [240, 240, 240]},
    "regions": [
        {"shape": "disc", "paint": "grey", "radius_m": 0.6},
        {"shape": "stroke", "paint": "white", "from_m": [-0.4, -0.2], "to_m": [0.2, 0.3], "width_m": 0.06},
        {"shape": "polygon", "paint": "white", "points_m": [[0.0, -0.1], [0.4, -0.3], [0.2, -0.1], [0.45, 0.1]]},
    ],
})  # fmt: skip


def painted(pad: Pad, at: np.ndarray) -> np.ndarray:
    """Return the index in `PAINTS` of the topmost paint at points (N, 2) m."""
    out = np.zeros(len(at), int)
    for region in pad.regions:
        upper = region in pad.markings.upper
        out[covers(region, at)] = PAINTS["DL_PAD_UPPER" if upper else _PART[part_of(region)]]
    return out


@pytest.mark.parametrize("pad", [shipped_pad("hospital"), shipped_pad("faa_triangle"), SLANTED], ids=lambda p: p.name)
@pytest.mark.parametrize("height_m", [0.8, 3.0, 12.0])
def test_each_paint_has_its_share_of_a_pixel(pad: Pad, height_m: float) -> None:
    exposure = shot(height_m, (0.05, -0.03), (0.05, -0.04, 0.4))
    pose = pad_pose(exposure, PLAIN)
    R, t = pose.R_cam_pad.matrix, pose.t_cam_pad
    image = PadPainter(lens_of(PLAIN), pad).place([Stroke.still((R, t))])
    assert image is not None
    some = np.random.default_rng(3).choice(len(image.edges), min(150, len(image.edges)), replace=False)
    v, u = np.divmod(image.edges[some], PLAIN.width)
    fine = (np.arange(FINE) + 0.5) / FINE - 0.5
    du, dv = (g.ravel() for g in np.meshgrid(fine, fine))
    rays = np.stack([
        (u[:, None] + du - PLAIN.cx) / PLAIN.fx, (v[:, None] + dv - PLAIN.cy) / PLAIN.fy, np.ones((len(some), FINE * FINE)),
    ], axis=2) @ R  # fmt: skip
    d = R.T @ t
    at = rays[..., :2] * (d[2] / rays[..., 2])[..., None] - d[:2]
    kinds = painted(pad, at.reshape(-1, 2)).reshape(len(some), -1)
    counted = np.stack([(kinds == k).mean(axis=1) for k in range(DL_PAD_PAINTS)], axis=1)
    off = np.abs(image.shares[some] - counted)
    assert off.max() < 0.09, "corners are cut into products of their sides"
    assert off.mean() < 0.004
    assert np.abs((image.shares[some] - counted).mean(axis=0)).max() < 0.004
