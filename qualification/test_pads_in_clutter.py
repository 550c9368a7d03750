"""Pads of users are found where they are planted, however seen and lit, and not in clutter."""

import math
from dataclasses import replace

import cv2
import msgspec
import numpy as np
import pytest

from companion.settings.load import read_toml
from companion.tools.pad_price import CAMERA, VIEWS, kind_of, planted, price, view
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Frame
from estimator.vision.camera.pose import PadPose
from estimator.vision.pad.pad import RARE, Pad
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from tests.support.users_pads import STAMP, USERS, trust, user_s

ODD_VIEWS = [("octagon", 0.6, 0.3, 60.0, -1.6), ("octagon", 0.1, 0.0, 80.0, 0.2), ("ring_and_panels", 1.1, 0.0, 60.0, -1.6)]


@pytest.mark.parametrize(("name", "roll_rad", "pitch_rad", "radius_px", "beyond"), ODD_VIEWS, ids=["aslant", "cut", "ring"])
def test_a_pad_aslant_or_cut_by_the_frame_is_found_without_an_attitude(name, roll_rad, pitch_rad, radius_px, beyond):
    pad = user_s(name)
    depth_m = CAMERA.fx * pad.disc_radius_m / radius_px
    at = np.array([0.5 * CAMERA.width / radius_px - (1.0 - beyond), 0.0, CAMERA.fx / radius_px])
    pose = PadPose(Rotation.from_rpy(roll_rad, pitch_rad, 0.3), at * depth_m / at[2])
    px = planted(view(6), CAMERA, pad, pose, np.random.default_rng(1))
    assert trust(pad, px, pose) >= 0.5


def test_the_dot_of_a_drawing_whose_rest_would_be_out_of_view_is_not_the_drawing() -> None:
    pad = user_s("triangle_and_dot")
    px = np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)
    cv2.circle(px, (CAMERA.width // 2, CAMERA.height // 2), CAMERA.height // 3, (0, 120, 255), -1, cv2.LINE_AA)
    assert trust(pad, px) < 0.5


def test_a_pad_that_clutter_is_taken_for_too_often_has_to_tell_more_unless_that_is_accepted() -> None:
    pad = user_s("house")
    pose = PadPose(Rotation.from_rpy(0.0, 0.0, 0.4), np.array([0.0, 0.0, CAMERA.fx * pad.disc_radius_m / 18.0]))
    px = planted(view(6), CAMERA, pad, pose, np.random.default_rng(1))
    assert pad.calibration is not None
    often = replace(pad, calibration=msgspec.structs.replace(pad.calibration, chance=RARE * math.exp(6.0)))
    found = trust(pad, px), trust(often, px), trust(replace(often, accept_false_pads=True), px)
    odds = [math.log(p / (1.0 - p)) for p in found]
    assert odds[1] == pytest.approx(odds[0] - 6.0, abs=0.01)
    assert odds[2] == pytest.approx(odds[0])


def test_a_pad_of_any_polarity_is_found_and_followed_in_reversed_light_and_costs_twice_the_clutter(monkeypatch) -> None:
    monkeypatch.setattr("companion.tools.pad_price._EACH", 2)
    keys = read_toml(next(p for p in USERS if p.stem == "house"))
    pad, drawn_alone = Pad.from_mapping({**keys, "polarity": "any"}), Pad.from_mapping(keys)
    pose = PadPose(Rotation.from_rpy(0.1, 0.0, 0.4), np.array([0.0, 0.0, CAMERA.fx * pad.disc_radius_m / 40.0]))
    px = planted(view(6), CAMERA, pad, pose, np.random.default_rng(1))
    memory = TrackerMemory()
    for number, shown in enumerate((cv2.bitwise_not(px), cv2.bitwise_not(px), px)):
        found, memory = track(TrackerConfig(CAMERA, pad), memory, Frame(STAMP, number, np.asarray(shown, np.uint8)), None)
        assert found.selected.confidence >= 0.5
        assert math.hypot(*found.selected.d_body_pad_level) == pytest.approx(pose.range_m, rel=0.03)
        assert memory.reversed == (number < 2)
    assert trust(drawn_alone, np.asarray(cv2.bitwise_not(px), np.uint8)) < 0.5
    cost, cost_alone = (price(of, {}, 7).calibration for of in (pad, drawn_alone))
    assert (cost.chance, cost.least_support) > (cost_alone.chance, cost_alone.least_support)


def test_pads_of_users_can_be_named_and_are_not_seen_in_clutter() -> None:
    assert len(USERS) == 20
    assert len({kind_of(k) for k in range(VIEWS)}) == 7
    views = [view(k) for k in (1, 5, 6)]
    for number, file in enumerate(USERS):
        pad = Pad.from_mapping(read_toml(file), file.name)
        assert trust(pad, views[number % 3]) < 0.5, file.name
