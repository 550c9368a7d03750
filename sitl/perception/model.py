"""Perception by an error model of detections: nothing is rendered or searched, everything behind vision is real.

A drawn detection is a pose in the camera's axes with an error and a claimed covariance. The function that makes a sighting of a
registered frame makes one of it too, with the attitude that the vehicle reported: the error of that attitude, which is most of a
sighting's error, is the real one. Faults act as in frames: a covered lens shows nothing, a frozen frame repeats its content, a
shifted one shows the pad beside its place; delay, loss and wrong stamps belong to the flight and not to the frame.

A draw decides whether the pad is found, and with which error in the camera's axes.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from companion.guidance.pilot import Look, Pilot, make_pilot, tracker
from companion.settings.model import Settings
from estimator.attitude_history import HeldCamera
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Method, PathName, Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.detection import Detection
from estimator.vision.pad.pad import Pad
from estimator.vision.register.sighting import sighting_of
from sitl.camera.camera import Exposure
from sitl.camera.render_worker import RenderWorker
from sitl.faults.acts import OnSight
from sitl.faults.fault import Fault
from sitl.faults.kinds import PictureFault
from sitl.perception.parameters import DetectionCell, DetectionModel, Factor, PerceptionModel, load
from sitl.perception.port import Level, Perception
from sitl.world.truth import RenderedFrame
from sitl.world.world import World

_POINTS = 61
"""Number of places on the disc that are tested for being in the image: the fraction is known to 2 %."""
_GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))


class View(NamedTuple):
    """The pad as the camera sees it, and what makes that hard or easy."""

    R_cam_pad: F64
    """(3, 3)."""
    t_cam_pad: F64
    """(3,) m, the pad's centre."""
    height_m: float
    """Distance of the lens from the pad's plane; negative on the far side of it."""
    shown: float
    """Fraction of the disc's area that lies within the image, 0..1."""
    tilt_rad: float
    """Angle between the optical axis and the pad's normal."""


class Viewer:
    """Makes views through one camera of one pad."""

    def __init__(self, camera: Camera, pad: Pad) -> None:
        self._camera = camera
        # Vogel's spiral covers a disc evenly.
        n = np.arange(_POINTS) + 0.5
        radius, angle = pad.disc_radius_m * np.sqrt(n / _POINTS), n * _GOLDEN_RAD
        self._disc = np.stack([radius * np.cos(angle), radius * np.sin(angle)])
        self._radius_m = pad.disc_radius_m
        self._R_cam_body = np.ascontiguousarray(camera.T_body_cam.R.matrix.T)
        self._p_cam_body = self._R_cam_body.dot(camera.T_body_cam.t)
        self._size = np.array([[camera.width - 0.5], [camera.height - 0.5]])

    def view(self, R_ned_body: F64, d_body_pad_ned: F64, R_ned_pad: F64) -> View:
        """Return the view of a camera on a body.

        Args:
            R_ned_body: (3, 3).
            d_body_pad_ned: (3,) m from the body's origin to the pad's centre.
            R_ned_pad: (3, 3).
        """
        R_cam_ned = self._R_cam_body.dot(R_ned_body.T)
        R = R_cam_ned.dot(R_ned_pad)
        t = R_cam_ned.dot(d_body_pad_ned) - self._p_cam_body
        normal = R[:, 2]
        return View(R, t, float(normal.dot(t)), self._shown(R, t), math.acos(max(-1.0, min(1.0, float(normal[2])))))

    def _shown(self, R: F64, t: F64) -> float:
        if self._wholly(*t.tolist()):
            return 1.0
        p = R[:, :2].dot(self._disc) + t[:, None]
        ahead = p[2] > 1e-3
        if not ahead.any():
            return 0.0
        camera = self._camera
        if camera.distorted:
            uv = camera.project(p.T).T
        else:
            z = np.where(ahead, p[2], 1.0)
            uv = np.array([camera.fx * p[0] / z + camera.cx, camera.fy * p[1] / z + camera.cy])
        inside = ((uv > -0.5) & (uv < self._size)).all(axis=0) & ahead
        return float(np.count_nonzero(inside)) / _POINTS

    def _wholly(self, x: float, y: float, z: float) -> bool:
        """Return whether a ball around the pad's centre, which holds the whole disc, lies within the image of a plain lens."""
        camera, r = self._camera, self._radius_m
        nearest = z - r
        if camera.distorted or nearest < 1e-2:
            return False
        return (
            camera.fx * (x - r) / nearest + camera.cx > -0.5
            and camera.fx * (x + r) / nearest + camera.cx < camera.width - 0.5
            and camera.fy * (y - r) / nearest + camera.cy > -0.5
            and camera.fy * (y + r) / nearest + camera.cy < camera.height - 0.5
        )


