"""Read the settings of the service from one TOML file.

    settings = load("rig.toml")        # or the name of a shipped profile: load("sim")
    camera, pad = camera_model(settings), pad_model(settings)

`companion.settings.model` has the keys; docs/configuration.md is their page.

Camera files of others are read as well: those of ROS (camera_info), OpenCV (FileStorage: YAML, XML, JSON) and Kalibr (camchain).
They say nothing of the mount: the camera then looks straight down with the nose at the image's top. A fisheye (ROS and Kalibr:
equidistant; OpenCV: fisheye_model) is read as it is. A rational lens is fitted by Brown's, and refused where that does not fit.

Source: ROS REP-104 and camera_calibration_parsers; OpenCV, calib3d; Kalibr wiki, YAML formats.
"""

import difflib
import math
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

import configs
from companion.settings.expert import in_file, joined
from companion.settings.model import PadSettings, Settings
from companion.settings.plain_file import LARGEST_BYTES, refuse_special
from companion.settings.response import Response, response_from_mapping
from companion.settings.secret_files import CREDENTIAL
from drivers.ardrone.options import ArDroneOptions
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.errors import BadInput, unusable
from estimator.contracts.geometry import F64
from estimator.gimbal_history import DOWN
from estimator.vision.camera import Camera
from estimator.vision.pad import Calibration, Pad

