"""Settings of other landing programs as ours, and what was not taken of them.

Sources: goodrobots/vision_landing, vision_landing.conf; rmackay9/blueos-precision-landing, settings.py;
Wingxtra-Aerospace/wingxtra-de-precision-landing, config.py.
"""

import configparser
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from companion.settings.load import complete, from_file, read_camera, read_text, write_whole
from companion.tools.tag_pad import FAMILY, fiducial, file_text, painted
from estimator.contracts.errors import BadInput, file_errors, refused
from estimator.vision.pad.fiducial import PaintedFiducial
from estimator.vision.pad.pad import Pad

_WHY = {
    "width height": "the camera file has the size of the frames",
    "output fourcc colormap": "the page and [video_stream] show the picture",
    "brightness": "camera.controls and [camera.exposure] set it",
    "fakerangefinder": "landing_target.ranges sends DISTANCE_SENSOR",
    "markerhistory markerthreshold quality": "each frame is judged by its covariance",
    "estimator": "PLND_EST_TYPE of the autopilot has it",
    "simulator controlprocessing precision_landing startup_mode": "guidance.start has it, and no setting arms a vehicle",
    "logdir verbose": "[recorder] keeps every flight",
    "horizontal_fov image_correction": "decklander calibrate camera measures the lens",
    "mount gimbal mode": "the camera file has the mount, and [camera.gimbal] a gimbal",
}
"""Reasons why keys of others are not taken, by the keys."""
_STOP = "two programs must not send LANDING_TARGET: remove the other extension"


class Imported(Struct):
    """Settings that were read, and sentences about those that were not."""

    link: str
    source: str
    device: str
    remarks: list[str]
    rate_hz: float = 30.0
    system_id: int = 0
    camera_file: str = "usb_640x480"
    tag: PaintedFiducial | None = None


def write(path: Path, out: Path, tag_m: float | None) -> list[str]:
    """Write the settings of another program's file as ours, with a pad file beside them; return what was not taken.

    Args:
        path: vision_landing.conf, or the JSON of an extension of BlueOS.
        out: settings file that is written (.toml).
        tag_m: side of the tag's dark square, metres, where the file does not say it.

    Raises:
        BadInput: it is none of these, a value is none, or a file is there already.
    """
    pad_file, text = out.with_suffix(".pad.toml"), read_text(path)
    if pad_file.exists():
        raise BadInput(f"--out {out}: {pad_file}, which it would be written with, is there already")
    with refused(
        f"{path}: no settings that are read",
        msgspec.MsgspecError,
        configparser.Error,
        KeyError,
        TypeError,
        ValueError,
        RecursionError,
    ):
        read = _of_blueos if path.suffix.lower() == ".json" else _of_vision_landing
        found = read(text, path, tag_m)
    files = {}
    if found.tag is not None:
        board = painted([found.tag], out.stem, str(path), None, found.remarks)
        files[pad_file] = file_text(board.keys, f"Made of {path.name} by decklander config import.")
        Pad.from_mapping(tomllib.loads(files[pad_file]), str(path))
    tables: dict[str, dict[str, object]] = {
        "vehicle": {"kind": "mavlink", "links": found.link, "system_id": found.system_id},
        "camera": {"file": found.camera_file, "source": found.source, "device": found.device, "rate_hz": found.rate_hz},
        "pad": {"file": pad_file.name if files else "thesis"},
        "vision": {"colours": "outdoor"},
        "guidance": {"start": "signal"},
    }
    settings = from_file(tables, str(path))
    lines = (
        f"\n[{name}]\n" + "".join(f"{k} = {msgspec.json.encode(v).decode()}\n" for k, v in t.items())
        for name, t in tables.items()
    )
    files[out] = f"# Made of {path.name} by decklander config import. Every key: docs/configuration.md.\n" + "".join(lines)
    with file_errors(str(out)):
        for file, content in files.items():
            write_whole(file, content)
    try:
        complete(settings, out)
    except BadInput:
        for file in files:
            file.unlink()
        raise
    return found.remarks


def _left(keys: Iterable[str], taken: str) -> list[str]:
    """Return a sentence for each key that is not taken."""
    why = {key: why for keys, why in _WHY.items() for key in keys.split()}
    return [f"{key} is not taken: {why.get(key, 'it has no counterpart')}" for key in keys if key not in taken.split()]


