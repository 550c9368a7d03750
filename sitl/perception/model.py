"""Perception by an error model of detections: nothing is rendered or searched, everything behind vision is real.

A drawn detection is a pose in the camera's axes with an error and a claimed covariance. The function that makes a sighting of a
registered frame makes one of it too, with the attitude that the vehicle reported: the error of that attitude, which is most of a
sighting's error, is the real one. Faults act as in frames: a covered lens shows nothing, a frozen frame repeats its content, a
shifted one shows the pad beside its place; delay, loss and wrong stamps belong to the flight and not to the frame.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from companion.guidance.pad_search import Look
from companion.guidance.pilot import Pilot, make_pilot, tracker
from companion.settings.model import Settings
from estimator.attitude_history import HeldCamera
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Method, PathName, Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs
from estimator.vision.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import sighting_of
from sitl.camera.camera import Exposure
from sitl.camera.render_worker import RenderWorker
from sitl.faults.fault import Fault
from sitl.faults.kinds import FocalLength, LightFalls, PadCovered, PictureFault, light_stops
from sitl.perception.draw import Chance, View, Viewer, detection_table
from sitl.perception.parameters import PerceptionModel, load
from sitl.perception.port import Level, PerceivedWorld, Perception
from sitl.world.truth import RenderedFrame

KEPT_SCENES = 512
"""Number of exposures that may be under way: ten seconds of delay at 50 frames a second."""
_SPAWN_KEY = 1301
"""Keeps the random numbers of detections apart from those of the world, which has the first children of the seed."""
MODELLED = (PadCovered, LightFalls, FocalLength)
"""Image faults that act without a rendered image: on the visible part of the pad, on its light, on its distance."""
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

    def __init__(self, camera: Camera, world: PerceivedWorld) -> None:
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
        faults, stops = self._world.faults, self._world.scenario.light.exposure_ev
        focal = self._world.scenario.wrong_model.focal_length
        if faults.active_kinds:
            if view is not None:
                for covered, _ in faults.on(PadCovered):
                    view = view._replace(shown=view.shown * (1.0 - covered.fraction))
            focal *= math.prod(fault.scale for fault, _ in faults.on(FocalLength))
            stops += light_stops(faults.on(LightFalls))
        self._scenes[token] = Scene(view, chance, R, stops, focal)
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
            if isinstance(fault, PictureFault) and not isinstance(fault, MODELLED):
                raise BadInput(f"the fault {fault.kind} is seen in rendered frames only; use --perception pixels")

    def begin(self, world: PerceivedWorld) -> None:
        """Begin a flight in this world."""
        super().begin(world)
        self.scenes = Scenes(world.camera, world)

    def expose(self, world: PerceivedWorld, worker: RenderWorker | None = None) -> Callable[[], RenderedFrame]:
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
                f'there is no error model of vision.method "{method}": fit one with decklander perception fit and name it with '
                "--perception-model"
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
