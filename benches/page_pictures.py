"""Measure what the operator page's live picture costs: `python -m benches.page_pictures [--seconds S]`.

A descent from 5 m to 0.5 m over a rendered ship, 15 pictures a second with the simulated camera's noise. For JPEG and for H.264
(one encoder, as each browser has one): bytes of a picture, and processor time on one thread, beside a floor measured in between:
one BGR to HSV conversion and one inRange of a frame of the same size.
"""

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np

from benches.acquisition import floor_ms
from benches.render import shot_over_pad, table
from companion.parts.page.state import jpeg, video_quality
from companion.recording.frame_encoder import FrameEncoder
from companion.settings.page import PageSettings
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from sitl.camera.camera import Renderer
from sitl.camera.surroundings import Deck, Surroundings
from sitl.sea.sea import SHELTERED_SLIGHT, Waves
from sitl.vessel.seakeeping import FERRY
from sitl.vessel.vessel import Mooring, Vessel

RATE_HZ = 15.0


def pictures(seconds: float) -> list[np.ndarray]:
    """Return the pictures of the descent."""
    waves = Waves.draw(SHELTERED_SLIGHT, 3, towards_rad=0.8)
    vessel = Vessel(FERRY, waves, heading_rad=0.3, mooring=Mooring(), seeds=3)
    camera, pad = Camera.from_mapping(table("cameras/sim.toml")), Pad.from_mapping(table("pads/thesis.toml"))
    renderer, rng = Renderer(camera, pad, Surroundings(Deck.of(FERRY), waves)), np.random.default_rng(0)
    heights = np.linspace(5.0, 0.5, round(seconds * RATE_HZ)).tolist()
    return [renderer.render(shot_over_pad(vessel, i / RATE_HZ, height_m), rng) for i, height_m in enumerate(heights)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="length of the descent")
    cv2.setNumThreads(1)
    shown, settings = pictures(parser.parse_args().seconds), PageSettings()
    floor = float(np.median([floor_ms(px) for px in shown]))
    print(f"{len(shown)} pictures of {shown[0].shape[1]}x{shown[0].shape[0]} px, floor {floor:.2f} ms")
    print("codec   kB a picture   kB/s   ms a picture   floors   % of a core")
    ways: dict[str, Callable[[np.ndarray], bytes]] = {
        "jpeg": lambda px: jpeg(px, settings.jpeg_quality),
        "h264": FrameEncoder(video_quality(settings)).encoded,
    }
    for name, encode in ways.items():
        sizes, spent = [], []
        for px in shown:
            began = time.process_time_ns()
            sizes.append(len(encode(px)) / 1e3)
            spent.append((time.process_time_ns() - began) * 1e-6)
        ms, kb = float(np.median(spent)), float(np.mean(sizes))
        print(f"{name:6s}{kb:14.1f}{RATE_HZ * kb:7.0f}{ms:15.2f}{ms / floor:9.1f}{RATE_HZ * ms / 10.0:14.1f}")


if __name__ == "__main__":
    main()
