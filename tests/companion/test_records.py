"""Facts read back from their records to the bit, and a damaged record is refused."""

import math
from typing import Any, TypeVar

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.observer import Decision, ProcessedFrame, ResponseInUse, ResponseState, TiltShape
from companion.facts import encode, records
from companion.recording import channels, decode
from companion.recording.foxglove import FrameTransforms
from companion.recording.message_encoder import MessageEncoder
from companion.recording.rewriting import _without_methods
from estimator.attitude_history import DOWN
from estimator.contracts.commands import Command, Hover, Land, Lean, TakeOff, Velocity
from estimator.contracts.estimates import COMPONENTS, FusionResult, Source, Verdict
from estimator.contracts.geometry import Rotation, Transform
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs
from estimator.vision.camera.camera import Camera
from estimator.vision.detection import NearThing, PadCheck, PadThing
from tests import make
from tests.companion.test_recorder import numbered_frame
from tests.make import same_bits, seen

AT = MonoNs(3_000_000_000)
CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5, np.zeros(5), Transform(Rotation.from_rpy(1.6, 0.0, 1.5), np.zeros(3)))
LEAN = Lean(np.array([0.5, -0.25]), np.array([1.0, 2.0]), np.array([0.1, 0.2, 0.3]), 0.4)
SLOWER = TiltShape(0.75, 0.9, 2.0, 0.05)
R = TypeVar("R", bound=msgspec.Struct)


def over_the_wire(record: R) -> R:
    wire = msgspec.json.encode(record)
    assert b"null" not in wire, "viewers know no null"
    return msgspec.json.decode(wire, type=type(record))


@pytest.mark.parametrize(
    "sample",
    [
        make.imu(1.0, (0.1, 0.2, 0.3), (1.0, 2.0, -9.8)),
        make.attitude(1.0, 0.1, -0.2, 0.3),
        make.gimbal(1.0, Rotation.from_rpy(0.1, -1.4, 2.0), "ned"),
        make.velocity(1.0, (0.1, 0.2, 0.3), var=0.01),
        make.range_down(1.0, 2.5),
        make.baro(1.0, 12.5),
        make.vessel(1.0, (1.0, 2.0, 0.0), 0.3),
        make.vessel(1.0),
        make.status(1.0, None, "hovering", taken="the pilot took over", others_at=MonoNs(900_000_000)),
    ],
    ids=lambda sample: type(sample).__name__,
)
def test_a_sample(sample: Sample) -> None:
    assert same_bits(decode.sample(over_the_wire(encode.sample(sample))), sample)


def result(
    source: Source = "sighting",
    verdict: Verdict = Verdict.FUSED,
    *,
    nis: float = 2.0,
    test_ratio: float = 0.1,
    at: int = 5_000_000_000,
) -> FusionResult:
    """Return a result whose numbers are all different; without a number where nothing was compared."""
    components, received_at = COMPONENTS[source], MonoNs(at + 50_000_000)
    if math.isnan(nis):
        return FusionResult("ekf", source, verdict, MonoNs(at), received_at)
    numbers = np.arange(1.0, len(components) + 1)
    cov = 0.01 * np.diag(numbers) + 0.001
    return FusionResult("ekf", source, verdict, MonoNs(at), received_at, 0.1 * numbers, cov, components, nis, test_ratio)


@pytest.mark.parametrize("source", COMPONENTS)
@pytest.mark.parametrize("nis", [2.0, math.nan])
def test_a_result_of_the_estimator(source: Source, nis: float) -> None:
    if COMPONENTS[source] or math.isnan(nis):
        before = result(source, Verdict.GATED, nis=nis)
        read = over_the_wire(encode.fusion(AT, before))
        assert read.at_ns == AT
        assert same_bits(decode.fusion(read), before)


def test_figures_that_are_not_finite_are_left_out() -> None:
    infinite = FusionResult("ekf", "range", Verdict.SINGULAR, AT, AT, np.array([1.0]), np.array([[np.inf]]), ("range_m",))
    record = encode.fusion(AT, infinite)
    assert (record.innovation, record.innovation_cov, record.nis, record.test_ratio) == ([1.0], None, None, None)


