"""Read a camera by a library of the system's Python, and write its frames to standard output, apart from the service.

    python3 -I camera_program.py PARENT WIDTH HEIGHT gstreamer PIPELINE
    python3 -I camera_program.py PARENT WIDTH HEIGHT libcamera JSON
    python3 -P -m drivers.camera.camera_program PARENT WIDTH HEIGHT ros2 JSON

A vendor's camera stack that crashes or hangs ends this process and no other. GStreamer's bindings (PyGObject) and picamera2 come
with the system's Python, so this file runs under that one, whatever environment the service lives in: it needs no other module,
and nothing newer than Python 3.8. A topic of ROS 2 is read by `drivers.camera.ros2`, under the service's own Python.

Wire format: `HEADER` (little-endian magic, length of what follows, stamp, sequence number, exposure time, gain), then for `FRAME`
the rows of a BGR image, all with the same padding, for `FAULT` and `DAMAGED` (an image that is not used) a line of text in UTF-8,
for `READY` nothing or JSON of what the camera is. The stamp is of CLOCK_MONOTONIC in ns; stamp and number are `UNKNOWN`, time (s)
and gain 0, where they are not known. Lines "EXPOSURE_US GAIN" on standard input set the exposure of libcamera. Source of times
and numbers: GStreamer's design documents "Clocks" (clock time is base time plus running time) and "GstBuffer" (offset of live
video is its frame number), and libcamera's control_ids_core.yaml.
"""

from __future__ import annotations

import ctypes
import functools
import importlib
import json
import os
import select
import signal
import struct
import sys
import time
from typing import Any

HEADER = struct.Struct("<4sIqqff")
READY, FRAME, FAULT, DAMAGED = b"DLok", b"DLfr", b"DLno", b"DLbd"
UNKNOWN = -1
"""Stamp or number of a frame that has none."""
NO_BINDINGS = 3
"""Exit code: this Python cannot load the library."""
WRONG_SETTINGS = 4
"""Exit code: the library cannot build what the settings describe."""
NO_CAMERA = 5
"""Exit code: there is no such camera at the moment."""
MOST_TEXT = 2000
"""Largest length of a fault's text, bytes."""

_PR_SET_PDEATHSIG = 1  # request to Linux for a signal when the parent process ends (prctl.h)
_POLL_NS = 100_000_000  # longest wait for a frame before errors are checked
_MANUAL = 0  # AfModeManual of libcamera
_DAYLIGHT = 5
"""AwbDaylight of libcamera."""
_FIRST_US = 5000
"""Exposure time with which a driven camera begins."""


def stride_of(width: int) -> int:
    """Return the bytes from one row of a BGR image to the next: GStreamer pads rows to a multiple of 4."""
    return (3 * width + 3) & ~3


def main(words: list[str]) -> int:
    """Run the pipeline until it ends or the reader is gone; return the exit code."""
    parent, width, height, library, text = int(words[0]), int(words[1]), int(words[2]), words[3], words[4]
    # Plug-ins print to standard output, which carries frames here.
    out = os.dup(1)
    os.dup2(2, 1)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        return 0
    try:
        if library == "libcamera":
            picamera2: Any = importlib.import_module("picamera2")
        elif library == "ros2":
            ros2: Any = importlib.import_module("drivers.camera.ros2")
        else:
            gi = importlib.import_module("gi")
            gi.require_version("Gst", "1.0")
            gst: Any = importlib.import_module("gi.repository.Gst")
            gst.init(None)
    except (ImportError, ValueError) as why:
        _send(out, FAULT, str(why).encode()[:MOST_TEXT])
        return NO_BINDINGS
    try:
        if library == "libcamera":
            return _capture(picamera2, out, json.loads(text), (width, height))
        if library == "ros2":
            return int(ros2.capture(functools.partial(_send, out), json.loads(text), (width, height)))
        return _play(gst, out, text, width, height)
    except BrokenPipeError:
        return 0
    except _Refused as why:
        _send(out, FAULT, why.args[1].encode()[:MOST_TEXT])
        return int(why.args[0])


class _Refused(Exception):
    """An exit code, and the reason in words."""


