"""The library's public surface: what it exports, what that costs, what docs/api.md says of it, and what the two objects do."""

import math
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from msgspec import structs
from numpy.typing import NDArray

import estimator
from estimator import (
    Attitude,
    Baro,
    BodyVelocity,
    Camera,
    Detection,
    Imu,
    MonoNs,
    Pad,
    PadTracker,
    Range,
    RelativeEstimator,
    Rotation,
    Sighting,
    Stamp,
    VehicleStatus,
    Verdict,
    VesselReport,
)
from estimator.contracts.estimates import Feature
from estimator.contracts.samples import Frame
from estimator.vision.camera.pose import SIGMA_DECK_RAD
from estimator.vision.options import TrackerOptions
from estimator.vision.track.config import TrackerConfig
from tests.make import sighting

ROOT = Path(__file__).parents[2]


def test_the_page_documents_every_public_name_and_no_other() -> None:
    page = (ROOT / "docs/api.md").read_text()
    assert sorted(re.findall(r"^### `(\w+)`$", page, re.MULTILINE)) == sorted(estimator.__all__)


def test_without_opencv_the_filter_serves_and_what_sees_names_what_is_missing() -> None:
    code = "import sys; sys.modules['cv2'] = None; import estimator; estimator.RelativeEstimator(); estimator.PadTracker"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1].startswith(
        "estimator.contracts.errors.SetupImpossible: PadTracker needs OpenCV 4.10 or newer (cv2), which is not installed: "
    )
    assert "decklander[headless]" in done.stderr


def test_every_public_name_can_be_had_and_is_documented_where_it_is_made() -> None:
    for name in estimator.__all__:
        value = getattr(estimator, name)
        assert value.__name__ == name
        assert name == "MonoNs" or value.__doc__
    assert set(estimator.__all__) <= set(dir(estimator))
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        _ = estimator.Nothing


