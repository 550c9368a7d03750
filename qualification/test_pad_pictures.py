"""Pictures of a pad say which part of its file is wrong; the truth is the pad that was painted into them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from companion.cli.main import main
from companion.tools.pad_price import CAMERA, planted, random_pose, view
from companion.tools.pads.pictures import check_pictures
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import part_of
from tests.support.pad_scenes import DATA, load_pad

THESIS = load_pad("thesis")


def shown_by(pad: Pad, seed: int = 1) -> dict[str, Any]:
    """Return what two pictures of the thesis' pad show of another file's borders, by part and key."""
    rng = np.random.default_rng(seed)
    poses = [random_pose(rng, CAMERA, THESIS, 55.0) for _ in range(2)]
    px = {str(k): (planted(view(20_000 + k), CAMERA, THESIS, pose, rng), CAMERA) for k, pose in enumerate(poses)}
    return {f"{one['part']} {one['key']}": one for one in check_pictures(pad, px)["borders"]}


def with_part(part: str, size: float) -> Pad:
    """Return the thesis' pad with the lengths of one part multiplied."""
    (own,) = (r for r in THESIS.regions if part_of(r) == part)
    other = structs.replace(own, **{key: size * value for key, value in structs.asdict(own).items() if isinstance(value, float)})
    return replace(THESIS, regions=tuple(other if r is own else r for r in THESIS.regions), calibration=None)


@settings(max_examples=3, deadline=None, derandomize=True)
@given(st.integers(0, 1000))
def test_a_file_that_is_right_is_shown(seed: int) -> None:
    shown = shown_by(THESIS, seed)
    assert all(one["is_shown"] and not one["advice"] for one in shown.values()), shown


@pytest.mark.parametrize(("part", "size"), [("disc", 1.25), ("letter", 0.75)])
def test_a_part_of_the_wrong_size_is_named_with_the_right_one(part: str, size: float) -> None:
    wrong = [one for one in shown_by(with_part(part, size)).values() if not one["is_shown"]]
    assert {one["part"] for one in wrong} == {part}, wrong
    for one in wrong:
        assert one["shown_at_m"] == pytest.approx(one["size_m"] / size, rel=0.04)


def test_reversed_paints_are_named() -> None:
    paints = tuple((name, (255 - r, 255 - g, 255 - b)) for name, (r, g, b) in THESIS.paints)
    shown = shown_by(replace(THESIS, paints=paints, calibration=None))
    assert all("other way round" in one["advice"] for of, one in shown.items() if not of.startswith("disc")), shown


def test_the_command_says_what_is_found_and_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng, (with_pad, without) = np.random.default_rng(3), (str(tmp_path / name) for name in ("pad.png", "none.png"))
    pose = random_pose(rng, CAMERA, THESIS, 55.0)
    cv2.imwrite(with_pad, planted(view(20_001), CAMERA, THESIS, pose, rng))
    cv2.imwrite(without, view(20_002))
    assert main(["pad", "check", "thesis", "--picture", with_pad, "--json"]) == 0
    (picture,) = json.loads(capsys.readouterr().out)["pictures"]
    assert picture["centre_px"] == pytest.approx(CAMERA.project(pose.t_cam_pad[None])[0], abs=1.0)
    assert main(["pad", "check", "thesis", "--picture", without]) == 1
    assert "no part of the pad is found" in capsys.readouterr().out
    for words in ([str(tmp_path / "gone.png")], [with_pad, "--camera", "sim"]):
        assert main(["pad", "check", "thesis", "--picture", *words]) == 2


@pytest.mark.skipif(not (DATA / "real_pads").exists(), reason="../shared/data/real_pads is not on this machine")
def test_a_disc_around_a_real_ring_that_no_picture_shows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, file = DATA / "real_pads" / "mbzirc", tmp_path / "pad.toml"
    disc = '[[regions]]\nshape = "disc"\npaint = "white"\nradius_m = 0.62\n\n[[regions]]'
    file.write_text((folder / "pad.toml").read_text().replace('ground = "white"', "").replace("[[regions]]", disc, 1))
    frames = [str(folder / "2017-03-13-06-49-06" / f"frame0{n}.jpg") for n in (266, 300)]
    assert main(["pad", "check", str(file), "--picture", *frames]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert all("found without its disc" in line for line in lines[:2])
    assert "shown in 0 of 2: no edge" in lines[2]
    assert lines[2].endswith('write ground = "white" above [paints]')
    assert all(line.endswith("shown in 2 of 2") for line in lines[3:])
