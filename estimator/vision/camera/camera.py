"""Camera with a lens by Brown and Conrady or a fisheye by Kannala and Brandt, and its mounting on the body."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np

from estimator.contracts.errors import BadInput, refused
from estimator.contracts.geometry import F64, Rotation, Transform

_LONGEST = 80  # Characters of a value in an error
_LARGEST_PX = 16_384  # Largest width and height of an image; a square image of that size is the largest that fits in memory
_DISTORTION_MAX = 1e3  # Largest distortion coefficient
_MOUNT_MAX_M = 100.0  # Largest distance of a camera from the body's origin along an axis
_MOUNT_VAR_MAX_DEG2 = 30.0**2  # Largest variance of its mounting
_READOUT_MAX_S = 0.1  # Longest readout of a rolling shutter
_FOCAL_SIGMA_MAX = 0.2  # Largest standard deviation of the focal length, as a fraction of it
_WIDEST_RAD = 1.5  # Largest angle from the axis that a fisheye's pixels look in: the image plane ends at a right angle


def finite(value: object) -> float | None:
    """Return the value as a float; None if it is not a number, not finite, or an integer too large for a float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def shown(value: object) -> str:
    """Return the value as one line of bounded length for an error's text."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write out an integer of more than 4300 digits.
        return "a number of thousands of digits"
    return text if len(text) <= _LONGEST else text[:_LONGEST] + "..."


LensModel = Literal["brown", "fisheye"]
_OPTIONAL = {"lens", "distortion", "p_body_cam_m", "mount_cov_deg2", "readout_s", "focal_sigma"}
_KEYS = {"width", "height", "fx", "fy", "cx", "cy", "rpy_body_cam_deg"} | _OPTIONAL
_DOWN = "; [0.0, 0.0, 90.0] looks straight down, the picture's top to the nose"
_FOCAL_PX = 1.0, 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Intrinsics, distortion and mounting of a camera.

    The intrinsics are in pixels; (0, 0) is the centre of the top-left pixel. The mounting is `T_body_cam`.

    Two cameras with the same numbers are equal, so that what is computed once for a camera (its rays, grids) is not computed and
    kept again when the same file is read again.

    Source: Brown, Close-range camera calibration, 1971; Kannala and Brandt, A generic camera model and calibration method for
    conventional, wide-angle, and fish-eye lenses, PAMI 2006; the parameter orders are OpenCV's.

    Raises:
        ValueError: a number is out of range, or `distortion` does not hold as many finite numbers as the lens has.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: F64
    """The distortion coefficients: (5,) k1, k2, p1, p2, k3 of `brown`, (4,) k1, k2, k3, k4 of `fisheye`."""
    T_body_cam: Transform
    cov_mount: F64 | None = None
    """Covariance of a small rotation of the camera on the body, (3, 3) rad^2 in `body`; None if the mount was not calibrated."""
    lens: LensModel = "brown"
    """Model of the lens: a pinhole with Brown's distortion, or an equidistant fisheye with Kannala and Brandt's polynomial."""
    focal_sigma: float = 0.0
    """Standard deviation of the focal length as a fraction of it; every covariance of a sighting has its share."""
    readout_s: float = 0.0
    """Time from the first row's exposure to the last one's; 0 for a global shutter, negative if the last row comes first. The
    stamp of a frame is that of the middle row."""
    tone: float = 1.0
    """The tone curve: 1 of sRGB, 0 of values that are linear light, as `srgb.light_of_tone`; learnt, and in no file."""
    distorted: bool = field(init=False)
    _focal: F64 = field(init=False, repr=False)
    """The (2,) arrays (fx, fy) and (cx, cy). They are made once because pixels come in small batches."""
    _centre: F64 = field(init=False, repr=False)
    _numbers: tuple[object, ...] = field(init=False, repr=False)
    """Every number of the camera, for comparison; the arrays as bytes."""
    _hash: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        d = np.array(self.distortion, dtype=float)
        self._check_lens(d)
        self._check_frame()
        if np.max(np.abs(self.T_body_cam.t)) > _MOUNT_MAX_M:
            raise ValueError(f"a camera cannot be mounted more than {_MOUNT_MAX_M:g} m from the body's origin")
        if not abs(self.readout_s) <= _READOUT_MAX_S:
            raise ValueError(f"readout_s must lie in {-_READOUT_MAX_S:g}..{_READOUT_MAX_S:g} s, got {self.readout_s!r}")
        if not 0.0 <= self.focal_sigma <= _FOCAL_SIGMA_MAX:
            raise ValueError(f"focal_sigma must lie in 0..{_FOCAL_SIGMA_MAX:g}, got {self.focal_sigma!r}")
        d.setflags(write=False)
        object.__setattr__(self, "distortion", d)
        object.__setattr__(self, "distorted", self.lens == "fisheye" or bool(np.any(d != 0.0)))
        object.__setattr__(self, "_focal", np.array([self.fx, self.fy], float))
        object.__setattr__(self, "_centre", np.array([self.cx, self.cy], float))
        if self.cov_mount is not None:
            cov = np.array(self.cov_mount, dtype=float)
            cov.setflags(write=False)
            object.__setattr__(self, "cov_mount", cov)
        known = b"" if self.cov_mount is None else self.cov_mount.tobytes()
        arrays = (d.tobytes(), self.T_body_cam.R.matrix.tobytes(), self.T_body_cam.t.tobytes(), known)
        alone = (self.fx, self.fy, self.cx, self.cy, self.focal_sigma, self.readout_s, self.tone)
        numbers = (self.width, self.height, self.lens, *alone, *arrays)
        object.__setattr__(self, "_numbers", numbers)
        object.__setattr__(self, "_hash", hash(numbers))

    def _check_lens(self, d: F64) -> None:
        if self.lens not in get_args(LensModel):
            raise ValueError(f"lens must be one of {', '.join(get_args(LensModel))}, got {self.lens!r}")
        names = "five finite numbers k1, k2, p1, p2, k3" if self.lens == "brown" else "four finite numbers k1, k2, k3, k4"
        if d.shape != ((5,) if self.lens == "brown" else (4,)) or not np.all(np.isfinite(d)):
            raise ValueError(f"distortion needs {names}, got {self.distortion!r}")
        if np.max(np.abs(d)) > _DISTORTION_MAX:
            raise ValueError(f"distortion of more than {_DISTORTION_MAX:g} is no lens, got {d.tolist()}")

    def _check_frame(self) -> None:
        if self.width < 16 or self.height < 16:
            raise ValueError(f"a frame of {self.width}x{self.height} px is too small")
        if max(self.width, self.height) > _LARGEST_PX:
            raise ValueError(f"a frame of {self.width}x{self.height} px is too large; at most {_LARGEST_PX} px a side are read")
        if not (_FOCAL_PX[0] <= self.fx <= _FOCAL_PX[1] and _FOCAL_PX[0] <= self.fy <= _FOCAL_PX[1]):
            raise ValueError(f"fx and fy must lie in {_FOCAL_PX[0]:g}..{_FOCAL_PX[1]:g} px, got {self.fx!r} and {self.fy!r}")
        if not (abs(self.cx) <= _FOCAL_PX[1] and abs(self.cy) <= _FOCAL_PX[1]):
            raise ValueError(f"cx and cy must be within {_FOCAL_PX[1]:g} px of the frame's corner, got {self.cx!r}, {self.cy!r}")

    def __eq__(self, other: object) -> bool:
        return self._numbers == other._numbers if isinstance(other, Camera) else NotImplemented

    def __hash__(self) -> int:
        return self._hash

    @staticmethod
    def from_mapping(data: Mapping[str, Any], where: str = "camera") -> Camera:
        """Build a camera from the keys of a camera file (configs/cameras/*.toml).

        Raises:
            BadInput: a key is missing, unknown, of the wrong type or out of range; the text names `where` and the key.
        """
        if unknown := sorted(set(data) - _KEYS):
            raise BadInput(f"{where}: unknown key {unknown[0]!r}; known are {', '.join(sorted(_KEYS))}")
        if missing := sorted(_KEYS - _OPTIONAL - set(data)):
            raise BadInput(f"{where}: key {missing[0]!r} is missing{_DOWN if missing[0] == 'rpy_body_cam_deg' else ''}")

        def number(key: str) -> float:
            found = finite(data[key])
            if found is None:
                raise BadInput(f"{where}: {key} must be a finite number, got {shown(data[key])}")
            return found

        def vector(key: str, n: int) -> F64:
            value = data.get(key, [0.0] * n)
            found = [finite(v) for v in value] if isinstance(value, list) and len(value) == n else [None]
            if None in found:
                raise BadInput(f"{where}: {key} must be a list of {n} finite numbers, got {shown(value)}")
            return np.array(found, dtype=float)

        lens = data.get("lens", "brown")
        if lens not in get_args(LensModel):
            raise BadInput(f"{where}: lens must be one of {', '.join(get_args(LensModel))}, got {shown(lens)}")
        roll, pitch, yaw = np.radians(vector("rpy_body_cam_deg", 3))
        for key in ("width", "height"):
            if not isinstance(data[key], int) or isinstance(data[key], bool):
                raise BadInput(f"{where}: {key} must be a whole number of pixels, got {shown(data[key])}")
        with refused(where, ValueError):
            return Camera(
                data["width"], data["height"], number("fx"), number("fy"), number("cx"), number("cy"),
                vector("distortion", 5 if lens == "brown" else 4),
                Transform(Rotation.from_rpy(roll, pitch, yaw), vector("p_body_cam_m", 3)),
                _mount_cov(data["mount_cov_deg2"], where) if "mount_cov_deg2" in data else None,
                lens, number("focal_sigma") if "focal_sigma" in data else 0.0,
                number("readout_s") if "readout_s" in data else 0.0,
            )  # fmt: skip

    @property
    def optics(self) -> Camera:
        """The camera without mount, shutter and uncertainty: the key of what is computed once for a lens."""
        return _optics_of(self)

    def turned(self, R_body_cam: Rotation) -> Camera:
        """Return the camera with another rotation on the body, in the same place."""
        return replace(self, T_body_cam=Transform(R_body_cam, self.T_body_cam.t))

    def held(self, R_body_gimbal: Rotation) -> Camera:
        """Return the camera as a gimbal holds it: its own rotation is that on the gimbal's last axis, its place the gimbal's."""
        return self.turned(R_body_gimbal @ self.T_body_cam.R)

    @property
    def K(self) -> F64:
        """The (3, 3) intrinsic matrix, px, without skew."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def distort(self, xy: F64) -> F64:
        """Map (N, 2) ideal image-plane coordinates (x/z, y/z) to distorted ones."""
        if self.lens == "fisheye":
            r = np.hypot(xy[:, 0], xy[:, 1])
            return np.asarray(xy * np.divide(self._bent(np.arctan(r)), r, out=np.ones_like(r), where=r > 1e-9)[:, None])
        k1, k2, p1, p2, k3 = self.distortion
        x, y = xy[:, 0], xy[:, 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.stack(
            [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], axis=1
        )

    def _bent(self, theta: F64) -> F64:
        """Return a fisheye's distances from the axis, in focal lengths, by the angle, rad."""
        k1, k2, k3, k4 = self.distortion
        t2 = theta * theta
        return np.asarray(theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))))

    def _unbent(self, distorted: F64) -> F64:
        """Return (N, 2) ideal coordinates of a fisheye's distorted ones, by Newton's method within the range of angles."""
        r = np.hypot(distorted[:, 0], distorted[:, 1])
        k1, k2, k3, k4 = self.distortion
        theta = np.minimum(r, _WIDEST_RAD)
        for _ in range(20):
            t2 = theta * theta
            slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + 9.0 * t2 * k4)))
            step = (self._bent(theta) - r) / np.where(slope > 0.05, slope, 0.05)
            theta = np.clip(theta - step, 0.0, _WIDEST_RAD)
            if np.abs(step).max(initial=0.0) < 1e-13:
                break
        return np.asarray(distorted * np.divide(np.tan(theta), r, out=np.ones_like(r), where=r > 1e-9)[:, None])

    def project(self, p_cam: F64) -> F64:
        """Project (N, 3) points in `cam`, m, to (N, 2) px. Points at or behind the lens (z <= 1 mm) give nan."""
        p = np.asarray(p_cam, dtype=float)
        z = np.where(p[:, 2] > 1e-3, p[:, 2], np.nan)
        xy: F64 = p[:, :2] / z[:, None]
        if self.distorted:
            xy = self.distort(xy)
        xy *= self._focal
        xy += self._centre
        return xy

    def rays(self, uv_px: F64) -> F64:
        """Map (N, 2) px to (N, 2) ideal image-plane coordinates (x/z, y/z).

        This is the inverse of `project`, solved by Newton's method. It converges to 1e-9 wherever the distortion is one-to-one,
        which holds for a calibrated lens over its own frame. A fisheye's pixels beyond 86 degrees from the axis look there.
        """
        target: F64 = (np.asarray(uv_px, dtype=float) - self._centre) / self._focal
        if not self.distorted:
            return target
        if self.lens == "fisheye":
            return self._unbent(target)
        xy = target.copy()
        h = 1e-6
        du, dv = np.array([h, 0.0]), np.array([0.0, h])
        for _ in range(12):
            f = self.distort(xy) - target
            if np.abs(f).max(initial=0.0) < 1e-12:
                break
            jx = (self.distort(xy + du) - self.distort(xy - du)) / (2 * h)
            jy = (self.distort(xy + dv) - self.distort(xy - dv)) / (2 * h)
            det = jx[:, 0] * jy[:, 1] - jx[:, 1] * jy[:, 0]
            dx = (f[:, 0] * jy[:, 1] - f[:, 1] * jy[:, 0]) / det
            dy = (f[:, 1] * jx[:, 0] - f[:, 0] * jx[:, 1]) / det
            xy = xy - np.stack([dx, dy], axis=1)
        return xy


@lru_cache(maxsize=8)
def ray_map(camera: Camera) -> F64:
    """Return (H, W, 2) x/z, y/z of every pixel of a camera with distortion; the result is cached."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    return camera.rays(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(camera.height, camera.width, 2)


@lru_cache(maxsize=8)
def _optics_of(camera: Camera) -> Camera:
    return replace(camera, T_body_cam=Transform.identity(), cov_mount=None, focal_sigma=0.0, readout_s=0.0)


def _mount_cov(value: object, where: str) -> F64:
    """Return the covariance of the mount, (3, 3) rad^2.

    Raises:
        BadInput: it is none; the text names `where` and the key.
    """
    rows = value if isinstance(value, list) and len(value) == 3 else []
    numbers = [finite(x) for row in rows for x in (row if isinstance(row, list) and len(row) == 3 else [None])]
    if len(numbers) == 9 and None not in numbers:
        cov = np.array(numbers, dtype=float).reshape(3, 3)
        sizes = np.linalg.eigvalsh(0.5 * (cov + cov.T)) if np.abs(cov).max() <= _MOUNT_VAR_MAX_DEG2 else np.full(3, -1.0)
        if np.allclose(cov, cov.T, rtol=1e-6, atol=1e-9) and float(sizes.min()) >= -1e-9:
            return np.asarray(np.radians(1.0) ** 2 * 0.5 * (cov + cov.T))
    raise BadInput(
        f"{where}: mount_cov_deg2 must be three rows of three numbers, a covariance of at most {_MOUNT_VAR_MAX_DEG2:g} deg^2, "
        f"got {shown(value)}"
    )
