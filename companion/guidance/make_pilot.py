"""The pilot from the settings: pad tracker, estimator and guidance."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

from msgspec import structs

from companion.guidance.controller import Controller, FieldOfView
from companion.guidance.controllers import ControllerSetup, make_controller
from companion.guidance.landing import PilotOptions
from companion.guidance.pilot import Pilot
from companion.settings.guidance import GuidanceOptions
from companion.settings.load import body_camera, camera_model, pad_model, response_model
from companion.settings.model import Settings
from companion.settings.response import Response, TiltResponse
from drivers.ardrone.options import ArDroneOptions
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.estimates import PathName
from estimator.options import EstimatorOptions
from estimator.vision.camera import Camera
from estimator.vision.tracker_config import FRAME_WORK, TrackerConfig

if TYPE_CHECKING:
    from estimator.vision.learned.second_opinion import SecondOpinion

_MOUNT_LEAST_RAD = math.radians(0.1)
"""The least standard deviation of a calibrated mount: it bends by as much from flight to flight."""


def make_pilot(settings: Settings, shadows: Sequence[PathName] = (), kind: Callable[..., Pilot] = Pilot) -> Pilot:
    """Return the pilot that the settings describe.

    Args:
        shadows: estimator paths that run beside it to be compared.
        kind: makes the pilot in place of the class itself, from the same arguments.

    Raises:
        BadInput: the camera or pad file is missing or has a fault.
    """
    detector = tracker(settings)
    return kind(
        detector,
        with_mount(estimator_options(settings), detector.camera),
        settings.guidance,
        PilotOptions(
            automatic=settings.guidance.start == "automatic",
            shadows=shadows,
            law=law_of(settings),
            manual=settings.operator.manual,
            limits=settings.limits,
            over_ground=_over_ground(settings),
            resumes=isinstance(settings.vehicle, AutopilotOptions) and settings.vehicle.mode_is_order,
            reports=settings.vessel,
            tilt=_flyable_tilt(settings),
            climb=_within_driver(response_model(settings), settings).climb,
            view=None if settings.camera.gimbal.given else field_of_view(body_camera(settings)),
            gimballed=settings.camera.gimbal.given,
        ),
    )


def law_of(settings: Settings) -> Callable[[GuidanceOptions], Controller[Any]]:
    """Return what makes the control law from guidance's options, which may be tuned in flight, and all else that it needs.

    Raises:
        BadInput: the response or camera file has a fault, or there is no such controller.
    """
    response, view = _within_driver(response_model(settings), settings), field_of_view(body_camera(settings))

    def make(guidance: GuidanceOptions) -> Controller[Any]:
        return make_controller(ControllerSetup(guidance, response, view, _over_ground(settings)))

    make(settings.guidance)
    return make


def _over_ground(settings: Settings) -> bool:
    """Return whether the vehicle's own hover holds over the ground, and its driver adds the deck's velocity to a velocity."""
    return isinstance(settings.vehicle, AutopilotOptions)


def _within_driver(response: Response, settings: Settings) -> Response:
    """Return the response with no more than the driver lets through: the law has to know the tilt that is truly flown."""
    vehicle = settings.vehicle
    if not isinstance(vehicle, ArDroneOptions):
        return response
    tilt, climb = response.tilt, response.climb
    return Response(
        structs.replace(tilt, max_deg=max(2.0, min(tilt.max_deg, vehicle.euler_angle_max_deg))),
        structs.replace(climb, max_m_s=min(climb.max_m_s, vehicle.vz_max_m_s)),
    )


def _flyable_tilt(settings: Settings) -> TiltResponse:
    """Return the tilt's response with the least of the limits of file, driver and controller."""
    tilt = _within_driver(response_model(settings), settings).tilt
    return structs.replace(tilt, max_deg=min(tilt.max_deg, settings.guidance.follow_deck.tilt_max_deg))


def field_of_view(camera: Camera) -> FieldOfView | None:
    """Return the field of a camera that looks down, in the body's axes; None of one that looks elsewhere.

    Half a field is that from the optical axis to the nearer edge.
    """
    mount = camera.T_body_cam
    down = mount.R.matrix[:, 2]
    if float(down[2]) < math.cos(math.radians(10.0)):
        return None
    half_u = math.atan(min(camera.cx, camera.width - 1 - camera.cx) / camera.fx)
    half_v = math.atan(min(camera.cy, camera.height - 1 - camera.cy) / camera.fy)
    across = abs(float(mount.R.matrix[1, 0])) > math.sqrt(0.5)
    half_forward, half_right = (half_v, half_u) if across else (half_u, half_v)
    return FieldOfView(float(mount.t[0]), float(mount.t[1]), half_forward, half_right)


def tracker(settings: Settings) -> TrackerConfig:
    """Return the configuration of the pad tracker.

    Raises:
        BadInput: the camera or pad file, or the network for a second opinion, is missing or has a fault.
    """
    vision = settings.vision
    asked: SecondOpinion | None = None
    if vision.learned == "second_opinion":
        from companion.settings.referenced_files import second_opinion

        asked = second_opinion(vision.learned_file, "vision.learned_file")
    limits = settings.estimator.integrity
    return TrackerConfig(camera_model(settings), pad_model(settings), vision, FRAME_WORK, second_opinion=asked, integrity=limits)


def estimator_options(settings: Settings) -> EstimatorOptions:
    """Return the estimator's options, with those that depend on the vehicle.

    An AR.Drone's optical flow is relative to the surface that it sees, deck or water; an autopilot's velocity is over the ground.
    """
    options = settings.estimator
    if options.ekf.velocity_is_over != "auto":
        return options
    over: Literal["ground", "either"] = "ground" if isinstance(settings.vehicle, AutopilotOptions) else "either"
    return structs.replace(options, ekf=structs.replace(options.ekf, velocity_is_over=over))


def with_mount(options: EstimatorOptions, camera: Camera) -> EstimatorOptions:
    """Return the options with the mount as well known as the camera's file says, where that is better than the settings'."""
    if camera.cov_mount is None:
        return options
    sigma_rad = max(_MOUNT_LEAST_RAD, math.sqrt(float(camera.cov_mount.trace()) / 3.0))
    return structs.replace(options, ekf=structs.replace(options.ekf, sigma_mount_rad=min(sigma_rad, options.ekf.sigma_mount_rad)))
