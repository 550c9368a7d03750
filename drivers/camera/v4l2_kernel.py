"""The kernel's calls for video capture: the structs that a camera needs, and one function for each call.

Source: Linux media documentation, Video for Linux API (Part I), and its user header videodev2.h, laid out for 64-bit machines.
Every function takes the descriptor of an open device and raises `OSError` as the kernel reports it.
"""

import ctypes
import errno
import fcntl
from collections.abc import Iterator
from ctypes import Structure, Union, c_char, c_int32, c_int64, c_long, c_uint8, c_uint32, c_uint64, c_void_p, sizeof
from enum import IntEnum

CAPTURE = 1
"""V4L2_BUF_TYPE_VIDEO_CAPTURE."""
MMAP = 1
"""V4L2_MEMORY_MMAP."""
CAP_CAPTURE = 0x00000001
"""V4L2_CAP_VIDEO_CAPTURE."""
CAP_CAPTURE_MPLANE = 0x00001000
"""V4L2_CAP_VIDEO_CAPTURE_MPLANE: each plane of a picture in a buffer of its own."""
CAP_STREAMING = 0x04000000
"""V4L2_CAP_STREAMING."""
FLAG_ERROR = 0x0040
"""V4L2_BUF_FLAG_ERROR: the buffer's content is damaged."""
STAMP_MASK = 0xE000
"""V4L2_BUF_FLAG_TIMESTAMP_MASK: the clock of a buffer's stamp."""
STAMP_MONOTONIC = 0x2000
"""V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC."""
SOURCE_MASK = 0x70000
"""V4L2_BUF_FLAG_TSTAMP_SRC_MASK: the instant that a buffer's stamp is of."""
SOURCE_START = 0x10000
"""V4L2_BUF_FLAG_TSTAMP_SRC_SOE: the start of the exposure."""
PROGRESSIVE = 1
"""V4L2_FIELD_NONE."""
INTERLACED = {
    4: "interlaced", 5: "top field, then bottom field", 6: "bottom field, then top field", 7: "alternating fields",
    8: "interlaced, top field first", 9: "interlaced, bottom field first",
}  # fmt: skip
"""Orders of fields (enum v4l2_field) in which a picture is of two instants, or of every other line."""
_DISABLED = 0x0001  # V4L2_CTRL_FLAG_DISABLED
_NEXT_CONTROL = 0x80000000  # V4L2_CTRL_FLAG_NEXT_CTRL: a query's answer is the next control
_TIME_PER_FRAME = 0x1000  # V4L2_CAP_TIMEPERFRAME: the frame rate can be set
_PARTS = 1000
"""Frame rates are set in parts of one hertz."""


class ControlType(IntEnum):
    """The kind of a control's value (enum v4l2_ctrl_type)."""

    INTEGER = 1
    BOOLEAN = 2
    MENU = 3
    BUTTON = 4
    INTEGER64 = 5
    CONTROL_CLASS = 6
    INTEGER_MENU = 9


class Capability(Structure):
    """struct v4l2_capability."""

    _fields_ = (
        ("driver", c_char * 16), ("card", c_char * 32), ("bus_info", c_char * 32), ("version", c_uint32),
        ("capabilities", c_uint32), ("device_caps", c_uint32), ("reserved", c_uint32 * 3),
    )  # fmt: skip


class FormatDescription(Structure):
    """struct v4l2_fmtdesc."""

    _fields_ = (
        ("index", c_uint32), ("type", c_uint32), ("flags", c_uint32), ("description", c_char * 32), ("pixelformat", c_uint32),
        ("mbus_code", c_uint32), ("reserved", c_uint32 * 3),
    )  # fmt: skip


class PixelFormat(Structure):
    """struct v4l2_pix_format."""

    _fields_ = (
        ("width", c_uint32), ("height", c_uint32), ("pixelformat", c_uint32), ("field", c_uint32), ("bytesperline", c_uint32),
        ("sizeimage", c_uint32), ("colorspace", c_uint32), ("priv", c_uint32), ("flags", c_uint32), ("ycbcr_enc", c_uint32),
        ("quantization", c_uint32), ("xfer_func", c_uint32),
    )  # fmt: skip


class _FormatUnion(Union):
    _fields_ = (("pix", PixelFormat), ("raw_data", c_uint8 * 200), ("align", c_void_p))


class Format(Structure):
    """struct v4l2_format."""

    _fields_ = (("type", c_uint32), ("fmt", _FormatUnion))


class RequestBuffers(Structure):
    """struct v4l2_requestbuffers."""

    _fields_ = (
        ("count", c_uint32), ("type", c_uint32), ("memory", c_uint32), ("capabilities", c_uint32), ("flags", c_uint8),
        ("reserved", c_uint8 * 3),
    )  # fmt: skip