def _play(gst: Any, out: int, description: str, width: int, height: int) -> int:
    caps = f"video/x-raw,format=BGR,width={width},height={height}"
    # Of frames that were not taken in time only the newest is kept.
    newest = "queue leaky=downstream max-size-buffers=1"
    ending = f"{newest} ! videoconvert ! {caps} ! appsink name=frames max-buffers=1 drop=true sync=false"
    try:
        pipeline = gst.parse_launch(f"{description} ! {ending}")
        # Stamps are then those of CLOCK_MONOTONIC, whatever clock the pipeline's elements would have offered.
        clock = gst.SystemClock.obtain()
        clock.set_property("clock-type", gst.ClockType.MONOTONIC)
        pipeline.use_clock(clock)
        sink = pipeline.get_by_name("frames")
    except Exception as why:  # GLib.Error of what cannot be parsed, TypeError of what is no pipeline
        _send(out, FAULT, str(getattr(why, "message", why)).encode()[:MOST_TEXT])
        return WRONG_SETTINGS
    _send(out, READY)
    bus = pipeline.get_bus()
    pipeline.set_state(gst.State.PLAYING)
    size = stride_of(width) * height
    while True:
        sample = sink.emit("try-pull-sample", _POLL_NS)
        if sample is not None:
            if (fields := sample.get_caps().get_structure(0).get_string("interlace-mode")) not in (None, "progressive"):
                _send(out, FAULT, f"{_OF_FIELDS} (interlace-mode={fields})".encode())
                pipeline.set_state(gst.State.NULL)
                return 0
            _send_frame(gst, out, sample.get_buffer(), pipeline.get_base_time(), size)
        message = bus.pop_filtered(gst.MessageType.ERROR | gst.MessageType.EOS)
        if message is not None:
            _send(out, FAULT, _words(gst, message, width, height).encode()[:MOST_TEXT])
            pipeline.set_state(gst.State.NULL)
            return 0


_OF_FIELDS = (
    "its pictures are interlaced, and the lines of each are of two instants: set the source to progressive, or put "
    "`deinterlace fields=top` into the pipeline"
)


def _send_frame(gst: Any, out: int, buffer: Any, base_ns: int, size: int) -> None:
    good, content = buffer.map(gst.MapFlags.READ)
    if not good:
        return
    try:
        stamp = UNKNOWN if buffer.pts == gst.CLOCK_TIME_NONE else base_ns + buffer.pts
        number = UNKNOWN if buffer.offset >= 1 << 63 else buffer.offset
        if content.size == size:
            _send(out, FRAME, content.data, stamp, number)
    finally:
        buffer.unmap(content)


def _words(gst: Any, message: Any, width: int, height: int) -> str:
    if message.type == gst.MessageType.EOS:
        return "the pipeline came to its end"
    error, detail = message.parse_error()
    if "not-negotiated" in (detail or "") or "not-linked" in (detail or ""):
        return f"{message.src.get_name()}: gives no frames of {width}x{height} px (the camera file's) that can be made BGR"
    return f"{message.src.get_name()}: {error.message}"


_GLOBAL_SHUTTERS = ("imx296", "ov2311", "ov7251", "ov9281", "ov9282")
"""Sensors whose rows are all exposed at the same time, as libcamera names them."""


def _capture(picamera2: Any, out: int, o: dict[str, Any], size: tuple[int, int]) -> int:
    """Read a CSI camera until the reader is gone; return the exit code. `o` is what the service's `libcamera_request` gives."""
    try:
        there = [one for one in picamera2.Picamera2.global_camera_info() if "/usb" not in one["Id"]]
        if o.get("list"):
            _send(out, READY, json.dumps([one["Model"] for one in there]).encode())
            return 0
        camera = picamera2.Picamera2(_chosen(there, o["camera"]))
        mode = _mode(camera.sensor_modes, o["rate_hz"])
        frame_us = round(1e6 / o["rate_hz"])
        controls = _controls(camera.camera_controls, o)
        controls["FrameDurationLimits"] = (frame_us, frame_us)
        # In this order of bytes, which libcamera names the other way round, the image processor gives what the detectors take.
        main = {"size": size, "format": "RGB888"}
        sensor = {"output_size": mode["size"], "bit_depth": mode["bit_depth"]}
        camera.configure(
            camera.create_video_configuration(main=main, sensor=sensor, controls=controls, display=None, encode=None)
        )
        given, stride = camera.stream_configuration("main"), camera.stream_configuration("main")["stride"]
        if (tuple(given["size"]), given["format"]) != (size, "RGB888"):
            raise _Refused(WRONG_SETTINGS, "libcamera gives {}x{} px in place of {}x{}".format(*given["size"], *size))
        model = camera.camera_properties.get("Model", "")
        readout_s = 0.0 if model in _GLOBAL_SHUTTERS else 1.0 / mode["fps"]
        can = {name: camera.camera_controls[name][:2] for name in ("ExposureTime", "AnalogueGain") if o["driven"]}
        about = {"model": model, "mode": mode["size"], "readout_s": readout_s, **can}
        camera.start()
        _send(out, READY, json.dumps(about).encode())
        while True:
            wanted = _wanted()
            if wanted is not None:
                camera.set_controls({"ExposureTime": wanted[0], "AnalogueGain": wanted[1]})
            # The newest complete frame, or the next one.
            with camera.captured_request() as request:
                data = request.get_metadata()
                with picamera2.MappedArray(request, "main", reshape=False, write=False) as mapped:
                    pixels = memoryview(mapped.array)[: stride * size[1]]
                    stamp = _monotonic(data.get("SensorTimestamp"))
                    exposure_s, gain = 1e-6 * data.get("ExposureTime", 0), data.get("AnalogueGain", 0.0)
                    _send(out, FRAME, pixels, stamp, request.request.sequence, exposure_s, gain)
    except (_Refused, BrokenPipeError):
        raise
    except Exception as why:  # picamera2 raises RuntimeError from RuntimeError; libcamera what its C++ threw
        raise _Refused(1, _reasons(why)) from why


