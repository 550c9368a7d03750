"""Find the pad in one image: `python -m examples.find_pad [IMAGE]`."""

import sys
import tomllib
from importlib.resources import files

import cv2

from estimator import Camera, Pad, PadTracker

configs = files("configs")
camera = Camera.from_mapping(tomllib.loads(configs.joinpath("cameras/sim.toml").read_text()))
pad = Pad.from_mapping(tomllib.loads(configs.joinpath("pads/thesis.toml").read_text()))
image = cv2.imread(sys.argv[1] if len(sys.argv) > 1 else str(configs.joinpath("examples/pad.jpg")))
if image is None:
    sys.exit("the file is no image that OpenCV reads")
found = PadTracker(camera, pad, colours="simulator").track(image)
if found is None:
    sys.exit("no pad in the image")
forward, right, down = found.d_body_pad_level
print(f"pad {forward:.2f} m ahead, {right:.2f} m to the right, {down:.2f} m below; confidence {found.confidence:.2f}")