class TimeOfBuffer(Structure):
    """struct timeval."""

    _fields_ = (("secs", c_long), ("usecs", c_long))


class _Memory(Union):
    _fields_ = (("offset", c_uint32), ("align", c_void_p))


class KernelBuffer(Structure):
    """struct v4l2_buffer."""

    _fields_ = (
        ("index", c_uint32), ("type", c_uint32), ("bytesused", c_uint32), ("flags", c_uint32), ("field", c_uint32),
        ("timestamp", TimeOfBuffer), ("timecode", c_uint32 * 4), ("sequence", c_uint32), ("memory", c_uint32), ("m", _Memory),
        ("length", c_uint32), ("reserved2", c_uint32), ("request_fd", c_int32),
    )  # fmt: skip


class StreamParameters(Structure):
    """struct v4l2_streamparm with v4l2_captureparm."""

    _fields_ = (
        ("type", c_uint32), ("capability", c_uint32), ("capturemode", c_uint32), ("numerator", c_uint32),
        ("denominator", c_uint32), ("rest", c_uint32 * 46),
    )  # fmt: skip


class ControlValue(Structure):
    """struct v4l2_control."""

    _fields_ = (("id", c_uint32), ("value", c_int32))


class VideoControl(Structure):
    """struct v4l2_query_ext_ctrl."""

    _fields_ = (
        ("id", c_uint32), ("type", c_uint32), ("name", c_char * 32), ("minimum", c_int64), ("maximum", c_int64),
        ("step", c_uint64), ("default_value", c_int64), ("flags", c_uint32), ("elem_size", c_uint32), ("elems", c_uint32),
        ("nr_of_dims", c_uint32), ("dims", c_uint32 * 4), ("reserved", c_uint32 * 32),
    )  # fmt: skip


class MenuEntry(Structure):
    """struct v4l2_querymenu."""

    _pack_ = 1
    _layout_ = "ms"
    _fields_ = (("id", c_uint32), ("index", c_uint32), ("name", c_char * 32), ("reserved", c_uint32))


class WideControl(Structure):
    """struct v4l2_ext_control."""

    _pack_ = 1
    _layout_ = "ms"
    _fields_ = (("id", c_uint32), ("size", c_uint32), ("reserved2", c_uint32), ("value64", c_int64))


class WideControls(Structure):
    """struct v4l2_ext_controls."""

    _fields_ = (
        ("which", c_uint32), ("count", c_uint32), ("error_idx", c_uint32), ("request_fd", c_int32), ("reserved", c_uint32),
        ("controls", ctypes.POINTER(WideControl)),
    )  # fmt: skip


def _request(direction: int, number: int, size: int) -> int:
    """Return the number of a call (asm-generic/ioctl.h): 1 writes to the kernel, 2 reads from it, 3 does both."""
    return direction << 30 | size << 16 | ord("V") << 8 | number


QUERYCAP = _request(2, 0, sizeof(Capability))
ENUM_FMT = _request(3, 2, sizeof(FormatDescription))
S_FMT = _request(3, 5, sizeof(Format))
REQBUFS = _request(3, 8, sizeof(RequestBuffers))
QUERYBUF, QBUF, DQBUF = (_request(3, number, sizeof(KernelBuffer)) for number in (9, 15, 17))
STREAMON, STREAMOFF = (_request(1, number, sizeof(c_int32)) for number in (18, 19))
G_PARM, S_PARM = (_request(3, number, sizeof(StreamParameters)) for number in (21, 22))
G_CTRL, S_CTRL = (_request(3, number, sizeof(ControlValue)) for number in (27, 28))
QUERYMENU = _request(3, 37, sizeof(MenuEntry))
G_EXT_CTRLS, S_EXT_CTRLS = (_request(3, number, sizeof(WideControls)) for number in (71, 72))
QUERY_EXT_CTRL = _request(3, 103, sizeof(VideoControl))


def capabilities(fd: int) -> int:
    """Return what the device can do, as bits."""
    asked = Capability()
    fcntl.ioctl(fd, QUERYCAP, asked)
    return int(asked.device_caps)


def formats(fd: int) -> Iterator[str]:
    """Yield the pixel formats that the device offers, by their four letters."""
    for index in range(256):
        asked = FormatDescription(index=index, type=CAPTURE)
        try:
            fcntl.ioctl(fd, ENUM_FMT, asked)
        except OSError as why:
            if why.errno == errno.EINVAL:
                return
            raise
        yield fourcc(asked.pixelformat)


