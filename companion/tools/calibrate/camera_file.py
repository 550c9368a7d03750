"""Write the camera file that `Camera.from_mapping` reads, with the source of its numbers."""

import math

from companion.tools.calibrate.solve import Solution
from estimator.contracts.errors import BadInput
from estimator.vision.camera.camera import Camera

FOREIGN = ("ros", "opencv", "kalibr")
"""The other kinds of camera file that are written; `companion.settings.load` reads them back."""


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
    lens = "" if c.lens == "brown" else f'lens = "{c.lens}"\n'
    return (
        f"# Calibrated from {' '.join(source.split())}: {len(solution.fits)} views, error {solution.rms_px:.3f} px rms, "
        f"distortion {solution.model}.\n"
        f"# One standard deviation: fx {s[0]:.2f}, fy {s[1]:.2f}, cx {s[2]:.2f}, cy {s[3]:.2f} px. Distances are right to "
        f"{100.0 * solution.distances_right_to:.2g} % (95 %).\n"
        f"width = {c.width}\nheight = {c.height}\n"
        f"fx = {_number(c.fx, 3)}\nfy = {_number(c.fy, 3)}\ncx = {_number(c.cx, 3)}\ncy = {_number(c.cy, 3)}\n"
        f"{lens}distortion = [{distortion}]\nfocal_sigma = {_number(c.focal_sigma, 6)}\n"
        "# The mount is not calibrated: where the camera sits in the body (forward, right, down) and which way it looks.\n"
        f"p_body_cam_m = [{p}]\nrpy_body_cam_deg = [{rpy}]\n"
    )


def foreign(camera: Camera, kind: str) -> str:
    """Return the camera as a file of ROS (camera_info), OpenCV (FileStorage) or Kalibr (camchain); none of them has the mount.

    Raises:
        BadInput: the kind has no place for k3, and the camera has one.
    """
    c = camera
    matrix = [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0]
    bent = [float(v) for v in c.distortion]
    fisheye = c.lens == "fisheye"
    if kind == "kalibr":
        if not fisheye and bent[4] != 0.0:
            raise BadInput("--export kalibr: its model has no k3, and this lens needs one")
        return (
            f"cam0:\n  camera_model: pinhole\n  intrinsics: {_row([c.fx, c.fy, c.cx, c.cy])}\n"
            f"  distortion_model: {'equidistant' if fisheye else 'radtan'}\n"
            f"  distortion_coeffs: {_row(bent[:4])}\n  resolution: [{c.width}, {c.height}]\n  rostopic: /camera/image_raw\n"
        )
    if kind == "opencv":
        tag, depth = " !!opencv-matrix", "\n  dt: d"
        head, model, across = "%YAML:1.0\n---\n", "fisheye_model: 1\n" if fisheye else "", (len(bent), 1)
    else:
        named = "equidistant" if fisheye else "plumb_bob"
        tag, depth, head, model, across = "", "", "", f"camera_name: camera\ndistortion_model: {named}\n", (1, len(bent))
    out = f"{head}image_width: {c.width}\nimage_height: {c.height}\n{model}"
    out += f"camera_matrix:{tag}\n  rows: 3\n  cols: 3{depth}\n  data: {_row(matrix)}\n"
    out += f"distortion_coefficients:{tag}\n  rows: {across[0]}\n  cols: {across[1]}{depth}\n  data: {_row(bent)}\n"
    if kind == "ros":
        project = [*matrix[:3], 0.0, *matrix[3:6], 0.0, *matrix[6:], 0.0]
        out += f"rectification_matrix:\n  rows: 3\n  cols: 3\n  data: {_row([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])}\n"
        out += f"projection_matrix:\n  rows: 3\n  cols: 4\n  data: {_row(project)}\n"
    return out


def _row(values: list[float]) -> str:
    return f"[{', '.join(_number(v, 6) for v in values)}]"


def _number(value: float, places: int) -> str:
    rounded = round(float(value), places)
    return repr(rounded if rounded != 0 and math.isfinite(rounded) else 0.0)
