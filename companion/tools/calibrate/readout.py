"""Fit the readout time of a rolling shutter from a calibration flight.

Frames are registered again, each as it would look at one instant for two readout times. How the pad's orientation turns between
the two is what a readout time does to it, and with that the readout is one more unknown of the mount's fit: the gyro says how the
vehicle turned, and only with the true readout do the poses turn alike.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from companion.recording.reading import RecordedFrame, Recording
from companion.tools.calibrate.flight_views import TILT_SIGMA_MAX_RAD, VIEWS_LEAST, FlightViews
from companion.tools.calibrate.gyro_attitude import exp, logs
from companion.tools.calibrate.mount_fit import DELAY, GYRO, MOUNT, READOUT, MountFit, fit_mount
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Frame
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.camera.rolling import CameraMotion, at_one_instant
from estimator.vision.pad.pad import Pad
from estimator.vision.register.registration import RegistrationOptions, register

FRAMES_MOST = 240
"""Frames that are registered again."""
_FIRST_S = (0.0, 0.02)
"""The two readout times of the first round."""
_CLOSE_S = 0.004  # how far those of the second lie to either side of its result
READOUT_LARGEST_S = 0.09
"""Longest readout time that is searched."""
_OPTIONS = RegistrationOptions(coarse=True)


def fit_readout(recording: Recording, views: FlightViews) -> tuple[MountFit, float]:
    """Return the fit with mount and delay, and the readout time, s.

    Raises:
        BadInput: the recording does not hold its pad, or too few frames with their images.
    """
    pad = recording.pad()
    if pad is None:
        raise BadInput(f"{recording.name}: does not hold its pad; record the flight with decklander")
    first = fit_mount(views)
    frames = _frames(recording, views)
    motions = _motions(views, first)
    found, of, around = first, views, _FIRST_S
    for _ in range(2):
        of = _registered(recording.name, views, frames, motions, pad, around)
        found = fit_mount(of)
        # The derivative is that of the readout found, and not of 0.
        middle = min(READOUT_LARGEST_S, max(-READOUT_LARGEST_S, float(of.readout_s + found.values[READOUT])))
        around = middle - _CLOSE_S, middle + _CLOSE_S
    return found, float(of.readout_s + found.values[READOUT])


def _frames(recording: Recording, views: FlightViews) -> dict[int, Frame]:
    """Return the views' frames, by the number of the view."""
    wanted = {stamp: i for i, stamp in enumerate(views.stamps_ns)}
    every = -(-len(wanted) // FRAMES_MOST)
    size = views.camera.width, views.camera.height
    out: dict[int, Frame] = {}
    for event in recording.events():
        if isinstance(event, RecordedFrame) and (i := wanted.get(int(event.stamp.measured_at))) is not None:
            frame = event.frame(size) if i % every == 0 else None
            if frame is not None:
                out[i] = frame
    if len(out) < VIEWS_LEAST:
        raise BadInput(
            f"{recording.name}: holds the images of {len(out)} views of the pad, and {VIEWS_LEAST} are needed; record the flight "
            'with its frames as "jpeg", "png" or "h264"'
        )
    return out


def _motions(views: FlightViews, fit: MountFit) -> list[CameraMotion]:
    """Return the camera's motion in each view; nan where the pad's rate is not known."""
    assert views.speed_cam is not None
    R_body_cam = exp(fit.values[MOUNT]) @ views.camera.T_body_cam.R.matrix
    t = views.t + fit.values[DELAY]
    w_body = np.stack([np.interp(t, views.t_gyro, axis) for axis in views.w_body.T], axis=1) - fit.values[GYRO]
    w_cam = w_body @ R_body_cam
    # The rate of the pad's place in the turning axes has the rotation in it.
    v_cam = views.speed_cam + np.cross(w_cam, views.t_cam_pad)
    return [CameraMotion(w, v) for w, v in zip(w_cam, v_cam, strict=True)]


def _registered(
    name: str, views: FlightViews, frames: dict[int, Frame], motions: list[CameraMotion], pad: Pad, around: tuple[float, float]
) -> FlightViews:
    """Return the views registered as of the first of two readout times, with what the second one changes."""
    kept, turns, places, covs, by = [], [], [], [], []
    cameras = [replace(views.camera, readout_s=s) for s in around]
    for i, frame in frames.items():
        if not np.isfinite(motions[i].v_pad_cam).all():
            continue
        about = PadPose(Rotation(views.R_cam_pad[i]), views.t_cam_pad[i])
        both = [one for one in _poses(frame, cameras, pad, about, motions[i]) if one is not None]
        if len(both) == 2:
            (pose, cov), (other, _) = both
            kept.append(i)
            turns.append(pose.R_cam_pad.matrix)
            places.append(pose.t_cam_pad)
            covs.append(cov)
            by.append(other.R_cam_pad.matrix @ pose.R_cam_pad.matrix.T)
    if len(kept) < VIEWS_LEAST:
        raise BadInput(f"{name}: the pad was registered again in {len(kept)} frames, and {VIEWS_LEAST} are needed")
    apart_s = around[1] - around[0]
    return replace(
        views, t=views.t[kept], R_cam_pad=np.array(turns), t_cam_pad=np.array(places), cov=np.array(covs),
        stamps_ns=tuple(views.stamps_ns[i] for i in kept), speed_cam=None, readout_s=around[0],
        by_readout=logs(np.array(by)) / apart_s,
    )  # fmt: skip


def _poses(
    frame: Frame, cameras: list[Camera], pad: Pad, about: PadPose, motion: CameraMotion
) -> Iterator[tuple[PadPose, F64] | None]:
    for camera in cameras:
        found = register(at_one_instant(frame.px, camera, about, motion), camera, pad, about, options=_OPTIONS)
        sure = found is not None and float(np.diag(found.cov)[3:].max()) < TILT_SIGMA_MAX_RAD**2
        yield (found.pose, found.cov[3:, 3:]) if found is not None and sure and not found.yaw_ambiguous else None
