"""Write the camera file that `Camera.from_mapping` reads, with the source of its numbers."""

import math

from companion.tools.calibrate.solve import Solution


def text(solution: Solution, source: str, rpy_body_cam_deg: tuple[float, float, float]) -> str:
    """Return the camera as TOML. The mount is written as given, so that a person can correct it.

    Args:
        source: one line that describes the images of the calibration.
        rpy_body_cam_deg: the mount's angles (the matrix in `solution.camera` may have several).
    """
    c, s = solution.camera, solution.sigma
    p = ", ".join(_number(v, 4) for v in c.T_body_cam.t)
    rpy = ", ".join(_number(v, 3) for v in rpy_body_cam_deg)
    distortion = ", ".join(_number(float(v), 6) for v in c.distortion)
    return (
        f"# Calibrated from {' '.join(source.split())}: {len(solution.fits)} views, error {solution.rms_px:.3f} px rms, "
        f"distortion {solution.model}.\n"
        f"# One standard deviation: fx {s[0]:.2f}, fy {s[1]:.2f}, cx {s[2]:.2f}, cy {s[3]:.2f} px.\n"
        f"width = {c.width}\nheight = {c.height}\n"
        f"fx = {_number(c.fx, 3)}\nfy = {_number(c.fy, 3)}\ncx = {_number(c.cx, 3)}\ncy = {_number(c.cy, 3)}\n"
        f"distortion = [{distortion}]\n"
        "# The mount is not calibrated: where the camera sits in the body (forward, right, down) and which way it looks.\n"
        f"p_body_cam_m = [{p}]\nrpy_body_cam_deg = [{rpy}]\n"
    )


def _number(value: float, places: int) -> str:
    rounded = round(float(value), places)
    return repr(rounded if rounded != 0 and math.isfinite(rounded) else 0.0)