_SCALES = 6


class Chance(NamedTuple):
    """The random numbers of one exposure. Every exposure takes the same number of them, whatever becomes of the frame."""

    normal: F64
    """(7,) standard normal: the error, then its scale."""
    uniform: F64
    """(4,) 0..1: found, outlier, ambiguous, turned."""


class DrawnDetection(NamedTuple):
    """A detection that the model draws."""

    error: F64
    """(6,) m and rad in the camera's axes: of the position, then a small rotation of the pad."""
    cov: F64
    """(6, 6) claimed covariance of the same."""
    confidence: float
    ambiguous: bool
    turned: bool
    """True if the heading is half a turn off."""


class _PreparedCell(NamedTuple):
    """A cell with its matrices prepared."""

    cell: DetectionCell
    bias: F64
    root: F64
    claimed: F64


class DetectionTable:
    """The error model of detections, ready for use: the same view and random numbers give the same detection."""

    def __init__(self, model: DetectionModel) -> None:
        self.model = model
        cells = {(c.height, c.shown): _row(c) for c in model.cell}
        rows, columns = len(model.heights_m) + 1, len(model.shown) + 1
        # The row of a cell, or of the nearest one that was fitted: a bin of the fraction counts more than one of height.
        near = [[min(cells, key=lambda c: (abs(c[0] - i) + 3 * abs(c[1] - j), c)) for j in range(columns)] for i in range(rows)]
        self._rows = [[cells[at] for at in row] for row in near]
        self._heights, self._shown = list(model.heights_m), list(model.shown)
        self._tilts = [math.radians(edge) for edge in model.tilt_deg.edges]

    def probability(self, view: View, light_stops: float, found_before: bool) -> float:
        """Return the probability that the pad is found."""
        if view.height_m <= 0.0 or view.shown <= 0.0:
            return 0.0
        row = self._row(view).cell
        p = row.kept if found_before else row.regained
        odds = self._odds(view, light_stops) * p / max(1e-9, 1.0 - p)
        return odds / (1.0 + odds)

    def draw(self, view: View, light_stops: float, standard: F64, chance: Chance) -> DrawnDetection:
        """Return the detection of a view in which the pad is found.

        Args:
            standard: (7,) standard normal numbers with the correlation in time: of the error, then of its scale.
        """
        row, bias, root, claimed = self._row(view)
        own = math.exp(row.spread * float(standard[6]))
        k = own * self._ratio(view, light_stops)
        z = max(0.05, view.height_m)
        scale = np.array([z, z, z, 1.0, 1.0, 1.0])
        size = k * (row.outlier_ratio if chance.uniform[1] < row.outliers else 1.0)
        error = scale * (own * bias + size * root.dot(standard[:6]))
        cov = (k * k) * claimed * np.multiply.outer(scale, scale)
        ambiguous = bool(chance.uniform[2] < row.ambiguous)
        # A heading that is half a turn off is nearly always one that says so.
        return DrawnDetection(error, cov, row.confidence, ambiguous, bool(chance.uniform[3] < row.turned))

    def _row(self, view: View) -> _PreparedCell:
        return self._rows[bisect_right(self._heights, view.height_m)][bisect_right(self._shown, view.shown)]

    def _odds(self, view: View, light_stops: float) -> float:
        m = self.model
        return m.tilt_deg.odds[bisect_right(self._tilts, view.tilt_rad)] * _of(m.light_stops, light_stops, m.light_stops.odds)

    def _ratio(self, view: View, light_stops: float) -> float:
        m = self.model
        return m.tilt_deg.ratio[bisect_right(self._tilts, view.tilt_rad)] * _of(m.light_stops, light_stops, m.light_stops.ratio)


@lru_cache(maxsize=8)
def detection_table(model: DetectionModel) -> DetectionTable:
    """Return the table of a model; the flights of one process share it."""
    return DetectionTable(model)


def symmetric(lower: tuple[float, ...], n: int) -> F64:
    """Return the (n, n) symmetric matrix of a lower triangle, row by row."""
    out = np.zeros((n, n))
    out[np.tril_indices(n)] = lower
    return out + np.tril(out, -1).T


def root_of(cov: F64) -> F64:
    """Return L with L L' = `cov`, also of a matrix whose smallest eigenvalues rounding has made negative."""
    values, vectors = np.linalg.eigh(cov)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _of(factor: Factor, value: float, entries: tuple[float, ...]) -> float:
    return entries[bisect_right(factor.edges, value)]


