"""Encode one event of the service as the messages of the file: ours for replay, Foxglove's for viewers."""

from collections.abc import Iterator

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.base.observer import Decision, ProcessedFrame
from companion.base.orders import HandledOrder
from companion.facts import encode
from companion.facts import records as rec
from companion.recording import channels
from companion.recording import foxglove as fox
from companion.recording.foxglove import error_ellipsoid, fixed_scene
from companion.recording.frame_encoder import RECORDED, FrameEncoder
from companion.settings.service import FrameForm
from estimator.contracts.estimates import FusionResult, RelativeState
from estimator.contracts.samples import Attitude, Sample
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.pad.pad import Pad

Message = tuple[str, int, Struct]
_TF_PERIOD_S, _REPEAT_S, _ELLIPSOID_S = 0.02, 1.0, 0.1


class MessageEncoder:
    """Encodes events; its only state avoids needless messages: the phase last logged, the time of the last transforms.

    Args:
        offset_ns: the offset from the monotonic clock to the viewer's time axis, ns.
        pad: the pad of the viewer's scene; None to leave it out.
    """

    def __init__(self, camera: Camera, offset_ns: int, frames: FrameForm, jpeg_quality: int, pad: Pad | None = None) -> None:
        self._pad = pad
        self._camera = camera
        self._offset_ns = offset_ns
        self._frames = frames
        self._quality = jpeg_quality
        self.begin()

    def begin(self) -> None:
        """Reset the state for a new file."""
        self._phase: str | None = None
        self._turned: MonoNs | None = None
        self._repeated: MonoNs | None = None
        self._video = FrameEncoder(RECORDED)
        self._drawn: MonoNs | None = None
        self._held = False
        """True if a gimbal turns the camera, so that its rotation is no constant."""

    def preamble(self, at: MonoNs) -> Iterator[Message]:
        """Yield the constant messages, which stand at the head of a file and again in each second of it."""
        self._repeated = at
        t = self._time(at)
        yield channels.CALIBRATION, t, fox.calibration(t, self._camera)
        yield channels.FIXED_TRANSFORMS, t, fox.fixed_transforms(t, None if self._held else self._camera)
        yield channels.SCENE, t, fixed_scene(t, self._pad)

    def messages(self, at: MonoNs, what: object) -> Iterator[Message]:
        """Yield the messages of a sample, a decision, a record, or a frame.

        A frame is a tuple of its detection record, its processed frame if the image is kept, and its detection.
        """
        t = self._time(at)
        if isinstance(what, Sample):
            yield channels.SAMPLES[type(what)], t, encode.sample(what)
            if isinstance(what, Attitude) and self._due(at):
                yield channels.TRANSFORMS, t, fox.attitude_transform(self._time(what.stamp.measured_at), what.R_ned_body)
            return
        match what:
            case (rec.DetectionRecord() as record, ProcessedFrame() | None as processed, Detection() | None as detection):
                yield from self._frame(t, record, processed, detection)
            case FusionResult():
                yield channels.fusion(what.source), t, encode.fusion(at, what)
            case rec.FusionRecord():
                yield channels.fusion(what.source), t, what
            case Decision():
                yield from self._decision(t, what)
            case HandledOrder():
                yield channels.ORDER, t, encode.order(what)
                yield channels.LOG, t, fox.log_line(t, fox.INFO if what.accepted else fox.WARNING, "operator", str(what))
            case rec.OrderRecord():
                yield from self.messages(at, encode.handled(what))
            case rec.TruthRecord():
                yield channels.TRUTH, t, what
                pose = fox.pose_in_pad(t, np.array(what.d_body_pad_level), what.yaw_rad)
                if pose is not None:
                    yield channels.TRUE_POSE, t, pose
            case rec.LinkRecord():
                yield channels.LINK, t, what
            case rec.HealthRecord():
                yield channels.HEALTH, t, what
            case fox.Log():
                yield channels.LOG, t, what
            case _:
                raise TypeError(f"nothing is known of recording a {type(what).__name__}")

    def _time(self, at: MonoNs) -> int:
        return max(0, int(at) + self._offset_ns)

    def _due(self, at: MonoNs) -> bool:
        due = self._turned is None or not 0.0 <= seconds_between(self._turned, at) < _TF_PERIOD_S
        if due:
            self._turned = at
        return due

    def _frame(
        self, t: int, record: rec.DetectionRecord, processed: ProcessedFrame | None, detection: Detection | None
    ) -> Iterator[Message]:
        exposed_at = self._time(MonoNs(record.stamp.measured_at_ns))
        if processed is not None and self._frames == "h264":
            data = self._video.encoded(processed.frame.px)
            yield channels.VIDEO, t, fox.CompressedVideo(fox.time_of(exposed_at), "cam", data, "h264")
        elif processed is not None and self._frames != "none":
            data = packed(processed.frame.px, self._frames, self._quality)
            yield channels.IMAGE, t, fox.compressed_image(exposed_at, data, self._frames)
        yield channels.DETECTION, t, record
        if (R_body_cam := encode.held_rotation(record)) is not None:
            self._held = True
            yield channels.TRANSFORMS, t, fox.camera_transform(exposed_at, self._camera.T_body_cam.t, R_body_cam)
        if detection is not None:
            features = [(name, f) for name, s in detection.methods.items() if s is not None for f in s.features]
            where = "no pad"
            if detection.selected is not None:
                forward, right, down = detection.selected.d_body_pad_level
                where = f"{detection.chosen}: {forward:.2f} forward, {right:.2f} right, {down:.2f} m down"
            yield channels.ANNOTATIONS, t, fox.image_annotations(exposed_at, features, f"{record.verdict.value}  {where}")

    def _decision(self, t: int, decision: Decision) -> Iterator[Message]:
        if self._repeated is None or seconds_between(self._repeated, decision.at) >= _REPEAT_S:
            yield from self.preamble(decision.at)
        beliefs = [b for b in (decision.belief, *decision.shadows) if b is not None]
        for belief in beliefs:
            yield channels.belief(belief.path), t, encode.belief(belief)
        yield channels.DECISION, t, encode.decision(decision)
        for belief in beliefs:
            pose = fox.pose_in_pad(t, belief.d_body_pad_level, belief.yaw_rad)
            if pose is not None:
                yield channels.pose(belief.path), t, pose
        if decision.belief is not None:
            yield from self._transform(t, decision.belief)
            if self._drawn is None or seconds_between(self._drawn, decision.at) >= _ELLIPSOID_S:
                self._drawn = decision.at
                yield channels.ELLIPSOID, t, error_ellipsoid(t, decision.belief)
        for change in decision.transitions:
            line = f"{change.source.value}: {change.event.value}, {change.reason.text}: {change.target.value}"
            yield channels.LOG, t, fox.log_line(t, fox.INFO, "guidance", line)
        if decision.phase != self._phase:
            self._phase = decision.phase
            if not decision.transitions:
                yield channels.LOG, t, fox.log_line(t, fox.INFO, "guidance", decision.phase)

    @staticmethod
    def _transform(t: int, belief: RelativeState) -> Iterator[Message]:
        transforms = fox.belief_transform(t, belief)
        if transforms is not None:
            yield channels.TRANSFORMS, t, transforms


def packed(px: NDArray[np.uint8], form: FrameForm, jpeg_quality: int) -> bytes:
    """Return an image encoded as the bytes of a file; JPEG keeps colour in half of the columns, as cameras' own formats do.

    Raises:
        ValueError: OpenCV cannot encode it.
    """
    if form == "jpeg":
        flags = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422]
        ok, data = cv2.imencode(".jpg", px, flags)
    elif form == "png":
        ok, data = cv2.imencode(".png", px, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    else:
        raise ValueError("no form to keep frames in")
    if not ok:
        raise ValueError("OpenCV could not pack the frame")
    return data.tobytes()