def test_importing_the_library_loads_nothing() -> None:
    code = "import sys, estimator; print([m for m in ('numpy', 'cv2', 'msgspec', 'asyncio') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_tracker_and_estimator_need_no_asyncio_and_nothing_of_the_service() -> None:
    code = (
        "import sys; from estimator import PadTracker, RelativeEstimator; RelativeEstimator();"
        "print(sorted({m.partition('.')[0] for m in sys.modules} & {'asyncio', 'companion', 'drivers', 'sitl'}))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_every_shipped_package_says_that_it_is_typed() -> None:
    assert [p for p in ("companion", "drivers", "estimator", "sitl") if not (ROOT / p / "py.typed").is_file()] == []


CAMERA = Camera.from_mapping(tomllib.loads((ROOT / "configs/cameras/sim.toml").read_text()))
PAD = Pad.from_mapping(tomllib.loads((ROOT / "configs/pads/thesis.toml").read_text()))
LEVEL = Rotation.from_rpy(0.0, 0.0, 0.0)


def shipped_image() -> NDArray[np.uint8]:
    image = cv2.imread(str(ROOT / "configs/examples/pad.jpg"))
    return image.astype(np.uint8)


def attitude(t: float) -> Attitude:
    return Attitude(Stamp.from_seconds(t), LEVEL, np.eye(3) * 1e-4)


def pad_sighting(t: float, down: float = 3.0, confidence: float = 1.0, received: float | None = None) -> Sighting:
    cov = np.diag([1e-4, 1e-4, 1e-4, 1e-4])
    return Sighting(Stamp.from_seconds(t, received), 0, "fused", np.array([0.5, 0.2, down]), 0.1, False, cov, confidence)


def hovering(seconds: float = 1.0) -> RelativeEstimator:
    """Return an estimator that has hovered over a pad at rest, IMU at 100 Hz and sightings at 20 Hz."""
    filter = RelativeEstimator()
    for i in range(round(seconds * 100)):
        t = 1.0 + i / 100
        turning = np.array([0.0, 0.0, 1e-6 * (i % 7)])  # a reading that never changes by one bit counts as frozen
        filter.on_attitude(attitude(t))
        assert filter.on_imu(Imu(Stamp.from_seconds(t), turning, np.array([0.0, 0.0, -9.81]))) is Verdict.FUSED
        if i % 5 == 0:
            filter.on_sighting(pad_sighting(t))
    return filter


def test_the_tracker_finds_the_pad_and_leaves_the_image_to_its_owner() -> None:
    image, tracker = shipped_image(), PadTracker(CAMERA, PAD, colours="simulator")
    assert tracker.detection is None
    stamp = Stamp.from_seconds(3.0, 3.1, sigma_s=0.002)
    first, second = tracker.track(image, stamp=stamp), tracker.track(image)
    assert (first.stamp, first.seq, second.seq) == (stamp, 0, 1)
    assert np.abs(first.d_body_pad_level - second.d_body_pad_level).max() < 0.005
    assert tracker.detection is not None
    assert tracker.detection.methods["registration"] is not None
    assert image.flags.writeable


def test_the_tracker_begins_where_the_pad_is_expected() -> None:
    image, tracker = shipped_image(), PadTracker(CAMERA, PAD, colours="simulator", method="registration")
    stamp = Stamp.from_seconds(1.0)
    searched = tracker.track(image, stamp=stamp, attitude=attitude(1.0))
    filter = RelativeEstimator()
    filter.on_attitude(attitude(1.0))
    assert filter.on_sighting(searched) is Verdict.FUSED
    followed = tracker.track(image, stamp=stamp, attitude=filter.attitude_at(stamp), expected=filter.state)
    assert np.abs(followed.d_body_pad_level - searched.d_body_pad_level).max() < 0.005


def test_the_tracker_says_none_where_there_is_no_pad_or_too_little_confidence() -> None:
    tracker = PadTracker(CAMERA, PAD, colours="simulator")
    assert tracker.track(np.zeros((360, 640, 3), np.uint8)) is None
    assert PadTracker(CAMERA, PAD, colours="simulator", min_confidence=1.0).track(shipped_image() // 2 + 60) is None


@pytest.mark.parametrize("image", [np.zeros((480, 640, 3), np.uint8), np.zeros((360, 480), np.uint8), np.zeros((360, 640, 3))])
def test_the_tracker_refuses_what_is_no_image_of_the_camera(image: NDArray[np.generic]) -> None:
    with pytest.raises(ValueError, match=r"640x360 px|uint8 BGR"):
        PadTracker(CAMERA, PAD).track(image)


def test_the_tracker_refuses_unknown_colours_and_impossible_confidences() -> None:
    with pytest.raises(ValueError, match=r"colours must be one of simulator, indoor, outdoor, got 'pink'"):
        PadTracker(CAMERA, PAD, colours="pink")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="min_confidence must lie in"):
        PadTracker(CAMERA, PAD, min_confidence=1.5)


def test_the_tracker_hands_on_its_options_and_counts_no_find_below_its_confidence(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[TrackerConfig, Frame]] = []

    def found(config: TrackerConfig, memory: object, frame: Frame, *_: object) -> tuple[SimpleNamespace, object]:
        given.append((config, frame))
        return SimpleNamespace(selected=pad_sighting(0.0, confidence=0.2), elsewhere=None), memory

    monkeypatch.setattr("estimator.vision.track.tracker.track", found)
    image = np.zeros((360, 640, 3), np.uint8)
    for least, counts in ((0.0, True), (0.2, True), (0.21, False)):
        assert (PadTracker(CAMERA, PAD, min_confidence=least).track(image) is not None) is counts
    assert PadTracker(CAMERA, PAD).track(image) is not None, "by default the least is 0.2"
    below = SimpleNamespace(selected=pad_sighting(0.0, confidence=0.19), elsewhere=None)
    monkeypatch.setattr("estimator.vision.track.tracker.track", lambda *of: (below, of[1]))
    assert PadTracker(CAMERA, PAD).track(image) is None
    there = SimpleNamespace(selected=below.selected, elsewhere=pad_sighting(0.0, confidence=0.9))
    monkeypatch.setattr("estimator.vision.track.tracker.track", lambda *of: (there, of[1]))
    assert PadTracker(CAMERA, PAD).track(image) is there.elsewhere, "the estimator judges it"
    (config, frame), *_ = given
    assert config.options == TrackerOptions("registration", "indoor", math.degrees(SIGMA_DECK_RAD))
    assert (frame.seq, frame.stamp) == (0, Stamp(MonoNs(0), MonoNs(0), 0.0, "arrival"))
    monkeypatch.setattr("estimator.vision.track.tracker.track", found)
    PadTracker(CAMERA, PAD, colours="outdoor", sigma_deck_rad=0.1).track(image)
    assert given[-1][0].options == TrackerOptions("registration", "outdoor", math.degrees(0.1))


def test_the_estimator_carries_the_pad_on_between_sightings() -> None:
    filter = hovering()
    state = filter.state
    assert state.at == 1_990_000_000
    assert np.abs(state.d_body_pad_level - [0.5, 0.2, 3.0]).max() < 0.02
    later = filter.at(MonoNs(2_200_000_000))
    assert later.cov[0, 0] > state.cov[0, 0]


def test_the_estimator_takes_late_sightings_and_gives_the_reason_it_refuses_others() -> None:
    filter = hovering()
    assert filter.on_sighting(pad_sighting(1.9, received=2.0)) is Verdict.FUSED
    before = filter.at(MonoNs(2_000_000_000))
    assert filter.on_sighting(pad_sighting(1.2, received=2.0)) is Verdict.TOO_OLD
    assert filter.on_sighting(pad_sighting(1.99, confidence=0.1)) is Verdict.LOW_CONFIDENCE
    assert filter.on_imu(Imu(Stamp.from_seconds(2.0), np.full(3, 1e3), np.zeros(3))) is Verdict.IMPOSSIBLE
    after = filter.at(MonoNs(2_000_000_000))
    assert filter.state.at == 1_990_000_000, "what is refused is no newest event"
    for t in (2.01, 2.0):
        assert filter.on_imu(Imu(Stamp.from_seconds(t), np.full(3, 1e-5 * t), np.array([0.0, 0.0, -9.81]))) is Verdict.FUSED
    assert filter.state.at == 2_010_000_000, "nor is one that is late"
    assert np.array_equal(before.d_body_pad_level, after.d_body_pad_level)


def test_the_estimator_takes_every_kind_of_sample() -> None:
    filter, stamp = hovering(), Stamp.from_seconds(2.0)
    assert filter.on_velocity(BodyVelocity(stamp, np.zeros(3), np.eye(3) * 0.01)) is Verdict.FUSED
    assert filter.on_range(Range(stamp, 3.0, 0.02)) is not None
    assert filter.on_baro(Baro(stamp, 12.0, 0.3)) is not None
    assert filter.on_vessel(VesselReport(stamp, np.zeros(3), np.eye(3) * 0.01, None, None)) is Verdict.FUSED
    assert filter.on_status(VehicleStatus(stamp, True, "flying", 0.8, False, True)) is None


def test_arguments_that_were_mixed_up_are_named() -> None:
    for camera, pad in ((PAD, CAMERA), ("sim", PAD), (CAMERA, "thesis")):
        with pytest.raises(TypeError, match="takes a"):
            PadTracker(camera, pad)
    with pytest.raises(TypeError, match="must be a Stamp"):
        PadTracker(CAMERA, PAD).track(shipped_image(), stamp=1.0)


def test_a_notebook_shows_what_was_found() -> None:
    uv = np.array([[10.0, 5.0], [10.0, 25.0], [np.nan, 3.0], [400.0, 25.0]])
    features = (Feature("outline", "disc", uv), Feature("point", "centre", np.array([[-4.0, 2.0]])))
    seen = structs.replace(sighting(0.0, (0.5, -0.25, 2.0), None), features=features)
    grey = np.full((40, 60), 90, np.uint8)
    drawn = seen.draw(grey)
    assert drawn.shape == (40, 60, 3)
    assert drawn[15, 10].tolist() == drawn[25, 59].tolist() == [255, 0, 255]
    assert drawn[35, 50].tolist() == [90, 90, 90]
    assert grey.min() == grey.max() == 90
    table = Detection(seen, "registration", {"registration": seen, "arrow": None})._repr_html_()
    assert all(text in table for text in ("0.500", "-0.250", "not seen", "registration 0.90, arrow -"))
    assert "no pad" in Detection(None, None, {})._repr_html_()
