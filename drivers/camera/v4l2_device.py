"""Open and read one V4L2 capture device.

A failing device raises `OSError`, a request that it cannot fulfil `BadInput`, and a file that is no camera `SetupImpossible`.
"""

import contextlib
import difflib
import errno
import mmap
import os
from collections.abc import Mapping

from msgspec import Struct

from drivers.camera import v4l2_kernel as kernel
from drivers.camera.options import FORMATS, CameraOptions, Size
from drivers.camera.v4l2_exposure import EXPOSURE_MODE, EXPOSURE_TIME, EXPOSURE_UNIT_S, KernelExposure
from drivers.camera.v4l2_frames import FrameLayout, line_length
from drivers.pyav import has_pyav
from estimator.contracts.errors import BadInput, SetupImpossible, refused

_MANUAL_MODES = (1, 2)
"""The values of V4L2_CID_EXPOSURE_AUTO for manual, and for shutter priority, which fixes the time too."""
_NUMBERS = {kernel.ControlType.INTEGER, kernel.ControlType.INTEGER64}
_CHOICES = {kernel.ControlType.BOOLEAN, kernel.ControlType.MENU, kernel.ControlType.INTEGER_MENU}


class Buffer(Struct, frozen=True):
    """A copy of one buffer of the kernel."""

    data: bytes
    sequence: int
    """The device's own count of frames."""
    stamp_ns: int
    monotonic: bool
    """True if `stamp_ns` is by CLOCK_MONOTONIC; otherwise its clock is not known."""
    at_start: bool
    """True if `stamp_ns` is the start of the exposure; otherwise it is the end of the transfer."""
    error: bool
    """True if the kernel reports damaged content."""


