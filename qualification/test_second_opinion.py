"""The learned second opinion: what it says of rendered candidates, that it only lowers, and what it refuses."""

import math
import pickle
from pathlib import Path

import numpy as np
import pytest

from companion.tools.second_opinion import SHIPPED_NETWORK, second_opinion
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import RelativeState
from estimator.contracts.samples import Frame
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.detect.verification import confidence as confidence_of
from estimator.vision.learned.second_opinion import CHANNELS, SIDE, inputs, patch_of
from estimator.vision.options import TrackerOptions
from estimator.vision.track.config import SecondOpinion, TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from tests.support.pad_images import STAMP, PadPlacement, image
from tests.support.pad_scenes import pad_scene
from tests.support.shipped import shipped_camera, shipped_pad

CAMERA = shipped_camera("sim")
PLACE = PadPlacement((0.2, -0.1, 2.0), math.radians(30.0))


class Always(SecondOpinion):
    """A second opinion that says the same of everything."""

    def __init__(self, said: float) -> None:
        self.said, self.asked = said, 0

    def log_odds(self, *_: object) -> float:
        self.asked += 1
        return self.said


@pytest.fixture(scope="module")
def network() -> SecondOpinion:
    return second_opinion("", "vision.learned_file")


def pose_of(place: PadPlacement) -> PadPose:
    T = place.T_cam_pad(CAMERA)
    return PadPose(T.R, T.t)


def belief_at(place: PadPlacement) -> RelativeState:
    at, cov = STAMP.measured_at, np.diag([1e-4] * 3 + [0.01] * 3 + [1e-4])
    return RelativeState(at, "ekf", np.array(place.d_body_pad_level), np.zeros(3), place.yaw_rad, cov, at, True)


def said(network: SecondOpinion, name: str, shown: str, turned_rad: float = 0.0) -> float:
    """Return the network's confidence that the pad `name` is where the pad `shown` was rendered, turned by an angle."""
    scene = pad_scene(np.random.default_rng(4), CAMERA, shipped_pad(shown), 2.0, "plain", 0.1)
    log_odds = network.log_odds(Pyramid(scene.px), CAMERA, shipped_pad(name), scene.truth.turned(turned_rad))
    assert log_odds is not None
    return confidence_of(log_odds)


@pytest.mark.parametrize(
    ("name", "other", "answers"),
    [
        ("thesis", "x", (0.970, 0.007, 0.000)),
        ("printed", "x", (0.938, 0.006, 0.000)),
        ("icao", "x", (0.988, 0.006, 0.000)),
        ("helideck", "x", (0.962, 0.001, 0.000)),
        ("h", "x", (0.862, 0.003, 0.007)),
        ("x", "thesis", (0.987, 0.010, 0.005)),
        ("apriltag_nest", "x", (0.996, 0.008, 0.034)),
        ("aruco_board", "x", (0.995, 0.020, 0.005)),
    ],
)
def test_the_shipped_network_gives_the_recorded_answers(network, name, other, answers):
    """Each shipped pad where it is, where another one is, and turned by an eighth."""
    given = said(network, name, name), said(network, name, other), said(network, name, name, math.radians(45.0))
    assert given == pytest.approx(answers, abs=0.03)


def test_the_patch_is_the_drawing_where_the_pad_is() -> None:
    """Row by x, column by y, blue first: the frame in the pad's plane correlates with the drawing in any light."""
    pad = shipped_pad("thesis")
    px = image(PLACE, CAMERA, pad, blur_px=0.6, gain=(0.7, 0.5, 0.6)).px
    patch = patch_of(Pyramid(px), CAMERA, pad, pose_of(PLACE))
    x = inputs(patch)
    assert x.shape == (CHANNELS, SIDE, SIDE)
    known = patch.drawn[:, :, 3] > 250
    for channel in range(3):
        assert np.corrcoef(x[channel][known], x[3 + channel][known])[0, 1] > 0.9
    assert patch_of(Pyramid(px), CAMERA, pad, pose_of(PadPlacement((5.0, 0.0, 2.0)))) is None


def test_it_can_only_lower_a_confidence_and_is_used_in_a_search_alone() -> None:
    pad = shipped_pad("thesis")
    frame, attitude = Frame(STAMP, 0, image(PLACE, CAMERA, pad, blur_px=0.6, noise=1.5).px), PLACE.attitude()

    def confidence(opinion: SecondOpinion | None) -> float:
        tracker = TrackerConfig(CAMERA, pad, TrackerOptions(learned="second_opinion"), second_opinion=opinion)
        seen = track(tracker, TrackerMemory(), frame, attitude)[0]
        assert (seen.opinions is None) == (opinion is None)
        return seen.selected.confidence

    alone = confidence(None)
    assert alone > 0.5
    assert confidence(Always(30.0)) == alone
    assert confidence(Always(-3.0)) == pytest.approx(confidence_of(-3.0))
    no = Always(-30.0)
    tracker = TrackerConfig(CAMERA, pad, second_opinion=no)
    seen = track(tracker, TrackerMemory(), frame, attitude, belief_at(PLACE))[0].selected
    assert seen.confidence > 0.5
    assert no.asked == 0


def test_it_goes_to_another_process(network: SecondOpinion) -> None:
    seen = Pyramid(image(PLACE, CAMERA, shipped_pad("thesis")).px), CAMERA, shipped_pad("thesis"), pose_of(PLACE)
    assert network.log_odds(*seen) is not None
    assert pickle.loads(pickle.dumps(network)).log_odds(*seen) == network.log_odds(*seen)


def test_a_missing_damaged_or_wrong_file_is_refused_by_name(tmp_path: Path) -> None:
    whole = SHIPPED_NETWORK.read_bytes()
    assert len(whole) < 300_000
    (tmp_path / "half.onnx").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.onnx").write_text("no network\n")
    (tmp_path / "large.onnx").write_bytes(bytes(2_000_001))
    for name, cure in (
        ("missing.onnx", "name a file that is there, or leave vision.learned_file empty"),
        ("half.onnx", "damaged, or not an ONNX network that takes a patch of 12 x 48 x 48 numbers"),
        ("text.onnx", "name one with the inputs of the shipped one"),
        ("large.onnx", "at most 2000000"),
    ):
        with pytest.raises(BadInput) as why:
            second_opinion(str(tmp_path / name), "vision.learned_file")
        assert str(why.value).startswith(f"vision.learned_file: {tmp_path / name}")
        assert cure in str(why.value)