def _chosen(there: list[Any], name: str) -> int:
    """Return the number of the camera that is meant by its number, by a part of its model or path, or by nothing."""
    known = ", ".join(f"{n} {one['Model']} {one['Id']}" for n, one in enumerate(there)) or "none at all"
    named = [
        n for n, one in enumerate(there) if name == str(n) or (not name.isdigit() and name in one["Model"] + " " + one["Id"])
    ]
    if not named:
        raise _Refused(NO_CAMERA, f"no CSI camera {name!r}; libcamera lists {known}")
    if len(named) > 1:
        raise _Refused(WRONG_SETTINGS, f"camera {name!r} may be any of {known}; give more of its name, or its number")
    return named[0]


def _mode(modes: list[Any], rate_hz: float) -> Any:
    """Return the mode that is fast enough and sees most of the sensor, with the fewest pixels: those are read out sooner."""
    fast = [mode for mode in modes if mode.get("fps", 0.0) >= 0.99 * rate_hz]
    if not fast:
        known = ", ".join("{}x{} at {:g} Hz".format(*mode["size"], mode["fps"]) for mode in modes if "fps" in mode)
        raise _Refused(
            WRONG_SETTINGS, "the sensor has no mode of {:g} Hz; it has {}".format(rate_hz, known or "none that is raw")
        )
    return min(fast, key=lambda m: (-m["crop_limits"][2] * m["crop_limits"][3], m["size"][0] * m["size"][1], -m["bit_depth"]))


def _controls(has: dict[str, Any], o: dict[str, Any]) -> dict[str, Any]:
    """Return the controls to begin with: the given ones, and the fixed lens, exposure and white balance behind them."""
    out: dict[str, Any] = {}
    if "LensPosition" in has:  # a lens that refocuses changes its focal length; the default is the hyperfocal distance
        out.update({"AfMode": _MANUAL, "LensPosition": has["LensPosition"][2]})
    if o["exposure_s"] > 0.0:
        out["ExposureTime"] = round(1e6 * o["exposure_s"])
    if o["driven"]:
        if "ExposureTime" not in has or "AnalogueGain" not in has:
            raise _Refused(WRONG_SETTINGS, "its exposure cannot be driven: it has no ExposureTime or no AnalogueGain")
        shortest, longest = has["ExposureTime"][:2]
        first = out.get("ExposureTime") or min(max(_FIRST_US, shortest), longest)
        out.update({"AeEnable": False, "ExposureTime": first, "AnalogueGain": float(has["AnalogueGain"][0])})
        kelvin = {"AwbEnable": False, "ColourTemperature": o["white_balance_k"]}
        out.update(kelvin if "ColourTemperature" in has else {"AwbMode": _DAYLIGHT} if "AwbMode" in has else {})
    out.update(o["controls"])
    for name in out:
        if name not in has:
            known = ", ".join(sorted(has))
            raise _Refused(WRONG_SETTINGS, f"the camera has no control {name}; it has {known}")
    return out


def _wanted() -> tuple[int, float] | None:
    """Return the newest exposure that was sent, us and gain; None if none was."""
    lines = b""
    while select.select([0], [], [], 0.0)[0]:
        piece = os.read(0, 4096)
        if not piece:
            break
        lines += piece
    words = lines.split()
    return (int(words[-2]), float(words[-1])) if len(words) > 1 else None


def _monotonic(stamp: int | None) -> int:
    """Return a SensorTimestamp in CLOCK_MONOTONIC, ns.

    libcamera defines CLOCK_BOOTTIME, which has counted the computer's sleep; its pipeline for the Pi passes the kernel's own
    CLOCK_MONOTONIC on. Of these the first is ahead of the present by that sleep.
    """
    if stamp is None:
        return UNKNOWN
    now = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    return stamp if stamp <= now else stamp - (time.clock_gettime_ns(time.CLOCK_BOOTTIME) - now)


def _reasons(why: BaseException | None) -> str:
    """Return an error and its causes; the innermost names the reason, as that another program holds the camera."""
    out = []
    while why is not None:
        out.append(str(why).rstrip(". "))
        why = why.__cause__ or why.__context__
    busy = " (another program holds the camera: rpicam-apps, a streaming service)" if "busy" in out[-1].lower() else ""
    return ": ".join(out) + busy


def _send(
    out: int,
    magic: bytes,
    content: Any = b"",
    stamp: int = UNKNOWN,
    number: int = UNKNOWN,
    exposure_s: float = 0.0,
    gain: float = 0.0,
) -> None:
    for part in (HEADER.pack(magic, len(content), stamp, number, exposure_s, gain), content):
        left = memoryview(part)
        while left:
            left = left[os.write(out, left) :]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
