"""Collect views of the board from files or a live camera, say what to add to them, and guide the person who moves it."""

import asyncio
import re
from collections.abc import Callable, Container, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.tools.calibrate.board import Board, BoardView, Collection
from companion.tools.calibrate.solve import LEAST_VIEWS, Solution, solve
from drivers.camera import images
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions, Size
from drivers.camera.videos import frames_of, open_video, video_of
from drivers.clock import SystemClock
from drivers.files import Largest, bytes_of, refuse_special, seen_in
from drivers.pyav import require_pyav
from estimator.contracts.errors import BadInput, Recoverable, refused
from estimator.contracts.geometry import Transform

VIEWS = 10
"""Required number of views."""
CELLS = (6, 4)
"""Columns and rows of cells that the image is divided into for measuring the coverage by corners."""
COVERED = 0.8
"""Share of the cells that must hold a corner."""
REACH = 0.7
"""Share of the way from the image's centre to each of its corners that the board's corners must reach."""
TILT_DEG = 15.0
"""Tilt from which a view counts as tilted."""
TILTED = 2
"""Required number of views tilted at least `TILT_DEG`, about each of the image's axes."""
FLAT_DEG = 8.0
"""Tilt below which a view says nothing of the focal length: `TILTED` views must exceed it, or the set is flat."""
RMS_PX = 1.0
"""Largest error of the corners' places."""
SIGMA_F = 0.004
"""Accepted standard deviation of fx and fy as a share of them; it causes a range error of the same share."""
SIGMA_C = 0.004
"""Accepted standard deviation of the principal point as a share of the image's width."""
NAMES = (("top left", "top right"), ("bottom left", "bottom right"))

Grade = Literal["good", "fair", "poor"]
GRADES: tuple[Grade, ...] = ("good", "fair", "poor")
"""The grades, from the best to the worst."""
_GROWN = 1.1
"""A set of views is solved again when it has grown by this factor: solving costs more the more views there are."""


class Assessment(Struct, frozen=True):
    """The deficiencies of a solution.

    It is `poor` if its numbers are too uncertain or contradict the views. It is `fair` if the numbers hold where the board
    was but are extrapolated elsewhere, at the edges of the image or in tilt. Otherwise it is `good`.
    """

    imprecise: tuple[str, ...]
    """Reasons why the numbers cannot be trusted."""
    uncovered: tuple[str, ...]
    """Uncovered regions, where the distortion is extrapolated."""

    @property
    def grade(self) -> Grade:
        """The worst grade that applies."""
        if self.imprecise:
            return "poor"
        return "fair" if self.uncovered else "good"

    @property
    def missing(self) -> list[str]:
        """Return everything that would improve the set, the most severe deficiency first."""
        return [*self.imprecise, *self.uncovered]


def coverage(views: Sequence[BoardView], size: tuple[int, int]) -> NDArray[np.int64]:
    """Return the number of corners in each cell of the image, (rows, columns) of `CELLS`."""
    w, h = size
    counts = np.zeros((CELLS[1], CELLS[0]), dtype=np.int64)
    for view in views:
        u = np.clip(((view.uv_px[:, 0] + 0.5) / w * CELLS[0]).astype(int), 0, CELLS[0] - 1)
        v = np.clip(((view.uv_px[:, 1] + 0.5) / h * CELLS[1]).astype(int), 0, CELLS[1] - 1)
        np.add.at(counts, (v, u), 1)
    return counts


def missing_before(views: Sequence[BoardView], size: tuple[int, int]) -> list[str]:
    """Return what is missing as far as it shows without solving: the number of views and their coverage of the image."""
    lacks = []
    if len(views) < VIEWS:
        lacks.append(f"{VIEWS - len(views)} more views ({len(views)} of {VIEWS})")
    counts = coverage(views, size)
    if np.mean(counts > 0) < COVERED:
        lacks.append(f"the board in more of the image ({np.mean(counts > 0):.0%} of it, {COVERED:.0%} needed)")
    uv = np.concatenate([v.uv_px for v in views]) if views else np.zeros((0, 2))
    centre = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])
    toward = (uv - centre) / centre
    for down, row in ((-1, NAMES[0]), (1, NAMES[1])):
        for right, name in ((-1, row[0]), (1, row[1])):
            reach = np.minimum(toward[:, 0] * right, toward[:, 1] * down)
            if not len(reach) or reach.max() < REACH:
                lacks.append(f"the board closer into the {name} corner")
    return lacks


