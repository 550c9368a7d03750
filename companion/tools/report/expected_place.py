"""Expected place of the pad in a frame by the filter, with the errors of attitude and camera mount that it knows."""

import math

import numpy as np

from companion.base.observer import ProcessedFrame
from estimator.contracts.estimates import PathName, RelativeState
from estimator.contracts.geometry import F64, Rotation


def held_rotation(processed: ProcessedFrame) -> Rotation | None:
    """Return the rotation of the camera on the body as its gimbal held it; None of one that is fixed, or if it is not known."""
    return None if processed.camera is None else processed.camera.T_body_cam.R


def expected_in_body(processed: ProcessedFrame, path: PathName | None) -> F64 | None:
    """Return where the path's estimate expected the pad's centre in the frame, (3,) m in `body`, with the camera file's mount.

    It is what vision saw less the innovation. Drawn from the reported attitude and the nominal mount, an estimate lies beside the
    pad in the picture by the errors of both.

    Returns:
        None for a frame that was not compared with the path's estimate.
    """
    seen = None if processed.detection is None else processed.detection.selected
    if seen is None or processed.attitude is None:
        return None
    compared = next((one for one in processed.results if one.path == path and one.innovation is not None), None)
    if compared is None or compared.innovation is None:
        return None
    return less_innovation(processed.attitude.R_ned_body.without_heading(), seen.d_body_pad_level, compared.innovation)


def less_innovation(R_level_body: Rotation, d_seen_level: F64, innovation: F64) -> F64:
    """Return the expected place, (3,) m in `body`.

    Args:
        R_level_body: roll and pitch that levelled the sighting.
        d_seen_level: what vision saw, (3,) m in `level`.
        innovation: of that sighting, (4,): forward, right, down (m in `body`), heading.
    """
    in_body: F64 = R_level_body.inv @ d_seen_level - innovation[:3]
    return in_body


def camera_lean(processed: ProcessedFrame, belief: RelativeState | None) -> Rotation | None:
    """Return the rotation in `body` from the pad by the reported attitude to the pad where the filter expects it in the frame.

    The filter knows errors of the attitude and of the camera's mount, degrees in all, that neither the reported attitude nor the
    camera's file has. It is None for a frame that was not compared with the steering estimate.
    """
    expected = None if belief is None else expected_in_body(processed, belief.path)
    if belief is None or expected is None or processed.attitude is None:
        return None
    estimated: F64 = processed.attitude.R_ned_body.without_heading().inv @ belief.d_body_pad_level
    axis = np.cross(estimated, expected)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return Rotation.identity()
    return Rotation.from_rotvec(axis * (math.atan2(sine, float(estimated @ expected)) / sine))
