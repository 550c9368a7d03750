"""Finds in some frames are unchanged: places, their deviations, evidence, scores.

WHY: constants of search, alignment, registration and lamps are tuned on thousands of frames. Another value breaks no property and
must not come unseen. WHAT: frames by day from 0.3 to 12 m, searched from cold and looked at from the truth, and by night.
    python -m tests.estimator.vision.test_unchanged_frames
prints them again; a change needs its reason in the commit.
"""

import sys
from collections.abc import Callable

import numpy as np
import pytest

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Frame
from estimator.vision.detect.acquire import acquire
from estimator.vision.lamp_sighting import detect_lamps
from tests.estimator.vision.test_equivariance import BENT, seen_at
from tests.support.night_scenes import NIGHTS, night_scene
from tests.support.pad_images import STAMP, sim_camera
from tests.support.pad_scenes import load_pad

PADS = ("thesis", "printed", "icao")
DAYS = [(k, PADS[k % 3]) for k in range(11)]
NIGHT = [(k, height_m) for k, height_m in enumerate((0.45, 0.9, 1.6, 3.0, 6.0, 11.0, 16.0, 21.0))]
KEPT: dict[str, str] = {
    "look 0 thesis": (
        "-0.39519 -0.83859 0.74203 -0.45764 -0.39731 -0.83806 4.06421 "
        "-4.20614 0.93837 13.67682 -2.03758 11.46246 -0.27877 -4.11768 0.59079"
    ),
    "look 1 printed": (
        "-0.04647 0.00190 0.02288 0.28787 0.07094 -0.17486 2.02219 "
        "-2.00939 0.80288 18.71135 -1.66123 10.59498 0.66239 0.02993 -0.33609"
    ),
    "look 2 icao": (
        "1.19526 -0.21205 -0.71018 -0.15653 -1.30467 1.75961 4.23670 "
        "-3.60044 0.60169 38.17073 -0.82155 5.98436 -0.50489 0.63930 -0.14914"
    ),
    "look 3 thesis": (
        "0.13206 0.17710 -0.12847 0.37568 -0.47496 0.67794 2.49326 "
        "-2.56339 0.58837 17.63254 -2.93527 17.57400 0.94017 -3.85419 0.54289"
    ),
    "look 4 printed": (
        "0.19525 0.37725 0.17304 -0.11287 0.71733 0.59071 2.56925 "
        "-2.95508 1.09571 7.63893 -0.14762 7.87327 -1.09213 -0.05004 -0.32983"
    ),
    "look 5 icao": (
        "0.11649 -0.63533 0.87031 0.75118 1.17959 0.86017 2.10255 "
        "-2.69259 0.75563 6.22653 -2.58950 15.75905 -1.87857 0.64265 -0.02508"
    ),
    "look 6 thesis": (
        "-0.07812 0.09641 0.08145 -0.83342 -0.22086 -0.00185 2.09260 "
        "-1.23269 0.90029 58.24168 -1.38896 10.72748 -2.08464 0.49563 -0.92869"
    ),
    "look 7 printed": (
        "-0.05168 0.18407 -0.01449 0.00500 -0.38766 -0.02360 1.91260 "
        "-0.65694 0.54651 5.40763 -0.55462 9.89623 -4.37973 -2.76103 0.56507"
    ),
    "look 8 icao": (
        "-0.27118 -2.07014 0.27093 0.28631 -0.09318 1.09204 2.42908 "
        "-0.54359 1.17702 25.99866 2.32640 11.86381 -3.52464 -0.56321 -0.35943"
    ),
    "look 9 thesis": (
        "-0.38815 -0.43031 0.44570 2.09060 1.18265 1.20187 1.15077 "
        "-0.81343 1.01055 21.28868 1.95012 11.47891 -3.75308 -0.64519 -0.74252"
    ),
    "look 10 printed": (
        "-0.05074 0.09134 0.08739 0.08418 -0.05672 -0.01271 0.32664 "
        "-5.65366 0.74689 56.88990 3.33701 10.84574 -10.83541 -0.63569 -0.30373"
    ),
    "search 0 thesis": "16.00000 -0.31062 0.98223 -0.38920 0.03931 -33.37727 0.01170",
    "search 1 printed": "12.00000 -0.58815 0.99262 -0.54698 0.17981 -0.49884 0.01913",
    "search 2 icao": "8.00000 -0.59409 0.91229 -0.70226 0.02650 -0.62488 0.01529",
    "search 3 thesis": "8.00000 -0.99675 0.99993 -21.35741 0.01174 -9.12315 0.00711",
    "search 4 printed": "18.00000 -1.43757 0.97295 -1.49909 0.77013 -1.56695 0.49156",
    "search 5 icao": "7.00000 -1.32271 0.99872 -22.90102 0.01523 -20.67532 0.01295",
    "search 6 thesis": "14.00000 -3.79931 0.99759 -16.47591 0.01460 -6.03826 0.00516",
    "search 7 printed": "8.00000 -2.69152 0.99725 -28.55948 0.00691 -4.56116 0.00597",
    "search 8 icao": "5.00000 -8.39453 0.99808 -9.96698 0.03283 -0.28869 0.00747",
    "search 9 thesis": "16.00000 -12.96029 0.99693 -15.36916 0.22140 -16.11962 0.14052",
    "search 10 printed": "16.00000 -14.20118 0.99588 -14.93977 0.84988 -15.62491 0.27011",
    "night 0": "0.17317 0.06006 0.45499 -1.28581 9.75913 2.51259 1.00000",
    "night 1": "0.01710 0.01134 0.91662 1.61419 11.68526 1.51027 1.00000",
    "night 2": "0.04011 0.56139 1.64166 0.19019 8.07733 0.78512 1.00000",
    "night 3": "0.96482 0.38476 3.07483 2.42713 7.91201 2.37912 1.00000",
    "night 4": "-1.30093 0.43008 5.99519 2.27674 7.31882 -0.99643 1.00000",
    "night 5": "2.59309 3.11345 10.92152 -1.34019 6.07938 1.61610 1.00000",
    "night 6": "2.03161 4.31107 15.90048 -2.84801 5.40962 1.09849 1.00000",
    "night 7": "9.10432 -7.41771 22.08894 -2.57583 3.52808 0.99767 0.37890",
}


def weighed(numbers: F64) -> float:
    """Return a sum in which no two of many numbers weigh the same."""
    return float(np.asarray(numbers, dtype=float) @ np.cos(np.arange(1, len(numbers) + 1)))


def looked_at(k: int, pad_name: str) -> list[float]:
    """Return pose, deviations and evidence of a look from the truth: place and rotation off it, in standard deviations."""
    _, view, found = seen_at(k, pad_name)
    registration = found.registration()
    sigma = np.sqrt(np.diag(registration.cov))
    off = np.append(found.pose.t_cam_pad - view.start.t_cam_pad, (found.pose.R_cam_pad @ view.start.R_cam_pad.inv).rotvec_rad)
    in_level = np.frombuffer(np.asarray(found.in_level).tobytes())
    return [
        *off / sigma, weighed(np.log(sigma)), weighed(registration.cov.ravel() / np.outer(sigma, sigma).ravel()),
        registration.blur_px, registration.noise_light * 1e3, weighed(found.evidence), found.log_odds, weighed(in_level),
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
        sys.stdout.write(f'    "{each}": "{" ".join(f"{x:.5f}" for x in numbers())}",\n')
