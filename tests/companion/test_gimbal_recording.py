"""A recording of a camera on a gimbal: its reports, and the camera's rotation of each frame."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.facts import encode
from companion.recording import channels, decode
from companion.recording.foxglove import FrameTransforms
from companion.recording.message_encoder import MessageEncoder
from estimator.contracts.geometry import Rotation, Transform
from estimator.contracts.samples import GimbalAttitude
from estimator.contracts.time import MonoNs, Stamp
from estimator.gimbal_history import DOWN
from estimator.vision.camera import Camera
from tests.companion.recorder_parts import frame

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5, np.zeros(5), Transform(Rotation.from_rpy(1.6, 0.0, 1.5), np.zeros(3)))
AT = MonoNs(3_000_000_000)


def test_a_report_reads_back_as_it_was_and_one_in_no_frame_is_refused() -> None:
    sample = GimbalAttitude(Stamp(MonoNs(AT - 5), AT, 0.01, "synced"), "ned", Rotation.from_rpy(0.1, -1.4, 2.0), 1e-4 * np.eye(3))
    record = encode.sample(sample)
    back = decode.sample(record)
    assert isinstance(back, GimbalAttitude)
    assert (back.stamp, back.frame) == (sample.stamp, "ned")
    assert np.array_equal(back.R_frame_gimbal.matrix, sample.R_frame_gimbal.matrix)
    assert np.array_equal(back.cov_gimbal, sample.cov_gimbal)
    with pytest.raises(ValueError, match="frame"):
        decode.sample(replace(record, frame="moon"))  # type: ignore[call-overload]


def transforms(encoder: MessageEncoder, what: object | None) -> list[tuple[str, str, str]]:
    messages = encoder.preamble(AT) if what is None else encoder.messages(AT, what)
    return [
        (topic, t.parent_frame_id, t.child_frame_id)
        for topic, _, message in messages
        if isinstance(message, FrameTransforms)
        for t in message.transforms
    ]


def test_the_camera_s_transform_is_that_of_each_frame_once_a_gimbal_turns_it() -> None:
    encoder = MessageEncoder(CAMERA, 0, "none", 80)
    fixed, turned = (channels.FIXED_TRANSFORMS, "body", "cam"), (channels.TRANSFORMS, "body", "cam")
    assert fixed in transforms(encoder, None)
    plain, held = frame(1.0, 1), replace(frame(1.0, 1), camera=CAMERA.held(DOWN))
    assert turned not in transforms(encoder, (encode.detection(plain), None, None))
    record = encode.detection(held)
    assert turned in transforms(encoder, (record, None, None))
    assert fixed not in transforms(encoder, None)
    rotation = decode.held_rotation(record)
    assert rotation is not None
    assert rotation.angle_to(DOWN @ CAMERA.T_body_cam.R) < 1e-9
