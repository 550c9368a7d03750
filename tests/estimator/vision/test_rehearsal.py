"""The drawn frame is one in which the pad is found where it was drawn, so what a real look needs has been made."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from companion.settings.load import camera_model, load, pad_model
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.options import TrackerOptions
from estimator.vision.pad import Pad
from estimator.vision.tracker import TrackerConfig, TrackerMemory, drawn, drawn_lamps, rehearse, track
from tests.support.shipped import shipped_pad

AT = Stamp(MonoNs(0), MonoNs(0), 0.001, "sim")
SIM = load("sim")


@pytest.mark.parametrize("method", ["registration", "fused"])
def test_the_pad_is_found_where_it_was_drawn(method: str) -> None:
    camera, pad = camera_model(SIM), pad_model(SIM)
    found = rehearse(TrackerConfig(camera, pad, TrackerOptions(method=method, colours="simulator"))).selected  # type: ignore[arg-type]
    assert found is not None
    d = camera.T_body_cam.R.inv @ (found.d_body_pad_level - camera.T_body_cam.t)
    assert np.linalg.norm(found.d_body_pad_level) == pytest.approx(5.0 * pad.disc_radius_m, rel=0.1)
    assert np.isfinite(d).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "region",
    [
        {"shape": "disc", "radius_m": 0.3},
        {"shape": "ring", "inner_m": 0.2, "outer_m": 0.3},
        {"shape": "letter", "letter": "T", "length_m": 0.4, "width_m": 0.3, "stroke_m": 0.06},
    ],
    ids=lambda region: region["shape"],
)
def test_a_pad_of_one_region_is_looked_for(region: dict[str, Any]) -> None:
    pad = Pad.from_mapping({"name": "one", "paints": {"blue": [20, 40, 255]}, "regions": [{**region, "paint": "blue"}]})
    seen = rehearse(TrackerConfig(camera_model(SIM), pad, TrackerOptions(method="fused", colours="simulator")))
    assert seen.selected is None or np.isfinite(seen.selected.cov).all()


def test_every_paint_is_drawn_around_the_centre() -> None:
    camera, pad = camera_model(SIM), pad_model(SIM)
    px = drawn(camera, pad)
    assert px.shape == (camera.height, camera.width, 3)
    assert len(np.unique(px.reshape(-1, 3), axis=0)) > 4
    across = camera.fx / 5.0
    u, v = round(camera.cx), round(camera.cy)
    assert tuple(px[v, u]) == (235, 235, 235), "the H's bar"
    assert tuple(px[v, round(u + 1.3 * across)]) == (110, 105, 100), "the deck"


def test_the_lamps_of_a_lit_pad_are_found_where_they_were_drawn() -> None:
    camera, pad = camera_model(SIM), shipped_pad("lit")
    level = Attitude(AT, camera.T_body_cam.R.inv, 1e-4 * np.eye(3))
    found, _ = track(TrackerConfig(camera, pad), TrackerMemory(), Frame(AT, 0, drawn_lamps(camera, pad)), level)
    assert found.chosen == "lamps"
    assert found.selected is not None
    assert found.selected.confidence > 0.5
    assert np.linalg.norm(found.selected.d_body_pad_level) == pytest.approx(5.0 * pad.disc_radius_m, rel=0.1)


LOADED = """
import sys
from companion.settings.load import camera_model, load
from estimator.vision.tracker import rehearse
from estimator.vision.tracker import TrackerConfig
from tests.support.shipped import shipped_pad
rehearse(TrackerConfig(camera_model(load("sim")), shipped_pad(sys.argv[1])))
print("estimator.vision.lamp_sighting" in sys.modules)
"""


@pytest.mark.parametrize(("pad", "loaded"), [("lit", "True"), ("thesis", "False")])
def test_what_sees_lamps_is_loaded_before_the_first_frame_of_a_lit_pad_alone(pad: str, loaded: str) -> None:
    said = subprocess.run([sys.executable, "-c", LOADED, pad], capture_output=True, text=True, check=True)
    assert said.stdout.split() == [loaded]