def assess(solution: Solution, size: tuple[int, int]) -> Assessment:
    """Grade a solution by its covariance, its residuals and where the board was."""
    uncovered = missing_before([f.view for f in solution.fits], size)
    tilts = np.array([f.tilt_deg for f in solution.fits])
    for axis, way in ((0, "top edge towards or away from the camera"), (1, "left edge towards or away from the camera")):
        n = int(np.sum(np.abs(tilts[:, axis]) >= TILT_DEG))
        if n < TILTED:
            uncovered.append(f"{TILTED - n} more views tilted by {TILT_DEG:g} degrees or more, {way}")
    imprecise = []
    if int(np.sum(np.hypot(*tilts.T) >= FLAT_DEG)) < TILTED:
        imprecise.append(
            f"views tilted by {FLAT_DEG:g} degrees or more: flat ones cannot tell the focal length from the distance"
        )
    if solution.rms_px > RMS_PX:
        imprecise.append(f"sharper images or a flatter board (error {solution.rms_px:.2f} px, at most {RMS_PX:g})")
    camera, sigma = solution.camera, solution.sigma
    focal = float(max(sigma[0] / camera.fx, sigma[1] / camera.fy))
    if focal > SIGMA_F:
        known = f"known to {focal:.2%}" if focal < 1.0 else "not known"
        imprecise.append(f"more tilt and nearer views (focal length {known}, {SIGMA_F:.1%} needed)")
    centre = float(max(sigma[2], sigma[3]) / size[0])
    if centre > SIGMA_C:
        known = f"known to {centre:.2%} of the width" if centre < 1.0 else "not known"
        imprecise.append(f"tilt in more directions (principal point {known}, {SIGMA_C:.1%} needed)")
    if len(solution.left_out) > len(solution.fits) / 2:
        imprecise.append(
            f"views that agree: {len(solution.left_out)} of {len(solution.left_out) + len(solution.fits)} contradict the rest"
        )
    return Assessment(tuple(imprecise), tuple(uncovered))


class GuideState(Struct, frozen=True):
    """Progress of a calibration."""

    images: int
    views: int
    board_seen: bool
    """True if the board was found in the newest image."""
    cells: tuple[tuple[int, ...], ...]
    """Corners of the board in each part of the image, rows of columns."""
    lacks: tuple[str, ...]
    """Missing views, the most severe first; empty if none is missing."""
    rms_px: float | None = None
    """Reprojection error of the newest solution; None before the first."""
    grade: Grade | None = None

    @property
    def complete(self) -> bool:
        """True if nothing is missing."""
        return self.grade == "good"


class Guide:
    """Collects views of a live camera and solves for it as they come.

    Args:
        mount: `T_body_cam` of the camera; None means straight down with the nose at the top of the image.
    """

    def __init__(self, board: Board, mount: Transform | None = None) -> None:
        self._mount = mount
        self._solved = 0
        self.collection = Collection(board, moving=True)
        self.solution: Solution | None = None
        """The newest solution; None before the first."""
        self.state = GuideState(0, 0, False, _cells(None), missing(self.collection))

    def add(self, name: str, px: NDArray[np.uint8]) -> GuideState:
        """Look for the board in one (H, W) or (H, W, 3) image and return how far the calibration is. It may take a second.

        Raises:
            BadInput: the image's size differs from that of the others.
        """
        found, without = self.collection, len(self.collection.without)
        found.add(name, px)
        views = len(found.views)
        if views >= LEAST_VIEWS and views > self._solved and views >= round(_GROWN * self._solved):
            self._solved = len(self.collection.views)
            assert self.collection.size is not None
            try:
                self.solution = solve(self.collection.views, self.collection.board, self.collection.size, self._mount)
            except BadInput:  # too few views agree yet
                self.solution = None
        seen = len(found.without) == without
        lacks, rms_px, grade = missing(found), None, None
        if self.solution is not None and found.size is not None:
            judged = assess(self.solution, found.size)
            rms_px, grade = self.solution.rms_px, judged.grade
            lacks = tuple(judged.missing)
        self.state = GuideState(found.image_count, views, seen, _cells(found), lacks, rms_px, grade)
        return self.state


