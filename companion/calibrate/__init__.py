"""A camera's intrinsics and distortion from pictures of a printed board."""
