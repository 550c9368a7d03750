"""A detection reads back from a recording as it was, with what was seen elsewhere."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.observer import ProcessedFrame
from companion.facts import encode
from companion.recording import decode
from companion.recording.rewriting import _without_methods
from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.time import MonoNs
from estimator.vision.detection import NearThing, PadCheck, PadThing
from tests.support.processed_frames import seen

AT = MonoNs(3_000_000_000)


def with_elsewhere(selected: bool) -> ProcessedFrame:
    plain = seen(AT, True)
    assert plain.detection is not None
    one = plain.detection.selected
    assert one is not None
    there = replace(one, method="registration", d_body_pad_level=np.array([1.0, 3.1, 3.0]), confidence=1.0)
    detection = replace(plain.detection, selected=one if selected else None, elsewhere=there)
    return replace(plain, detection=detection, verdict=Verdict.FUSED if selected else Verdict.ELSEWHERE)


def same(a: Sighting | None, b: Sighting | None) -> bool:
    if a is None or b is None:
        return a is b
    equal = np.array_equal(a.d_body_pad_level, b.d_body_pad_level) and np.array_equal(a.cov, b.cov)
    return bool(equal) and (a.stamp, a.confidence, a.method) == (b.stamp, b.confidence, b.method)


@pytest.mark.parametrize("selected", [True, False])
def test_what_is_seen_elsewhere_reads_back_and_stays_where_a_recording_is_thinned(selected: bool) -> None:
    frame = with_elsewhere(selected)
    record = encode.detection(frame)
    assert frame.detection is not None
    for one in (record, _without_methods(record)):
        back = decode.detection(one)
        assert back is not None
        assert same(back.selected, frame.detection.selected)
        assert same(back.elsewhere, frame.detection.elsewhere)
    none = decode.detection(encode.detection(seen(AT, True)))
    assert none is not None
    assert none.elsewhere is None


@pytest.mark.parametrize("thing", [None, PadThing(0.2, 0.05, -0.12)])
@pytest.mark.parametrize("near", [None, NearThing(0.6, -0.3, 1.7)])
def test_what_lies_on_the_pad_and_stands_about_it_reads_back(thing: PadThing | None, near: NearThing | None) -> None:
    plain = seen(AT, True)
    assert plain.detection is not None
    check = PadCheck(AT, 0.9, thing, near, 0.3)
    back = decode.detection(encode.detection(replace(plain, detection=replace(plain.detection, on_pad=check))))
    assert back is not None
    assert back.on_pad == check
