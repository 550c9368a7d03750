"""Run a GStreamer pipeline and write its frames to standard output, as a process apart from the service.

    python3 -I gstreamer_program.py PARENT WIDTH HEIGHT PIPELINE

A vendor's camera plug-in that crashes or hangs ends this process and no other. GStreamer's bindings (PyGObject) come with the
system's Python, so this file runs under that one, whatever environment the service lives in: it needs no other module, and
nothing newer than Python 3.8.

Wire format: `HEADER` (little-endian magic, length of what follows, stamp, sequence number), then for `FRAME` the rows of a BGR
image, each padded to a multiple of 4 bytes, for `FAULT` a line of text in UTF-8, for `READY` nothing. The stamp is of
CLOCK_MONOTONIC in ns; stamp and number are `UNKNOWN` where the pipeline does not give them. Source of times and numbers:
GStreamer's design documents "Clocks" (clock time is base time plus running time) and "GstBuffer" (offset of live video is its
frame number).
"""

import ctypes
import importlib
import os
import signal
import struct
import sys
from typing import Any

HEADER = struct.Struct("<4sIqq")
READY, FRAME, FAULT = b"DLok", b"DLfr", b"DLno"
UNKNOWN = -1
NO_BINDINGS = 3
"""Exit code: this Python cannot load GStreamer."""
WRONG_PIPELINE = 4
"""Exit code: GStreamer cannot build what the text describes."""
MOST_TEXT = 2000
"""Largest length of a fault's text, bytes."""

_PR_SET_PDEATHSIG = 1
_POLL_NS = 100_000_000


def stride_of(width: int) -> int:
    """Return the bytes from one row of a BGR image to the next: GStreamer pads rows to a multiple of 4."""
    return (3 * width + 3) & ~3


def main(words: list[str]) -> int:
    """Run the pipeline until it ends or the reader is gone; return the exit code."""
    parent, width, height, pipeline = int(words[0]), int(words[1]), int(words[2]), words[3]
    # Plug-ins print to standard output, which carries frames here.
    out = os.dup(1)
    os.dup2(2, 1)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        return 0
    try:
        gi = importlib.import_module("gi")
        gi.require_version("Gst", "1.0")
        gst: Any = importlib.import_module("gi.repository.Gst")
        gst.init(None)
    except (ImportError, ValueError) as why:
        _send(out, FAULT, str(why).encode()[:MOST_TEXT])
        return NO_BINDINGS
    try:
        return _play(gst, out, pipeline, width, height)
    except BrokenPipeError:
        return 0


def _play(gst: Any, out: int, description: str, width: int, height: int) -> int:
    caps = f"video/x-raw,format=BGR,width={width},height={height}"
    # Of frames that nobody took in time only the newest is kept.
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
        return WRONG_PIPELINE
    _send(out, READY)
    bus = pipeline.get_bus()
    pipeline.set_state(gst.State.PLAYING)
    size = stride_of(width) * height
    while True:
        sample = sink.emit("try-pull-sample", _POLL_NS)
        if sample is not None:
            _send_frame(gst, out, sample.get_buffer(), pipeline.get_base_time(), size)
        message = bus.pop_filtered(gst.MessageType.ERROR | gst.MessageType.EOS)
        if message is not None:
            _send(out, FAULT, _words(gst, message, width, height).encode()[:MOST_TEXT])
            pipeline.set_state(gst.State.NULL)
            return 0


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


def _send(out: int, magic: bytes, content: bytes = b"", stamp: int = UNKNOWN, number: int = UNKNOWN) -> None:
    for part in (HEADER.pack(magic, len(content), stamp, number), content):
        left = memoryview(part)
        while left:
            left = left[os.write(out, left) :]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
