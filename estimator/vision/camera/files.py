"""Read camera files of ROS (camera_info), OpenCV (FileStorage: YAML, XML, JSON) and Kalibr (camchain).

They say nothing of the mount: the camera then looks straight down with the nose at the image's top. A fisheye (ROS and Kalibr:
equidistant; OpenCV: fisheye_model) is read as it is. A rational lens is fitted by Brown's, and refused where that does not fit.

Source: ROS REP-104 and camera_calibration_parsers; OpenCV, calib3d; Kalibr wiki, YAML formats.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64

_DOWN_RPY_DEG = [0.0, 0.0, 90.0]
_MISFIT_MAX_PX = 0.5
"""The largest error anywhere in the frame of our model beside the file's; corners are seen to a tenth of a pixel."""
_GRID = 25  # Points along a side at which a lens is compared with ours
_BROWN = {"plumb_bob", "radtan", "opencv", "none", ""}
_FISHEYE = {"equidistant", "fisheye", "kannala_brandt"}
_SIZE = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
_MATRIX = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "M1", "mtx", "intrinsics")
_COEFFICIENTS = ("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "D", "d", "D1", "dist", "distortion_coeffs")
_INI, _MARKUP, _YAML = "# oST", ("<", "{"), "%YAML"
"""Beginnings of such files, and of none of ours; those whose names end as YAML's need none."""


def is_foreign(text: str, path: str) -> bool:
    """Return whether a text is one of these kinds, and none of our own."""
    return _begin(text).startswith((_INI, *_MARKUP, _YAML)) or path.lower().endswith((".yaml", ".yml"))


def _begin(text: str) -> str:
    return text.lstrip("\ufeff \r\n\t")


def foreign_camera(text: str, path: str) -> dict[str, Any]:
    """Return the keys of our own camera file for a text of one of these kinds.

    Raises:
        BadInput: a part is lacking, or it is of a lens that our model does not fit.
    """
    begin = _begin(text)
    if begin.startswith(_INI):
        raise BadInput(f"{path}: the INI form of ROS is not read: give the YAML file, which its calibrator writes beside it")
    if begin.startswith(_MARKUP):
        return _mapping(_stored(path, begin), path)
    document = re.split(r"^---\s*$", begin, maxsplit=2, flags=re.MULTILINE)
    # A message that was printed ends with this line, and the next one may follow.
    text = next((part for part in document if part.strip() and not part.startswith(_YAML)), "")
    return _mapping(_stored(path, "%YAML:1.0\n---\n" + re.sub(r"^- ", "  - ", text.lstrip("\r\n"), flags=re.MULTILINE)), path)


def _stored(path: str, text: str) -> dict[str, Any]:
    """Return what OpenCV's parser finds: maps, lists, numbers and texts; a matrix is its numbers row by row."""
    import cv2  # a tenth of the service's start, which our own files do not need

    try:
        store = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        found = _value(store.root())
    except (cv2.error, SystemError) as why:
        raise BadInput(
            f"{path}: neither TOML nor the YAML or XML of a camera: {str(why).strip().splitlines()[-1][:100]}"
        ) from why
    if not isinstance(found, dict):
        raise BadInput(f"{path}: it holds no camera")
    return found


def _value(node: Any) -> Any:
    if node.isMap():
        made = {key: _value(node.getNode(key)) for key in node.keys()}  # noqa: SIM118
        return made["data"] if {"rows", "cols", "data"} <= made.keys() else made
    if node.isSeq():
        return [_value(node.at(i)) for i in range(node.size())]
    if node.isInt() or node.isReal():
        return node.real()
    return node.string() if node.isString() else None


def _mapping(found: Mapping[str, Any], path: str) -> dict[str, Any]:
    """Return the keys of our own camera file."""
    data = _of_camera(found, path)
    numbers = _numbers(_first(data, _MATRIX))
    if len(numbers) not in (4, 9):
        raise BadInput(f"{path}: it has no camera matrix (camera_matrix or intrinsics) of four or nine numbers")
    fx, fy, cx, cy = numbers if len(numbers) == 4 else (numbers[k] for k in (0, 4, 2, 5))
    size = width, height = _size(data, path)
    kind = str(data.get("distortion_model") or data.get("model") or ("fisheye" if data.get("fisheye_model") else ""))
    coefficients = _numbers(_first(data, _COEFFICIENTS))
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    bent = _fisheye(matrix, size, coefficients, path) if kind in _FISHEYE else _brown(matrix, size, kind, coefficients, path)
    return {
        "width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy,
        "lens": "fisheye" if kind in _FISHEYE else "brown", "distortion": bent, "rpy_body_cam_deg": _DOWN_RPY_DEG,
    }  # fmt: skip


def _of_camera(found: Mapping[str, Any], path: str) -> Mapping[str, Any]:
    """Return the part of a file that is of its one camera, with whole frames of a pinhole."""
    cameras = [key for key, value in found.items() if isinstance(value, dict) and "intrinsics" in value]
    if len(cameras) > 1:
        raise BadInput(f"{path}: it holds {len(cameras)} cameras ({', '.join(cameras)}): leave the one that looks down")
    data: Mapping[str, Any] = found[cameras[0]] if cameras else found
    if (model := data.get("camera_model", "pinhole")) != "pinhole":
        raise BadInput(f"{path}: camera_model {model!r} is not read; pinhole is")
    if any(data.get(key) not in (None, 0.0, 1.0) for key in ("binning_x", "binning_y")):
        raise BadInput(f"{path}: its frames are binned: give the camera_info of the frames as they are")
    if isinstance(part := data.get("roi"), dict) and any(part.get(key) for key in ("x_offset", "y_offset")):
        raise BadInput(f"{path}: its frames are a part of the sensor (roi): give the camera_info of whole frames")
    return data


def _size(data: Mapping[str, Any], path: str) -> tuple[int, int]:
    sizes: list[list[Any]] = [_numbers(data.get("resolution")), *([data.get(w), data.get(h)] for w, h in _SIZE)]
    size = next((s for s in sizes if len(s) == 2 and all(isinstance(v, float) and v.is_integer() for v in s)), None)
    if size is None:
        raise BadInput(f"{path}: it does not say the size of the frames: add image_width and image_height")
    return int(size[0]), int(size[1])


def _first(data: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    return next((data[name] for name in names if name in data), None)


def _numbers(value: Any) -> list[float]:
    flat: list[float] = []
    for one in value if isinstance(value, list) else []:
        flat += _numbers(one) if isinstance(one, list) else [one] if isinstance(one, float) else []
    return flat


def _fisheye(matrix: F64, size: tuple[int, int], coefficients: list[float], path: str) -> list[float]:
    """Return the four coefficients of a fisheye whose image grows with the angle over the whole frame."""
    k = [*coefficients, *[0.0] * (4 - len(coefficients))]
    if len(k) > 4 and not any(k[4:]):
        k = k[:4]
    if len(k) > 4:
        raise BadInput(f"{path}: a fisheye has four coefficients, got {len(k)}")
    corners = (np.array([(0, 0), (0, size[1] - 1), (size[0] - 1, 0), (size[0] - 1, size[1] - 1)]) - matrix[:2, 2]) / np.diag(
        matrix
    )[:2]
    theta = np.linspace(0.0, 0.5 * np.pi, 200)
    bent = theta * (1.0 + sum(c * theta ** (2 * n) for n, c in enumerate(k, start=1)))
    falls = np.flatnonzero(np.diff(bent) <= 0.0)
    if len(falls) and bent[falls[0]] < np.hypot(*corners.T).max():
        raise BadInput(f"{path}: its fisheye lens folds the image over within the frame; are the coefficients k1, k2, k3, k4?")
    return k


def _brown(matrix: F64, size: tuple[int, int], kind: str, coefficients: list[float], path: str) -> list[float]:
    """Return our five coefficients for a lens of another kind."""
    if not kind and len(coefficients) == 4 and any(coefficients):
        raise BadInput(
            f"{path}: four coefficients may be a fisheye's: add distortion_model: equidistant (for cv2.fisheye) or plumb_bob"
        )
    if kind in _BROWN and len(coefficients) <= 5 and len(coefficients) != 3:
        return [*coefficients, *[0.0] * (5 - len(coefficients))]
    if kind in _BROWN | {"rational_polynomial"} and not any(coefficients[5:]):
        return coefficients[:5]
    if kind not in _BROWN | {"rational_polynomial"}:
        raise BadInput(f"{path}: distortion_model {kind!r} is not read; plumb_bob, radtan, rational_polynomial, equidistant are")
    return _brown_of_rational(matrix, size, kind or "rational", coefficients, path)


def _brown_of_rational(matrix: F64, size: tuple[int, int], kind: str, coefficients: list[float], path: str) -> list[float]:
    """Return our five coefficients that fit a rational lens over the frame."""
    import cv2

    uv = np.stack(np.meshgrid(np.linspace(0, size[0] - 1, _GRID), np.linspace(0, size[1] - 1, _GRID)), axis=2).reshape(-1, 1, 2)
    try:
        xy = _undistorted(uv, matrix, coefficients)
    except cv2.error as why:
        raise BadInput(f"{path}: no lens of the model {kind} has these {len(coefficients)} coefficients") from why
    seen = (uv.reshape(-1, 2) - matrix[:2, 2]) / np.diag(matrix)[:2]
    fitted = _fitted(xy, seen)
    misfit_px = np.linalg.norm((_offsets(xy) @ fitted - (seen - xy).ravel()).reshape(-1, 2) * np.diag(matrix)[:2], axis=1)
    worst_px = float(misfit_px.max()) if np.all(np.isfinite(misfit_px)) else np.inf
    if not worst_px <= _MISFIT_MAX_PX:
        raise BadInput(
            f"{path}: its lens ({kind}) differs by {worst_px:.1f} px from any that is flown with: "
            "crop or rectify the frames, or calibrate this camera with `decklander calibrate camera`"
        )
    return [float(v) for v in fitted]


def _undistorted(uv: F64, matrix: F64, coefficients: list[float]) -> F64:
    import cv2

    known, end = np.array(coefficients, float), (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-9)
    points = cv2.undistortPointsIter(uv, matrix, known, np.eye(3), np.eye(3), end)
    return np.asarray(points, float).reshape(-1, 2)


def _offsets(xy: F64) -> F64:
    """Return the Jacobian of the distortion, which is linear in k1, k2, p1, p2, k3: (2 n, 5)."""
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    across = np.stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3], axis=1)
    along = np.stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3], axis=1)
    return np.stack([across, along], axis=1).reshape(-1, 5)


def _fitted(xy: F64, seen: F64) -> F64:
    A, b = _offsets(xy), (seen - xy).ravel()
    if not (np.all(np.isfinite(A)) and np.all(np.isfinite(b))):
        return np.full(5, np.nan)
    return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0], float)