def _row(cell: DetectionCell) -> _PreparedCell:
    claimed = symmetric(cell.claimed, _SCALES)
    # Five digits in a file may take a thin covariance below zero.
    claimed = claimed + np.diag(np.diag(claimed)) * 1e-4 + 1e-18 * np.eye(_SCALES)
    return _PreparedCell(cell, np.array(cell.bias), root_of(symmetric(cell.error, _SCALES)), claimed)


KEPT_SCENES = 512
"""Number of exposures that may be under way: ten seconds of delay at 50 frames a second."""
_SPAWN_KEY = 1301
"""Keeps the random numbers of detections apart from those of the world, which has the first children of the seed."""
_EYE = np.eye(3)
_HALF_TURN = np.diag([-1.0, -1.0, 1.0])
_TOKEN = 4
"""Number of pixels that hold the number of an exposure's step: seven months of flight."""


class Scene(NamedTuple):
    """The content of one exposure."""

    view: View | None
    """None where the lens is covered."""
    chance: Chance
    R_ned_body: F64
    """(3, 3), true."""
    light_stops: float = 0.0
    """Light on the pad against white paint at 80 % of full scale."""
    focal: float = 1.0
    """True focal length of the lens over that in the camera's file."""


class Scenes:
    """The exposures of one flight: each becomes a frame of unique content, which finds the scene again.

    The frame has the camera's size and takes no memory: it is one row of pixels, seen again and again. Its content is what the
    checks of frozen frames compare; two exposures never share it, and a repeated frame repeats it.
    """

    def __init__(self, camera: Camera, world: World) -> None:
        self._viewer, self._world = Viewer(camera, world.pad), world
        self._shape = (camera.height, camera.width, 3)
        self._rest_of_row = bytes(camera.width - _TOKEN)
        self._rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(world.seed, spawn_key=(_SPAWN_KEY,))))
        self._scenes: OrderedDict[bytes, Scene] = OrderedDict()

    def expose(self, shot: Exposure | None, tick: int) -> NDArray[np.uint8]:
        """Keep a scene and return its frame, (H, W, 3)."""
        chance = Chance(self._rng.standard_normal(7), self._rng.random(4))
        view, R = None, _EYE
        if shot is not None:
            R = shot.R_ned_body.matrix
            view = self._viewer.view(R, shot.p_pad_ned - shot.p_body_ned, shot.R_ned_pad.matrix)
        token = tick.to_bytes(_TOKEN, "little")
        scenario = self._world.scenario
        shown = 0.0 if view is None else view.shown
        acts = OnSight(shown, scenario.wrong_model.focal_length, scenario.light.exposure_ev)
        for fault, _ in self._world.faults.now:
            fault.on_sight(acts)
        if view is not None and acts.shown != shown:
            view = view._replace(shown=acts.shown)
        self._scenes[token] = Scene(view, chance, R, acts.light_stops, acts.focal)
        if len(self._scenes) > KEPT_SCENES:
            self._scenes.popitem(last=False)
        return np.ndarray(self._shape, np.uint8, token + self._rest_of_row, strides=(0, 1, 0))

    def corrupted(self, t_cam_pad: F64, at: MonoNs) -> F64:
        """Return the pad's place in the camera's axes, (3,) m, as a corrupted detector gives it."""
        place: tuple[float, ...] = tuple(t_cam_pad.tolist())
        output = self._world.corruptions.of("sighting", place, at)
        return t_cam_pad if output is place else np.array(output)

    def of(self, frame: Frame) -> Scene:
        """Return the scene of a frame."""
        return self._scenes[frame.px[0, :_TOKEN, 0].tobytes()]


class Model(Perception):
    """Detections are drawn from an error model.

    Args:
        model: the error model, or the name of a shipped one or a file; None for the shipped one of `vision.method`.
    """

    level: Level = "model"
    scenes: Scenes
    """The exposures of the flight, from its beginning on."""

    def __init__(self, model: PerceptionModel | str | None = None) -> None:
        self._given = load(model) if isinstance(model, str) else model

    def pilot(self, settings: Settings, shadows: Sequence[PathName] = ()) -> Pilot:
        """Return a pilot whose detections are drawn."""
        found = model_for(settings, self._given)
        return make_pilot(settings, shadows, partial(ModelPilot, _Detector(self, found, settings)))

    def refuse(self, faults: Sequence[Fault]) -> None:
        """Refuse a fault that only a rendered frame shows; every other one acts as on rendered frames."""
        for fault in faults:
            if isinstance(fault, PictureFault) and fault.rendered_only:
                raise BadInput(f"the fault {fault.kind} is seen in rendered frames only; use --perception pixels")

    def begin(self, world: World) -> None:
        """Begin a flight in this world."""
        super().begin(world)
        self.scenes = Scenes(world.camera, world)

    def expose(self, world: World, worker: RenderWorker | None = None) -> Callable[[], RenderedFrame]:
        """Keep the scene as it is now."""
        return world.expose(camera=self.scenes.expose)