def _of_blueos(text: str, path: Path, tag_m: float | None) -> Imported:
    data = msgspec.json.decode(text, type=dict[str, dict[str, Any] | Any])
    if "output" in data:
        camera, link = data["camera"], data["output"]
        source = {"rtsp": "stream", "mjpeg": "stream", "v4l2": "v4l2", "picamera2": "libcamera"}[camera["kind"]]
        device = "" if source == "libcamera" else camera["source"]
        remarks = [_STOP, "the board is in landing-target.json: decklander pad import makes a pad file of it, for pad.file"]
        remarks += _left([*data, *camera], "camera output schema_version kind source fps")
        to = f"udpin://{link['listen_host']}:{link['listen_port']}"
        return Imported(to, source, device, remarks, float(camera["fps"]), link["target_system"])
    seen, tag, number = data["last_used"], data.get("apriltag", {}), data.get("apriltag", {}).get("target_id", -1)
    remarks = [_STOP, "MAVLink: by BlueOS' own router, as configs/compose/blueos.toml has it"]
    system_id = data.get("mavlink", {}).get("sysid", 0)
    found = Imported("tcp://127.0.0.1:5777", "stream", seen["rtsp"], remarks, system_id=system_id)
    if number < 0 or tag_m is None:
        remarks.append("apriltag is not taken: a pad is one tag of known size: set its target_id, and give --tag-mm")
    else:
        found.tag = fiducial(tag.get("family", FAMILY), number, tag_m, f"{path}: apriltag", turn_deg=180.0)
    remarks += _left([*data, *seen], "rtsp camera_type cameras last_used apriltag mavlink")
    return found


def _of_vision_landing(text: str, path: Path, tag_m: float | None) -> Imported:
    parser = configparser.ConfigParser(interpolation=None, inline_comment_prefixes=("#", ";"))
    parser.read_string(text)
    keys, remarks = dict(parser["Defaults"]), list[str]()
    device = keys.get("input", "/dev/video0").strip("'\"")
    if not device.startswith("/dev/"):
        remarks.append(f"input {device!r} is not taken: write a pipeline up to raw frames by hand")
        device = "/dev/video0"
    found = Imported(_link(keys["connect"], path), "v4l2", device, remarks, float(keys.get("fps", "30")))
    sizes = {
        int(i): float(m) for i, _, m in (part.partition(":") for part in keys.get("sizemapping", "").split(",") if part.strip())
    }
    number = int(keys.get("markerid", max(sizes, key=lambda i: sizes[i], default=-1)))
    if number < 0:
        remarks.append("markersize is not taken: a pad is one tag of known id: write its markerid")
    else:
        kind, size_m = keys.get("markerdict", "ARUCO_MIP_36h12"), tag_m or sizes.get(number) or float(keys["markersize"])
        found.tag = fiducial({"ARUCO": "aruco_original"}.get(kind, kind), number, size_m, f"{path}: marker {number}")
        remarks.append("the arrow is up in OpenCV's drawing of the tag: look with pad check --picture")
    if rest := sorted(set(sizes) - {number}):
        remarks.append(f"sizemapping of {rest} is not taken: it does not say where they lie: measure, and add [[regions]]")
    places = [path.parent / folder / keys.get("calibration", "") for folder in ("calibration", "")]
    if there := next((place for place in places if place.is_file()), None):
        read_camera(there)
        found.camera_file = str(there.absolute())
    else:
        remarks.append("calibration is not taken: there is no such file: decklander calibrate camera")
    remarks += _left(keys, "connect markersize sizemapping markerdict markerid fps calibration input")
    return found


def _link(text: str, path: Path) -> str:
    """Return our link for one of DroneKit's, which listens on UDP unless it is udpout; 115200 baud is its default."""
    kind, _, rest = text.partition(":")
    if text.startswith("/dev/"):
        device, _, baud = text.partition(",")
        return f"serial://{device}:{baud or 115200}"
    if kind in ("tcp", "udp", "udpin", "udpout") and re.fullmatch(r"[\w.-]+:\d+", rest):
        return f"{'udpin' if kind == 'udp' else kind}://{rest}"
    raise BadInput(f"{path}: connect {text!r} is not read: tcp:HOST:PORT, udp:HOST:PORT and /dev/NAME are")