class KernelDevice:
    """An open device that has the options' settings and streams.

    Raises:
        OSError: it cannot be opened, is busy or went away.
        BadInput: it cannot do what the options request; the text lists what it can.
        SetupImpossible: permission is missing, or the device is not a camera.
    """

    def __init__(self, path: str, options: CameraOptions, size: Size) -> None:
        self._path = path
        self._maps: list[mmap.mmap] = []
        try:
            self._fd: int | None = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        except PermissionError as why:
            raise SetupImpossible(f"camera {path}: no permission; the user must be in the group that owns it (video)") from why
        try:
            self._check()
            self.layout, self.rate_hz = self._set_format(options, *size)
            self._set_controls(options.control_values())
            self.driven: KernelExposure | None = None
            """The exposure, where the options say that it is driven."""
            if options.exposure.driven:
                self.driven = KernelExposure(self.fileno(), path, options.exposure, self.rate_hz)
            self.exposure_s = self._exposure()
            self._stream(options.buffers)
        except BaseException:
            self.close()
            raise

    def fileno(self) -> int:
        if self._fd is None:
            raise OSError(errno.EBADF, "the camera is closed")
        return self._fd

    def dequeue(self) -> Buffer | None:
        """Return the oldest waiting buffer, None if none waits.

        Raises:
            OSError: the device is gone.
        """
        try:
            buff = kernel.dequeue(self.fileno())
        except BlockingIOError:
            return None
        if buff.index >= len(self._maps):
            raise OSError(errno.EIO, f"the driver gave buffer {buff.index} of {len(self._maps)}")
        try:
            data = self._maps[buff.index][: buff.bytesused]
        finally:
            kernel.enqueue(self.fileno(), buff.index)
        flags, stamp = int(buff.flags), buff.timestamp
        return Buffer(
            data,
            int(buff.sequence),
            stamp.secs * 1_000_000_000 + stamp.usecs * 1_000,
            flags & kernel.STAMP_MASK == kernel.STAMP_MONOTONIC,
            flags & kernel.SOURCE_MASK == kernel.SOURCE_START,
            bool(flags & kernel.FLAG_ERROR),
        )

    def close(self) -> None:
        if self._fd is None:
            return
        with contextlib.suppress(OSError):  # unplugged, or never begun
            kernel.stream(self._fd, on=False)
        for m in self._maps:
            m.close()
        self._maps = []
        fd, self._fd = self._fd, None
        os.close(fd)

    def _check(self) -> None:
        try:
            caps = kernel.capabilities(self.fileno())
        except OSError as why:
            if why.errno in (errno.ENOTTY, errno.EINVAL):
                raise SetupImpossible(f"camera {self._path}: not a video device") from why
            raise
        if not caps & kernel.CAP_CAPTURE or not caps & kernel.CAP_STREAMING:
            what = "only multi-planar" if caps & kernel.CAP_CAPTURE_MPLANE else "no"
            raise SetupImpossible(f"camera {self._path}: it offers {what} video capture (another node of it may)")

    def _set_format(self, o: CameraOptions, width: int, height: int) -> tuple[FrameLayout, float]:
        offered = dict.fromkeys(kernel.formats(self.fileno()))
        known = [f for f in FORMATS if f != "H264" or has_pyav()]
        wanted = [f for f in known if f in offered] if o.format == "auto" else [o.format] if o.format in offered else []
        if not wanted:
            asked = f"none of {', '.join(FORMATS)}" if o.format == "auto" else f"no {o.format}"
            raise BadInput(f"camera {self._path}: it offers {asked}; it has {', '.join(offered) or 'nothing'}")
        best: tuple[float, str] | None = None
        sizes = []
        for name in wanted:
            layout, rate_hz = self._try(name, width, height, o.rate_hz)
            if (layout.format, layout.width, layout.height) != (name, width, height):
                sizes.append(f"{layout.width}x{layout.height} ({name})")
                continue
            with refused(f"camera {self._path}", BadInput):
                line_length(layout)
            if rate_hz >= 0.9 * o.rate_hz:
                return layout, rate_hz
            if best is None or rate_hz > best[0]:
                best = rate_hz, name
        if best is None:
            raise BadInput(f"camera {self._path}: no frame of {width}x{height} px; the nearest is {', '.join(sizes)}")
        return self._try(best[1], width, height, o.rate_hz)

    def _try(self, name: str, width: int, height: int, asked_hz: float) -> tuple[FrameLayout, float]:
        got = kernel.set_format(self.fileno(), name, width, height)
        if order := kernel.INTERLACED.get(got.field):
            raise BadInput(
                f"camera {self._path}: its pictures are of two instants (field order: {order}), and a pad in motion is torn into "
                "combs: set the receiver or the camera to progressive pictures, or take a camera that has them"
            )
        try:
            rate_hz = kernel.set_rate(self.fileno(), asked_hz)
        except OSError as why:
            if why.errno not in (errno.ENOTTY, errno.EINVAL):
                raise
            rate_hz = None
        layout = FrameLayout(kernel.fourcc(got.pixelformat), int(got.width), int(got.height), int(got.bytesperline))
        return layout, asked_hz if rate_hz is None else rate_hz

    def _controls(self) -> dict[str, kernel.VideoControl]:
        return {_control_name(c.name.decode(errors="replace")): c for c in kernel.controls(self.fileno())}

    def _set_controls(self, wanted: Mapping[str, int | bool | str]) -> None:
        there = self._controls() if wanted else {}
        for name in wanted:
            if name not in there:
                near = difflib.get_close_matches(name, there, n=3) or sorted(there)
                raise BadInput(f"camera {self._path}: no control {name!r}; it has {', '.join(near)}")
        # Switches first: while a camera governs its exposure itself, it refuses or forgets a time that is set.
        for name in sorted(wanted, key=lambda n: there[n].type not in _CHOICES):
            self._set_control(name, there[name], wanted[name])

    def _set_control(self, name: str, control: kernel.VideoControl, value: int | bool | str) -> None:
        if control.type == kernel.ControlType.BUTTON:
            raise BadInput(f"camera {self._path}: control {name!r} is a button and holds no value")
        if control.type not in _NUMBERS | _CHOICES:
            raise BadInput(f"camera {self._path}: control {name!r} is of a kind that cannot be set here")
        number = self._menu(name, control, value) if isinstance(value, str) else int(value)
        low, high = int(control.minimum), int(control.maximum)
        if not low <= number <= high:
            raise BadInput(f"camera {self._path}: control {name!r} must lie in {low}..{high}, got {value!r}")
        try:
            kernel.set_control(self.fileno(), control.id, number, control.type)
            held = kernel.control_value(self.fileno(), control.id, control.type)
        except OSError as why:
            if why.errno == errno.ENODEV:
                raise
            raise BadInput(f"camera {self._path}: control {name!r} cannot be set to {value!r} now ({why.strerror})") from why
        if abs(held - number) >= max(1, int(control.step)):
            raise BadInput(f"camera {self._path}: control {name!r} was set to {number} but holds {held}")

    def _menu(self, name: str, control: kernel.VideoControl, label: str) -> int:
        entries = kernel.menu(self.fileno(), control) if control.type == kernel.ControlType.MENU else {}
        for entry, number in entries.items():
            if entry.lower() == label.lower():
                return number
        known = f"one of {', '.join(map(repr, entries))}" if entries else "a number"
        raise BadInput(f"camera {self._path}: control {name!r} must be {known}, got {label!r}")

    def _exposure(self) -> float | None:
        """Return the exposure in seconds; None unless the camera holds it fixed and reports it."""
        try:
            if kernel.control_value(self.fileno(), EXPOSURE_MODE) not in _MANUAL_MODES:
                return None
            return kernel.control_value(self.fileno(), EXPOSURE_TIME) * EXPOSURE_UNIT_S
        except OSError:
            return None

    def _stream(self, count: int) -> None:
        granted = kernel.request_buffers(self.fileno(), count)
        for index in range(granted):
            length, offset = kernel.query_buffer(self.fileno(), index)
            self._maps.append(mmap.mmap(self.fileno(), length, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE, offset=offset))
            kernel.enqueue(self.fileno(), index)
        kernel.stream(self.fileno(), on=True)


def _control_name(text: str) -> str:
    """Return the control's name as v4l2-ctl writes it: lower case, one underscore for each run of other characters."""
    return "_".join("".join(c if c.isalnum() else " " for c in text.lower()).split())