def missing(collection: Collection) -> tuple[str, ...]:
    """Return what is missing as far as it shows without solving."""
    return tuple(missing_before(collection.views, collection.size or (1, 1)))


def _cells(collection: Collection | None) -> tuple[tuple[int, ...], ...]:
    if collection is None or collection.size is None:
        return tuple((0,) * CELLS[0] for _ in range(CELLS[1]))
    return tuple(tuple(row) for row in coverage(collection.views, collection.size).tolist())


Report = Callable[[Collection], None]


def files_of(paths: Sequence[Path], endings: Container[str] = images.PICTURES, kinds: str = "image") -> list[Path]:
    """Return the files that the paths name; a folder gives all in it with certain endings, numbers in their names in order.

    Args:
        kinds: what these files are, for errors.

    Raises:
        BadInput: a path does not exist or cannot be read, or a folder holds no such file.
    """
    files: list[Path] = []
    for path in paths:
        with refused(str(path), OSError):
            if path.is_dir():
                inside = [p for p in seen_in(path) if p.suffix.lower() in endings]
                inside.sort(key=lambda p: (re.sub(r"\d+", lambda number: number[0].zfill(20), p.name), p.name))
                if not inside:
                    raise BadInput(f"{path}: no {kinds} in this folder")
                files += inside
            elif path.exists():
                files.append(path)
            else:
                raise BadInput(f"{path}: no such file or folder")
    return files


def read_image(file: Path) -> images.U8:
    """Return an image, (H, W, 3) BGR.

    Raises:
        BadInput: the file cannot be read, or is no image.
    """
    try:
        return images.decode(bytes_of(file, Largest.PICTURE))
    except images.ImageRefused as why:
        raise BadInput(f"{file}: not an image that can be read ({why})") from why


def add_file(file: Path, collection: Collection, tell: Report) -> None:
    """Add an image, or every frame of a video.

    Raises:
        BadInput: the file is neither, or its size differs from those before it.
    """
    if file.suffix.lower() in images.PICTURES:
        collection.add(file.name, read_image(file))
        tell(collection)
        return
    require_pyav(f"{file}: a video")
    from av.error import FFmpegError

    try:
        refuse_special(file, Largest.RECORDING)
        with open_video(str(file), collection.size) as container:
            for number, _, px in frames_of(container, video_of(container, collection.size)):
                if px is not None:
                    collection.add(f"{file.name}#{number}", px)
                    tell(collection)
    except images.ImageRefused as why:
        raise BadInput(f"{file}: {why}") from why
    except (FFmpegError, OSError, IndexError) as why:
        raise BadInput(f"{file}: neither an image nor a video that can be read") from why


async def watch(
    options: CameraOptions,
    size: Size | None,
    guide: Guide,
    tell: Callable[[GuideState], None],
    timeout_s: float,
    first_s: float = 10.0,
) -> None:
    """Add frames of a live camera until nothing is missing, or until `timeout_s`.

    Args:
        size: the width and height of the camera's frames, px; None where a stream decides.

    Raises:
        Recoverable: no image came within `first_s`; the text gives the reason.
        BadInput, SetupImpossible: `open_camera` raised it.
    """
    loop = asyncio.get_running_loop()
    async with open_camera(options, size, SystemClock()) as camera:
        try:
            async with asyncio.timeout(first_s):
                frame = await camera.frames.get()
        except TimeoutError as why:
            raise Recoverable(camera.down or f"no image within {first_s:g} s") from why
        try:
            async with asyncio.timeout(timeout_s):
                while True:
                    state = await loop.run_in_executor(None, guide.add, f"frame {frame.seq}", frame.px)
                    tell(state)
                    if state.complete:
                        return
                    frame = await camera.frames.get()
        except TimeoutError:
            return
