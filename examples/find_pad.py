"""Find the pad in one image: `python -m examples.find_pad [IMAGE]`."""

import sys
import tomllib

import cv2

from decklander import Camera, Pad, PadTracker, shipped

camera = Camera.from_mapping(tomllib.loads(shipped("cameras/sim.toml").read_text()))
pad = Pad.from_mapping(tomllib.loads(shipped("pads/thesis.toml").read_text()))
image = cv2.imread(sys.argv[1] if len(sys.argv) > 1 else str(shipped("examples/pad.jpg")))
if image is None:
    sys.exit("the file is no image that OpenCV reads")
found = PadTracker(camera, pad, colours="simulator").track(image)
if found is None:
    sys.exit("no pad in the image")
forward, right, down = found.d_body_pad_level
print(f"pad {forward:.2f} m ahead, {right:.2f} m to the right, {down:.2f} m below; confidence {found.confidence:.2f}")