def fourcc(number: int) -> str:
    """Return the letters of a pixel format; the top bit marks another byte order."""
    return (number & 0x7FFFFFFF).to_bytes(4, "little").decode("latin-1").strip()


def set_format(fd: int, name: str, width: int, height: int) -> PixelFormat:
    """Ask for a format, and return what the device agrees to."""
    wanted = Format(type=CAPTURE)
    wanted.fmt.pix.width, wanted.fmt.pix.height, wanted.fmt.pix.field = width, height, PROGRESSIVE
    wanted.fmt.pix.pixelformat = int.from_bytes(name.ljust(4).encode("ascii"), "little")
    fcntl.ioctl(fd, S_FMT, wanted)
    agreed: PixelFormat = wanted.fmt.pix
    return agreed


def set_rate(fd: int, rate_hz: float) -> float | None:
    """Ask for a frame rate, and return what the device agrees to, hertz; None if its rate cannot be set."""
    wanted = StreamParameters(type=CAPTURE)
    fcntl.ioctl(fd, G_PARM, wanted)
    if not wanted.capability & _TIME_PER_FRAME:
        return None
    wanted = StreamParameters(type=CAPTURE, numerator=_PARTS, denominator=round(rate_hz * _PARTS))
    fcntl.ioctl(fd, S_PARM, wanted)
    return wanted.denominator / wanted.numerator if wanted.numerator and wanted.denominator else None


def request_buffers(fd: int, count: int) -> int:
    """Ask for buffers, and return how many there are."""
    wanted = RequestBuffers(count=count, type=CAPTURE, memory=MMAP)
    fcntl.ioctl(fd, REQBUFS, wanted)
    return int(wanted.count)


def query_buffer(fd: int, index: int) -> tuple[int, int]:
    """Return a buffer's length and offset for mmap, bytes."""
    asked = KernelBuffer(index=index, type=CAPTURE, memory=MMAP)
    fcntl.ioctl(fd, QUERYBUF, asked)
    return int(asked.length), int(asked.m.offset)


def enqueue(fd: int, index: int) -> None:
    """Give a buffer to the device."""
    fcntl.ioctl(fd, QBUF, KernelBuffer(index=index, type=CAPTURE, memory=MMAP))


def dequeue(fd: int) -> KernelBuffer:
    """Take the oldest filled buffer.

    Raises:
        BlockingIOError: none is filled.
    """
    taken = KernelBuffer(type=CAPTURE, memory=MMAP)
    fcntl.ioctl(fd, DQBUF, taken)
    return taken


def stream(fd: int, on: bool) -> None:
    """Start or stop the stream."""
    fcntl.ioctl(fd, STREAMON if on else STREAMOFF, c_int32(CAPTURE))


def controls(fd: int) -> Iterator[VideoControl]:
    """Yield the controls of the device that are not switched off, in the order of their numbers."""
    number = 0
    while True:
        asked = VideoControl(id=number | _NEXT_CONTROL)
        try:
            fcntl.ioctl(fd, QUERY_EXT_CTRL, asked)
        except OSError as why:
            if why.errno in (errno.EINVAL, errno.ENOTTY):
                return
            raise
        number = asked.id
        if asked.type != ControlType.CONTROL_CLASS and not asked.flags & _DISABLED:
            yield asked


def menu(fd: int, control: VideoControl) -> dict[str, int]:
    """Return the entries of a menu by their labels; a device may leave numbers out."""
    found = {}
    for index in range(control.minimum, control.maximum + 1):
        entry = MenuEntry(id=control.id, index=index)
        try:
            fcntl.ioctl(fd, QUERYMENU, entry)
        except OSError as why:
            if why.errno != errno.EINVAL:
                raise
            continue
        found[entry.name.decode(errors="replace")] = index
    return found


def control_value(fd: int, number: int, kind: int = ControlType.INTEGER) -> int:
    """Return what a control holds."""
    if kind == ControlType.INTEGER64:
        return _wide(fd, G_EXT_CTRLS, number, 0)
    asked = ControlValue(id=number)
    fcntl.ioctl(fd, G_CTRL, asked)
    return int(asked.value)


def set_control(fd: int, number: int, value: int, kind: int = ControlType.INTEGER) -> None:
    """Set a control."""
    if kind == ControlType.INTEGER64:
        _wide(fd, S_EXT_CTRLS, number, value)
    else:
        fcntl.ioctl(fd, S_CTRL, ControlValue(id=number, value=value))


def _wide(fd: int, request: int, number: int, value: int) -> int:
    one = WideControl(id=number, value64=value)
    fcntl.ioctl(fd, request, WideControls(count=1, controls=ctypes.pointer(one)))
    return int(one.value64)