_DOWN_RPY_DEG = [0.0, 0.0, 90.0]
_MISFIT_MAX_PX = 0.5
"""The largest error anywhere in the frame of our model beside the file's; corners are seen to a tenth of a pixel."""
_GRID = 25
_BROWN = {"plumb_bob", "radtan", "opencv", "none", ""}
_FISHEYE = {"equidistant", "fisheye", "kannala_brandt"}
_SIZE = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
_MATRIX = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "M1", "mtx", "intrinsics")
_COEFFICIENTS = ("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "D", "d", "D1", "dist", "distortion_coeffs")


def foreign_camera(text: str, path: Path) -> dict[str, Any] | None:
    """Return the keys of our own camera file for a text of one of these kinds, by its content; None for another text.

    Raises:
        BadInput: a part is lacking, or it is of a lens that our model does not fit.
    """
    begin = text.lstrip("\ufeff \r\n\t")
    if begin.startswith("# oST"):
        raise BadInput(f"{path}: the INI form of ROS is not read: give the YAML file, which its calibrator writes beside it")
    if begin.startswith(("<", "{")):
        return _mapping(_stored(path, begin), path)
    if path.suffix.lower() in (".yaml", ".yml") or begin.startswith("%YAML"):
        document = re.split(r"^---\s*$", begin, maxsplit=2, flags=re.MULTILINE)
        # A message that was printed ends with this line, and the next one may follow.
        text = next((part for part in document if part.strip() and not part.startswith("%YAML")), "")
        return _mapping(_stored(path, "%YAML:1.0\n---\n" + re.sub(r"^- ", "  - ", text.lstrip("\r\n"), flags=re.MULTILINE)), path)
    return None


def _stored(path: Path, text: str) -> dict[str, Any]:
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


def _mapping(found: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the keys of our own camera file."""
    cameras = [key for key, value in found.items() if isinstance(value, dict) and "intrinsics" in value]
    if len(cameras) > 1:
        raise BadInput(f"{path}: it holds {len(cameras)} cameras ({', '.join(cameras)}): leave the one that looks down")
    data = found[cameras[0]] if cameras else found
    if (model := data.get("camera_model", "pinhole")) != "pinhole":
        raise BadInput(f"{path}: camera_model {model!r} is not read; pinhole is")
    if any(data.get(key) not in (None, 0.0, 1.0) for key in ("binning_x", "binning_y")):
        raise BadInput(f"{path}: its frames are binned: give the camera_info of the frames as they are")
    if isinstance(part := data.get("roi"), dict) and any(part.get(key) for key in ("x_offset", "y_offset")):
        raise BadInput(f"{path}: its frames are a part of the sensor (roi): give the camera_info of whole frames")
    numbers = _numbers(_first(data, _MATRIX))
    if len(numbers) not in (4, 9):
        raise BadInput(f"{path}: it has no camera matrix (camera_matrix or intrinsics) of four or nine numbers")
    fx, fy, cx, cy = numbers if len(numbers) == 4 else (numbers[k] for k in (0, 4, 2, 5))
    width, height = _size(data, path)
    kind = str(data.get("distortion_model") or data.get("model") or ("fisheye" if data.get("fisheye_model") else ""))
    coefficients = _numbers(_first(data, _COEFFICIENTS))
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    size = width, height
    bent = _fisheye(matrix, size, coefficients, path) if kind in _FISHEYE else _brown(matrix, size, kind, coefficients, path)
    return {
        "width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy,
        "lens": "fisheye" if kind in _FISHEYE else "brown", "distortion": bent, "rpy_body_cam_deg": _DOWN_RPY_DEG,
    }  # fmt: skip


def _size(data: Mapping[str, Any], path: Path) -> tuple[int, int]:
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


def _fisheye(matrix: F64, size: tuple[int, int], coefficients: list[float], path: Path) -> list[float]:
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


def _brown(matrix: F64, size: tuple[int, int], kind: str, coefficients: list[float], path: Path) -> list[float]:
    """Return our five coefficients for a lens of another kind."""
    import cv2

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
    uv = np.stack(np.meshgrid(np.linspace(0, size[0] - 1, _GRID), np.linspace(0, size[1] - 1, _GRID)), axis=2).reshape(-1, 1, 2)
    try:
        xy = _undistorted(uv, matrix, coefficients)
    except cv2.error as why:
        raise BadInput(f"{path}: no lens of the model {kind or 'rational'} has these {len(coefficients)} coefficients") from why
    seen = (uv.reshape(-1, 2) - matrix[:2, 2]) / np.diag(matrix)[:2]
    fitted = _fitted(xy, seen)
    misfit_px = np.linalg.norm((_offsets(xy) @ fitted - (seen - xy).ravel()).reshape(-1, 2) * np.diag(matrix)[:2], axis=1)
    worst_px = float(misfit_px.max()) if np.all(np.isfinite(misfit_px)) else np.inf
    if not worst_px <= _MISFIT_MAX_PX:
        raise BadInput(
            f"{path}: its lens ({kind or 'rational'}) differs by {worst_px:.1f} px from any that is flown with: "
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


__all__ = [
    "Settings", "body_camera", "camera_model", "complete", "find_file", "from_file", "from_mapping", "load", "pad_model",
    "read_camera", "read_toml", "response_model", "shipped", "shipped_response",
]  # fmt: skip

_DEEP_PARTS = 50
_PART = r"""(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DEEP_KEY = re.compile(rf"{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{_DEEP_PARTS},}}")
"""A dotted key with this many parts is not one of ours, and the time to read it grows with their square."""
_Table = TypeVar("_Table", bound=msgspec.Struct)
SHIPPED = Path(configs.__file__).parent
_INTO_HTTP = ("page", "metrics", "foxglove")
"""Tables of 1.0 that are one table [http] now. A settings file with them is refused; a recording is read without them."""
_AUTOPILOT_DEFAULTS: dict[tuple[str, str], dict[str, Any]] = {
    ("guidance", "tries"): {"heading": "align"},
    ("estimator", "ekf"): {"sigma_attitude_bias_rad": math.radians(0.5), "asd_accel_bias_m_s3": 0.02},
}
"""Defaults that depend on the autopilot, by settings table. They hold where a settings file names no value.

A ship expects the nose on the arrow, and an autopilot's readings err otherwise than an AR.Drone's
(docs/decisions/filter-tilt.md#an-autopilots-bias-walks).
"""


def load(name_or_path: str | Path, *, by_autopilot: bool = False) -> Settings:
    """Return the settings in a file, or those of a shipped profile (`configs/*.toml`) by its bare name.

    The camera and pad files are read too, so that the result can be flown. In the result `camera.file` and `pad.file` name a
    shipped file or are paths relative to the working directory; so are those of keys and certificates.

    Args:
        by_autopilot: whether an autopilot will fly by them, whatever vehicle the file names: missing keys then have
            an autopilot's defaults.

    Raises:
        BadInput: the file cannot be read or is not TOML; a key is unknown, missing, of the wrong type or out of range; or a
            camera or pad file has such a fault. The text is one line that names the file and the key.
    """
    path = find_file(str(name_or_path), "", Path(), "settings")
    return complete(from_file(read_toml(path), str(path), by_autopilot=by_autopilot), path)


def complete(settings: Settings, path: Path) -> Settings:
    """Return settings that were read from a file with their references resolved, as `load` does.

    Args:
        path: the settings file, to whose folder the references are relative.

    Raises:
        BadInput: keys do not go together, or a file that the settings name is missing or has a fault.
    """
    if fault := settings.fault():
        raise BadInput(f"{path}: {fault}")
    camera = _reference(settings.camera.file, "cameras", path, "camera.file")
    pad = _reference(settings.pad.file, "pads", path, "pad.file")
    found = msgspec.structs.replace(settings.camera, file=camera)
    settings = msgspec.structs.replace(settings, camera=found, pad=PadSettings(pad))
    signing = [] if isinstance(settings.vehicle, ArDroneOptions) else ["signing_key_file", "signing_time_file"]
    settings = msgspec.structs.replace(
        settings,
        vehicle=_anchored(settings.vehicle, path.parent, signing),
        bridge=_anchored(settings.bridge, path.parent, ["signing_key_file", "signing_time_file"]),
        vision=_anchored(settings.vision, path.parent, ["learned_file"]),
        guidance=_anchored(settings.guidance, path.parent, ["policy_file"]),
        http=_anchored(settings.http, path.parent, ["token_file", "certificate_file", "key_file"]),
        mqtt=_anchored(
            settings.mqtt, path.parent, ["password_file", "ca_file", "certificate_file", "key_file", "command_key_file", "spool"]
        ),
    )
    follow = settings.guidance.follow_deck
    if not follow.response_by_vehicle:
        named = _reference(follow.response, "responses", path, "guidance.follow_deck.response")
        guidance = msgspec.structs.replace(settings.guidance, follow_deck=msgspec.structs.replace(follow, response=named))
        settings = msgspec.structs.replace(settings, guidance=guidance)
    camera_model(settings)
    pad_model(settings)
    response_model(settings)
    return settings


def from_file(data: Mapping[str, Any], where: str, *, by_autopilot: bool = False) -> Settings:
    """Return the settings that the mapping of a settings file describes, with the keys of experts in its table `expert`.

    Args:
        data: the mapping.
        where: name of the file, for errors.
        by_autopilot: as for `load`.

    Raises:
        BadInput: as for `load`, except that camera and pad files are not read. The keys are named as the file has them.
    """
    try:
        tables = joined(data)
    except BadInput as why:
        raise BadInput(f"{where}: {why}") from None
    try:
        return from_mapping(tables, where, by_autopilot=by_autopilot)
    except BadInput as why:
        output = str(why).removeprefix(f"{where}: ")
        key = output.partition(" ")[0].rstrip(":,")
        raise BadInput(f"{where}: {in_file(key)}{output[len(key) :]}") from why


def from_mapping(data: Mapping[str, Any], where: str, *, recorded: bool = False, by_autopilot: bool = False) -> Settings:
    """Return the settings that whole tables describe, those of experts among them.

    Args:
        data: the tables.
        where: name of their source, for errors.
        recorded: they are of a recording, which nobody can edit, so tables of 1.0 and a table `expert` are accepted.
        by_autopilot: as for `load`.

    Raises:
        BadInput: as for `load`, except that camera and pad files are not read.
    """
    try:
        if recorded:
            data = {name: table for name, table in joined(data, recorded=True).items() if name not in _INTO_HTTP}
        elif moved := [name for name in _INTO_HTTP if name in data]:
            raise BadInput(f"{moved[0]} is now a part of the table [http] (docs/page.md)")
        return msgspec.convert(_with_defaults_of_autopilot(data, by_autopilot), Settings, strict=True)
    except BadInput as why:
        raise BadInput(f"{where}: {why}") from None
    except msgspec.ValidationError as why:
        from companion.settings.refusal import explain  # it describes the whole model

        raise BadInput(f"{where}: {explain(Settings, data, str(why))}") from why


def _with_defaults_of_autopilot(data: Mapping[str, Any], by_autopilot: bool) -> Mapping[str, Any]:
    """Return the mapping with an autopilot's defaults for its missing keys; its own values win."""
    vehicle = data.get("vehicle")
    if not by_autopilot and (not isinstance(vehicle, Mapping) or vehicle.get("kind") != "mavlink"):
        return data
    for (name, part), values in _AUTOPILOT_DEFAULTS.items():
        table = data.get(name, {})
        given = table.get(part, {}) if isinstance(table, Mapping) else None
        if isinstance(given, Mapping):
            data = {**data, name: {**table, part: {**values, **given}}}
    return data


def camera_model(settings: Settings) -> Camera:
    """Return the camera that `settings.camera.file` names.

    Raises:
        BadInput: the file is missing or has a fault.
    """
    path = find_file(settings.camera.file, "cameras", Path(), "camera.file")
    return read_camera(path)


def read_camera(path: Path) -> Camera:
    """Return the camera of our own file, or of one of ROS, OpenCV or Kalibr.

    Raises:
        BadInput: it cannot be read, is none of them, or has a fault.
    """
    text = read_text(path)
    foreign = foreign_camera(text, path)
    return Camera.from_mapping(toml_of(text, path) if foreign is None else foreign, str(path))


def body_camera(settings: Settings) -> Camera:
    """Return the camera on the body; one on a gimbal as it is while that points straight down.

    Raises:
        BadInput: the file is missing or has a fault.
    """
    camera = camera_model(settings)
    return camera.held(DOWN) if settings.camera.gimbal.given else camera


def pad_model(settings: Settings) -> Pad:
    """Return the pad that `settings.pad.file` names.

    Raises:
        BadInput: the file is missing or has a fault, or vision cannot distinguish this pad from other things on decks.
    """
    path = find_file(settings.pad.file, "pads", Path(), "pad.file")
    return _pad_to_detect(read_text(path), path)


def pad_of_file(path: Path) -> Pad:
    """Return the pad of a file; the flights of one process share it.

    Raises:
        BadInput: the file is missing or has a fault.
    """
    return _pad(read_text(path), path)


@lru_cache(maxsize=16)
def _pad(text: str, path: Path) -> Pad:
    return Pad.from_mapping(toml_of(text, path), str(path))


@lru_cache(maxsize=16)
def _pad_to_detect(text: str, path: Path) -> Pad:
    pad = with_known_calibration(_pad(text, path))
    pad.check_for_detection(str(path))
    return pad


def with_known_calibration(pad: Pad) -> Pad:
    """Return a pad with the calibration that was kept for its drawing, if its file has none."""
    if pad.is_calibrated:
        return pad
    try:
        kept = msgspec.json.decode(calibration_file(pad).read_bytes(), type=Calibration)
    except (OSError, msgspec.DecodeError):
        return pad
    return replace(pad, calibration=kept) if kept.drawing == pad.fingerprint else pad


def calibration_file(pad: Pad) -> Path:
    """Return where the calibration of a drawing is kept: in the service's state, else in the user's cache."""
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    state = os.environ.get("STATE_DIRECTORY")
    return (Path(state.split(":")[0]) if state else Path(home) / "decklander") / "pads" / f"{pad.fingerprint}.json"


def response_model(settings: Settings) -> Response:
    """Return the vehicle's response that `settings.guidance.follow_deck.response` names, or that of the kind of vehicle.

    Raises:
        BadInput: the file is missing or has a fault.
    """
    o = settings.guidance.follow_deck
    by_kind = "autopilot" if isinstance(settings.vehicle, AutopilotOptions) else "ardrone2"
    named = by_kind if o.response_by_vehicle else o.response
    path = find_file(named, "responses", Path(), "guidance.follow_deck.response")
    return response_from_mapping(read_toml(path), str(path))


def shipped_response(name: str) -> Response:
    """Return a shipped response by its name.

    Raises:
        BadInput: there is none of that name.
    """
    path = find_file(name, "responses", Path(), "response")
    return response_from_mapping(read_toml(path), str(path))


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises:
        BadInput: the file cannot be read or is not TOML.
    """
    return toml_of(read_text(path), path)


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
        BadInput: the file cannot be read, is a device or a pipe, or is larger than any settings.
    """
    refuse_special(path, str(path))
    try:
        with path.open("rb") as file:  # files of the kernel say that they are empty, and are not
            content = file.read(LARGEST_BYTES + 1)
        if len(content) > LARGEST_BYTES:
            raise BadInput(f"{path}: more than {LARGEST_BYTES} bytes")
        return content.decode("utf-8")
    except OSError as why:
        raise unusable(str(path), why) from why
    except UnicodeDecodeError as why:
        raise BadInput(f"{path}: not UTF-8 text (byte {why.start})") from why


def toml_of(text: str, path: Path) -> dict[str, Any]:
    """Return the content of a TOML file by its text.

    Raises:
        BadInput: it is not TOML; the text names the path.
    """
    if _DEEP_KEY.search(text) is not None:
        raise BadInput(f"{path}: not valid TOML: a key of more than {_DEEP_PARTS} parts")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as why:  # a number of thousands of digits is a plain ValueError
        raise BadInput(f"{path}: not valid TOML: {why}") from why


def shipped(folder: str = "") -> list[str]:
    """Return the names of the shipped files of one kind: "" profiles, "cameras", "pads", "responses"."""
    return sorted(p.stem for p in (SHIPPED / folder).glob("*.toml"))


def _is_name(text: str) -> bool:
    return text.replace("_", "").replace("-", "").isalnum()


def find_file(text: str, folder: str, base: Path, what: str) -> Path:
    """Return the file that `text` means: a shipped one by its bare name (see `shipped`), or a path from `base`.

    Raises:
        BadInput: there is no such file; the text begins with `what` and names the nearest shipped one.
    """
    if _is_name(text) and text in shipped(folder):
        return SHIPPED / folder / f"{text}.toml"
    try:
        path = base / text
        exists = path.exists()
    except OSError as why:
        raise unusable(f"{what}: not a usable file name {text[:60]!r}", why) from why
    except ValueError as why:
        raise BadInput(f"{what}: not a usable file name {text[:60]!r}: {why}") from why
    if exists and text:
        return path
    near = difflib.get_close_matches(text, shipped(folder), n=1)
    hint = f"did you mean {near[0]!r}" if near else f"shipped ones are {', '.join(shipped(folder))}"
    raise BadInput(f"{what}: there is no file {str(path) if text else text!r} and no shipped one of that name ({hint})")


def _anchored(table: _Table, base: Path, keys: Iterable[str]) -> _Table:
    """Return the table with the relative paths in `keys` made relative to the working directory.

    Args:
        table: a table of the settings.
        base: folder of the settings file, to which the paths are relative.
        keys: names of the keys that hold paths.
    """
    given = {key: str(getattr(table, key)) for key in keys}
    return msgspec.structs.replace(
        table, **{key: str(base / path) for key, path in given.items() if path and not path.startswith(CREDENTIAL)}
    )


def _reference(text: str, folder: str, settings_file: Path, keypath: str) -> str:
    found = find_file(text, folder, settings_file.parent, f"{settings_file}: {keypath}")
    return text if found.parent == SHIPPED / folder and _is_name(text) else str(found)
