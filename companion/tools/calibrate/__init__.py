"""A camera's intrinsics and distortion from images of a printed board."""
