"""Finds in some frames are unchanged: places, their deviations, evidence, scores.

WHY: constants of search, alignment, registration and lamps are tuned on thousands of frames. Another value breaks no property and
must not come unseen. WHAT: frames by day from 0.3 to 12 m, searched from cold and looked at from the truth, and by night.
    python -m tests.estimator.vision.test_unchanged_frames > tests/estimator/vision/unchanged_frames.txt
writes them again; a change needs its reason in the commit.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Frame
from estimator.vision.track.lamps import detect_lamps
from tests.estimator.vision.test_verification import BENT, seen_at
from tests.support.night_scenes import NIGHTS, night_scene
from tests.support.pad_images import STAMP, sim_camera
from tests.support.pad_scenes import acquire, load_pad

PADS = ("thesis", "printed", "icao")
DAYS = [(k, PADS[k % 3]) for k in range(11)]
NIGHT = [(k, height_m) for k, height_m in enumerate((0.45, 0.9, 1.6, 3.0, 6.0, 11.0, 16.0, 21.0))]
KEPT = dict(line.split(": ") for line in Path(__file__).with_name("unchanged_frames.txt").read_text().splitlines())


def weighed(numbers: F64) -> float:
    """Return a sum in which no two of many numbers weigh the same."""
    return float(np.asarray(numbers, dtype=float) @ np.cos(np.arange(1, len(numbers) + 1)))


def looked_at(k: int, pad_name: str) -> list[float]:
    """Return pose, deviations and evidence of a look from the truth: place and rotation off it, in standard deviations."""
    _, view, found = seen_at(k, pad_name)
    sigma = np.sqrt(np.diag(found.cov))
    off = np.append(found.pose.t_cam_pad - view.start.t_cam_pad, (found.pose.R_cam_pad @ view.start.R_cam_pad.inv).rotvec_rad)
    in_level = np.frombuffer(np.asarray(found.in_level).tobytes())
    return [
        *off / sigma, weighed(np.log(sigma)), weighed(found.cov.ravel() / np.outer(sigma, sigma).ravel()),
        found.blur_px, found.noise_light * 1e3, weighed(found.evidence), found.log_odds, weighed(in_level),
        weighed(found.paint().mean.ravel()), weighed(found.paint().var.ravel()),
    ]  # fmt: skip


def searched(k: int, pad_name: str) -> list[float]:
    """Return the number of candidates of a search from cold, and the place and score of the best three."""
    pad, view, _ = seen_at(k, pad_name)
    found = acquire(view.px, view.camera, pad, sure=2.0)
    return [float(len(found)), *(number for one in found[:3] for number in (weighed(one.pose.t_cam_pad), one.score))]


def by_night(k: int, height_m: float) -> list[float]:
    """Return place, heading, deviations and confidence of a lit pad."""
    camera = BENT if k % 2 else sim_camera()
    scene = night_scene(np.random.default_rng([43, k]), camera, load_pad("lit"), height_m, NIGHTS[k % len(NIGHTS)])
    found: Sighting | None = detect_lamps(Frame(STAMP, 0, scene.px), camera, load_pad("lit"), scene.orientation)
    if found is None:
        return []
    sigma = np.sqrt(np.diag(found.cov))
    at = np.append(found.d_body_pad_level, 0.0 if found.yaw_rad is None else found.yaw_rad)
    return [*at, weighed(np.log(sigma)), weighed((found.cov / np.outer(sigma, sigma)).ravel()), found.confidence]


CASES: dict[str, Callable[[], list[float]]] = {
    **{f"look {k} {pad}": lambda k=k, pad=pad: looked_at(k, pad) for k, pad in DAYS},  # type: ignore[misc]
    **{f"search {k} {pad}": lambda k=k, pad=pad: searched(k, pad) for k, pad in DAYS},  # type: ignore[misc]
    **{f"night {k}": lambda k=k, h=height_m: by_night(k, h) for k, height_m in NIGHT},  # type: ignore[misc]
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_found_in_a_frame_is_what_it_was(name: str) -> None:
    kept = [float(x) for x in KEPT[name].split()]
    assert CASES[name]() == pytest.approx(kept, rel=1e-4, abs=1e-4)


if __name__ == "__main__":
    for each, numbers in CASES.items():
        sys.stdout.write(f"{each}: {' '.join(f'{x:.5f}' for x in numbers())}\n")