@pytest.mark.parametrize("command", [Velocity(np.array([0.1, 0.2, 0.3]), 0.4), LEAN, Hover(), Land(), TakeOff(), None])
def test_a_command(command: Command | None) -> None:
    record = encode.decision(Decision(AT, "descend", command, None))
    assert same_bits(decode.command(over_the_wire(record)), command)


@pytest.mark.parametrize(
    "response",
    [
        ResponseInUse(ResponseState.ASSUMED, 0.05, None),
        ResponseInUse(ResponseState.IDENTIFIED, 0.15, 0.012, 0.1),
        ResponseInUse(ResponseState.KNOWN, 0.05, 0.02, shape=SLOWER),
        None,
    ],
)
def test_a_response_that_a_flight_has_found(response: ResponseInUse | None) -> None:
    record = encode.decision(Decision(AT, "descend", None, None, response=response))
    assert decode.response(over_the_wire(record).response) == response


def detected(**changes: Any) -> ProcessedFrame:
    plain = seen(AT, True)
    assert plain.detection is not None
    return replace(plain, detection=replace(plain.detection, **changes))


@pytest.mark.parametrize("selected", [True, False])
def test_what_is_seen_elsewhere_stays_where_a_recording_is_thinned(selected: bool) -> None:
    detection = seen(AT, True).detection
    assert detection.selected is not None
    one = replace(detection.selected, features=())
    there = replace(one, method="registration", d_body_pad_level=np.array([1.0, 3.1, 3.0]), confidence=1.0)
    whole = encode.detection(detected(selected=one if selected else None, elsewhere=there))
    for record in (whole, _without_methods(whole)):
        back = decode.detection(over_the_wire(record))
        assert same_bits((back.selected, back.elsewhere), (one if selected else None, there))


@pytest.mark.parametrize("thing", [None, PadThing(0.2, 0.05, -0.12)])
@pytest.mark.parametrize("near", [None, NearThing(0.6, -0.3, 1.7)])
def test_what_lies_on_the_pad_and_stands_about_it(thing: PadThing | None, near: NearThing | None) -> None:
    check = PadCheck(AT, 0.9, thing, near, 0.3)
    back = decode.detection(over_the_wire(encode.detection(detected(on_pad=check))))
    assert back.on_pad == check


@pytest.mark.parametrize(
    ("read", "record", "changes"),
    [
        (decode.fusion, encode.fusion(AT, result()), {"path": "gps"}),
        (decode.fusion, encode.fusion(AT, result()), {"source": "sonar"}),
        (decode.fusion, encode.fusion(AT, result()), {"verdict": "maybe"}),
        (decode.fusion, encode.fusion(AT, result()), {"innovation": [1.0]}),
        (decode.fusion, encode.fusion(AT, result()), {"innovation_cov": [1.0, 2.0, 3.0]}),
        (decode.command, encode.decision(Decision(AT, "descend", LEAN, None)), {"a_level": None}),
        (decode.response, records.ResponseRecord("known", 0.05), {"state": "guessed"}),
        (decode.sample, encode.sample(make.gimbal(1.0, Rotation.identity())), {"frame": "moon"}),
    ],
)
def test_a_damaged_record_is_refused(read: Any, record: Any, changes: dict[str, object]) -> None:
    with pytest.raises((ValueError, msgspec.ValidationError), match=r".+"):
        read(over_the_wire(replace(record, **changes)))


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
    plain, held = numbered_frame(1.0, 1), replace(numbered_frame(1.0, 1), camera=CAMERA.held(DOWN))
    assert turned not in transforms(encoder, (encode.detection(plain), None, None))
    record = encode.detection(held)
    assert turned in transforms(encoder, (record, None, None))
    assert fixed not in transforms(encoder, None)
    rotation = encode.held_rotation(record)
    assert rotation.angle_to(DOWN @ CAMERA.T_body_cam.R) < 1e-9
