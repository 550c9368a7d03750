"""Read images of ROS 2, sensor_msgs/Image and CompressedImage, and a topic of them as a camera, in a process of its own.

A frame's time is that of its header, which is Unix time by the camera's computer; where that cannot be, the arrival counts.
"""

import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import camera_program as wire
from drivers.camera.images import ImageRefused, decode
from drivers.camera.options import Size
from drivers.ros2 import open_node, typestore
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.time import NS_PER_S

_POLL_S = 0.003
"""Time between two looks for images, s: the two middlewares share no wait. It takes 2 % of a core of this process, and a frame
has its message's own time.
"""
_SAME = 0.02
"""Largest difference of the focal lengths and the principal point from the camera file's, of the focal length."""
_PLACES = (0, 4, 2, 5)
"""The places of fx, fy, cx, cy in a matrix row by row."""
_COLOURS: Final[Mapping[str, tuple[int, type, int | None]]] = {
    "bgr8": (3, np.uint8, None), "rgb8": (3, np.uint8, cv2.COLOR_RGB2BGR), "mono8": (1, np.uint8, cv2.COLOR_GRAY2BGR),
    "8UC1": (1, np.uint8, cv2.COLOR_GRAY2BGR), "8UC3": (3, np.uint8, None), "bgra8": (4, np.uint8, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, np.uint8, cv2.COLOR_RGBA2BGR), "mono16": (1, np.uint16, cv2.COLOR_GRAY2BGR),
    "16UC1": (1, np.uint16, cv2.COLOR_GRAY2BGR), "yuv422": (2, np.uint8, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (2, np.uint8, cv2.COLOR_YUV2BGR_YUYV), "bayer_rggb8": (1, np.uint8, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, np.uint8, cv2.COLOR_BayerBGGR2BGR), "bayer_gbrg8": (1, np.uint8, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, np.uint8, cv2.COLOR_BayerGRBG2BGR),
}  # fmt: skip
"""Values of a pixel, their type and the conversion, by the encoding's name in sensor_msgs/image_encodings."""
_WHITE_16 = 257.0  # factor from eight to sixteen bits of white


def image_px(message: Any, size: Size | None = None) -> NDArray[np.uint8]:
    """Return (H, W, 3) BGR of a message.

    Args:
        size: width and height that it must have; None allows any.

    Raises:
        ImageRefused: it is torn, of another size, or of an encoding that is not read.
    """
    if message.__msgtype__.endswith("CompressedImage"):
        return decode(np.asarray(message.data, np.uint8).tobytes(), size)
    if message.encoding not in _COLOURS:
        raise ImageRefused(f"the encoding {message.encoding[:40]!r} is not read")
    channels, kind, conversion = _COLOURS[message.encoding]
    item = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    width, height, step = int(message.width), int(message.height), int(message.step)
    if size not in (None, (width, height)):
        raise ImageRefused(f"{width}x{height} px, expected {size[0]}x{size[1]} px")
    if not 0 < width * channels * item.itemsize <= step or not 0 < step * height <= len(message.data):
        raise ImageRefused(f"{width}x{height} px in lines of {step} bytes do not fit {len(message.data)} bytes")
    lines = np.asarray(message.data, np.uint8)[: step * height].reshape(height, step)[:, : width * channels * item.itemsize]
    px = np.ascontiguousarray(lines).view(item).reshape(height, width, channels)
    if item.itemsize == 2:
        px = np.rint(px / _WHITE_16).astype(np.uint8)
    try:
        return np.ascontiguousarray(px if conversion is None else cv2.cvtColor(px, conversion), np.uint8)
    except cv2.error as why:
        raise ImageRefused(f"{width}x{height} px cannot be of {message.encoding}") from why


def capture(send: Callable[..., None], request: Mapping[str, Any], size: Size) -> int:
    """Read a topic until the reader is gone; return the exit code.

    Args:
        send: sends a message of `camera_program`.
        request: the `topic`, and the `lens` that its camera_info must have.
    """
    topic, info = request["topic"], "sensor_msgs/msg/CameraInfo"
    kind = "sensor_msgs/msg/" + ("CompressedImage" if topic.endswith("/compressed") else "Image")
    about = topic.removesuffix("/compressed").rpartition("/")[0] + "/camera_info"
    store, number = typestore(), 0
    try:
        node = open_node("decklander_camera")
        images, infos = (node.reader(name, of, reliable=False) for name, of in ((topic, kind), (about, info)))
        send(wire.READY)
        while True:
            for cdr, _ in infos():
                if fault := _other_lens(_decoded(store, cdr, info), request["lens"], size):
                    raise Recoverable(f"{about} is of another camera than camera.file: {fault}")
            messages = images()
            number += len(messages)
            for cdr, _ in messages[-1:]:
                try:
                    message = _decoded(store, cdr, kind)
                    px = image_px(message, size)
                except ImageRefused as why:
                    send(wire.DAMAGED, str(why).encode()[: wire.MOST_TEXT])
                    continue
                at = message.header.stamp
                unix_ns = at.sec * NS_PER_S + at.nanosec
                stamp = unix_ns - time.time_ns() + time.monotonic_ns() if unix_ns else wire.UNKNOWN
                send(wire.FRAME, px.data.cast("B"), stamp, number)
            if not messages:
                time.sleep(_POLL_S)
    except (BadInput, Recoverable) as why:
        send(wire.FAULT, str(why).encode()[: wire.MOST_TEXT])
        return wire.WRONG_SETTINGS if isinstance(why, BadInput) else 1


def _decoded(store: Any, cdr: bytes, kind: str) -> Any:
    try:
        return store.deserialize_cdr(cdr, kind)
    except Exception as why:  # the bytes may come from anywhere, and the library raises whatever its parsing stumbles over
        raise ImageRefused("no message of its type") from why


def _other_lens(info: Any, lens: list[float] | None, size: Size) -> str:
    """Return how a camera_info differs from the camera file; nothing of one that is not calibrated."""
    found = [float(info.k[place]) for place in _PLACES]
    if lens is None or not found[0]:
        return ""
    same = all(abs(a - b) <= _SAME * lens[0] for a, b in zip(found, lens, strict=True))
    if same and (info.width, info.height) == size:
        return ""
    theirs, ours = (", ".join(f"{value:.1f}" for value in of) for of in (found, lens))
    return f"{info.width}x{info.height} px, fx, fy, cx, cy = {theirs} for {size[0]}x{size[1]} px and {ours}"