def model_for(settings: Settings, given: PerceptionModel | None) -> PerceptionModel:
    """Return the error model of the settings' vision.

    Raises:
        BadInput: there is none, or the given one is of another method.
    """
    method = settings.vision.method
    if given is None:
        try:
            given = load(method)
        except BadInput as why:
            raise BadInput(
                f'there is no error model of vision.method "{method}": fit one with python -m sitl.study.perception and name it '
                "with --perception-model"
            ) from why
    if given.method != method:
        raise BadInput(f'the error model is of vision.method "{given.method}", the settings have "{method}"')
    return given


class DrawingPilot(Pilot):
    """The pilot with drawn detections in place of vision: where it expects the pad is of no use to them."""

    def look_at(self, frame: Frame, attitude: Attitude, held: HeldCamera | None = None) -> Look:
        """Return the frame with its attitude."""
        return self.search.anywhere(frame, attitude)

    def look_after(self, frame: Frame, assumed: Attitude) -> Look:
        """Return the frame with the attitude that is assumed."""
        return self.search.anywhere(frame, assumed)


class ModelPilot(DrawingPilot):
    """The pilot with detections drawn from an error model."""

    def __init__(self, detector: _Detector, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._detector = detector

    def detect(self, look: Look) -> Detection:
        """Draw the detection of a frame."""
        return self._detector.detect(look.frame, look.attitude)


class _Detector:
    """Draws detections in a service's process: it remembers whether the newest frame showed the pad."""

    def __init__(self, owner: Model, model: PerceptionModel, settings: Settings) -> None:
        self._owner = owner
        self._table = detection_table(model.detection)
        self._fused = model.method == "fused"
        own = tracker(settings)
        self._camera, self._sigma_deck_rad = own.camera, own.options.deck_tilt_sigma_rad
        kept = [model.detection.correlation] * 6 + [model.detection.scale_correlation]
        self._rates = -np.log(np.maximum(1e-9, kept)) / model.detection.frame_s
        self._standard: F64 | None = None
        self._at = 0
        self._found = False

    def detect(self, frame: Frame, attitude: Attitude) -> Detection:
        """Return the detection of a frame; the pilot calls this once for each frame that it admits."""
        scene = self._owner.scenes.of(frame)
        view, chance, light = scene.view, scene.chance, scene.light_stops
        self._wander(frame.stamp.received_at, chance.normal)
        self._found = view is not None and bool(chance.uniform[0] < self._table.probability(view, light, self._found))
        if not self._found or view is None or self._standard is None:
            return Detection(None, None, MappingProxyType({"registration": None}))
        drawn = self._table.draw(view, light, self._standard, chance)
        R = _turned(drawn.error[3:]).dot(view.R_cam_pad)
        if drawn.turned:
            R = R.dot(_HALF_TURN)
        # A longer lens shows the pad larger: it is taken for nearer, in the same direction from the axis.
        t = view.t_cam_pad / np.array([1.0, 1.0, scene.focal])
        t_said = self._owner.scenes.corrupted(t + drawn.error[:3], frame.stamp.received_at)
        pose = PadPose(Rotation(R), t_said)
        orientation = Orientation.of(attitude, self._sigma_deck_rad)
        seen = sighting_of(frame, pose, drawn.cov, self._camera, orientation, drawn.ambiguous, drawn.confidence)
        methods: dict[Method, Sighting | None] = {"registration": seen}
        if self._fused:
            return Detection(replace(seen, method="fused"), "fused", MappingProxyType(methods))
        return Detection(seen, "registration", MappingProxyType(methods))

    def _wander(self, at: int, fresh: F64) -> None:
        """Carry the standard normal numbers of the errors on to another frame: a first-order Gauss-Markov process."""
        if self._standard is None:
            self._standard = fresh
        else:
            keep = np.exp(-self._rates * max(0.0, (at - self._at) * 1e-9))
            self._standard = keep * self._standard + np.sqrt(1.0 - keep * keep) * fresh
        self._at = at


def _turned(rotation: F64) -> F64:
    """Return the rotation matrix of a small rotation vector (Rodrigues)."""
    x, y, z = rotation.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-9:
        return np.asarray(_EYE + K)
    return np.asarray(_EYE + (math.sin(angle) / angle) * K + ((1.0 - math.cos(angle)) / (angle * angle)) * K.dot(K))
