"""A stand-in of picamera2 0.3.38 with a sensor behind it, written from its documented interface.

The environment's STAND_IN is JSON of what differs from one IMX219: `models`, `busy`, `asleep_s` (the computer has slept so long,
and stamps count it), `light` (of the paint; 1 is right after 1 ms with gain 1).
"""

import json
import os
import time
from contextlib import contextmanager

import numpy as np

WORLD = {"models": ["imx219"], "busy": False, "asleep_s": 0.0, "light": 0.1} | json.loads(os.environ.get("STAND_IN", "{}"))
ROW_S, ROWS, LATENCY = 18.9e-6, 1232, 3
"""Time of a row, rows of the mode, and frames from a setting to the frame that shows it."""
_clock = time.clock_gettime_ns


def _slept(clock_id):
    return _clock(clock_id) + (round(1e9 * WORLD["asleep_s"]) if clock_id == time.CLOCK_BOOTTIME else 0)


time.clock_gettime_ns = _slept


class Picamera2:
    """One camera."""

    @staticmethod
    def global_camera_info():
        return [
            {"Model": model, "Location": 2, "Rotation": 180, "Id": f"/base/soc/i2c0mux/i2c@{n}/{model}@10", "Num": n}
            for n, model in enumerate(WORLD["models"])
        ] + [{"Model": "UVC Camera", "Id": "/base/scb/usb1-1", "Num": 9}]

    def __init__(self, camera_num=0, verbose_console=None, tuning=None, allocator=None):
        if WORLD["busy"]:
            try:
                raise RuntimeError("Failed to acquire camera: Device or resource busy")
            except RuntimeError as why:
                raise RuntimeError("Camera __init__ sequence did not complete.") from why
        self.camera_properties = {"Model": WORLD["models"][camera_num]}
        self.camera_controls = {
            "ExposureTime": (75, 11766829, 20000), "AnalogueGain": (1.0, 10.67, 1.0), "AeEnable": (False, True, True),
            "AwbMode": (0, 7, 0), "FrameDurationLimits": (11971, 11767556, 33333),
        }  # fmt: skip
        self._taken, self._config = -1, None

    @property
    def sensor_modes(self):
        return [
            {"format": "SRGGB10", "bit_depth": 10, "size": (640, 480), "fps": 206.65, "crop_limits": (1000, 752, 1280, 960)},
            {"format": "SRGGB10", "bit_depth": 10, "size": (1640, 1232), "fps": 41.85, "crop_limits": (0, 0, 3280, 2464)},
            {"format": "SRGGB10", "bit_depth": 10, "size": (3280, 2464), "fps": 21.19, "crop_limits": (0, 0, 3280, 2464)},
            {"format": "YUYV"},
        ]

    def create_video_configuration(
        self, main=None, lores=None, raw=None, transform=None, colour_space=None, buffer_count=6, controls=None, display="main",
        encode="main", queue=True, sensor=None, use_case="video",
    ):  # fmt: skip
        return {"main": main, "controls": controls, "display": display, "encode": encode, "sensor": sensor}

    def configure(self, camera_config=None):
        width, height = camera_config["main"]["size"]
        assert (width % 2, height % 2) == (0, 0), "width and height should be even"
        stride = -(-3 * width // 64) * 64
        self._config = {**camera_config["main"], "stride": stride, "framesize": stride * height}
        self._mode = camera_config["sensor"]["output_size"]
        self._settings = [(0, {"ExposureTime": 20000, "AnalogueGain": 1.0})]
        self.set_controls(camera_config["controls"])

    def stream_configuration(self, name="main"):
        return {"main": self._config}[name]

    def start(self, config=None, show_preview=False):
        self._began_ns = _clock(time.CLOCK_MONOTONIC)

    def set_controls(self, controls):
        for name in controls:
            if name not in self.camera_controls:
                raise RuntimeError(f"Control {name} is not advertised by libcamera")
        if "FrameDurationLimits" in controls:
            self._frame_ns = 1000 * controls["FrameDurationLimits"][0]
        after = self._taken + LATENCY if self._taken >= 0 else 0
        self._settings.append((after, {**self._settings[-1][1], **controls}))

    @contextmanager
    def captured_request(self, wait=None, flush=None):
        now = _clock(time.CLOCK_MONOTONIC)
        self._taken = max(self._taken + 1, (now - self._began_ns) // self._frame_ns)
        stamp = self._began_ns + self._taken * self._frame_ns
        held = [settings for number, settings in self._settings if number <= self._taken][-1]
        yield CompletedRequest((self._taken, stamp, held, self._mode, self._config), self)


class CompletedRequest:
    """One frame, read out now: its rows are there when the last one is."""

    def __init__(self, request, picam2):
        self.sequence, self._stamp, held, self._mode, self.config = request
        self.request = self
        exposure_s = max(1, round(1e-6 * held["ExposureTime"] / ROW_S)) * ROW_S
        gain = 256 / (256 - min(232, round(256 - 256 / held["AnalogueGain"])))
        self._metadata = {
            "SensorTimestamp": self._stamp + round(1e9 * WORLD["asleep_s"]),
            "ExposureTime": int(1e6 * exposure_s), "AnalogueGain": gain,
        }  # fmt: skip
        light = np.clip(WORLD["light"] * 1e3 * exposure_s * gain, 0.0, 1.0)
        self.grey = round(255 * float(1.055 * light ** (1 / 2.4) - 0.055 if light > 0.0031 else 12.92 * light))
        readout_ns = round(1e9 * ROW_S * ROWS)
        self.middle_ns = self._stamp - round(5e8 * exposure_s) + readout_ns // 2
        time.sleep(max(0.0, 1e-9 * (self._stamp + readout_ns - _clock(time.CLOCK_MONOTONIC))))

    def get_metadata(self):
        return self._metadata


class MappedArray:
    """The frame's buffer: its rows in B, G, R; the first begins with the true mid-exposure, the next with the mode."""

    def __init__(self, request, stream, reshape=True, write=True):
        config = request.config
        (width, height), stride = config["size"], config["stride"]
        rows = np.full((height, stride), 99, np.uint8)
        rows[:, : 3 * width] = np.tile(np.array([request.grey // 2, request.grey, request.grey // 3], np.uint8), width)
        rows[0, :8] = np.frombuffer(np.int64(request.middle_ns).tobytes(), np.uint8)
        rows[1, :8] = np.frombuffer(np.array(request._mode, np.int32).tobytes(), np.uint8)
        self.array = rows.reshape(-1)

    def __enter__(self):
        return self

    def __exit__(self, exc_type, exc_value, exc_traceback):
        pass
