from dataclasses import replace
from fractions import Fraction
from functools import cache

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.ardrone.pave import FrameType, PaveFrame, PaveHeader
from drivers.ardrone.video import VideoDecoder
from tests.drivers.captures import frames_of, needs_captures

GOP = 5


@cache
def clip(n: int = 16) -> tuple[tuple[PaveFrame, ...], NDArray[np.uint8]]:
    """Units of a moving pattern with an IDR every `GOP` frames, and the frames that went in."""
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt, codec.framerate = 640, 360, "yuv420p", Fraction(30)
    codec.gop_size, codec.max_b_frames, codec.thread_count = GOP, 0, 1
    codec.options = {"preset": "ultrafast", "tune": "zerolatency", "profile": "baseline", "sc_threshold": "0", "qp": "12"}
    y, x = np.mgrid[0:360, 0:640]
    units, images = [], []
    for k in range(n):
        px = np.stack([128 + 80 * np.sin((x + 9 * k) / 25), 128 + 80 * np.cos((y - 5 * k) / 30), 0.3 * x], axis=2).astype(
            np.uint8
        )
        (packet,) = codec.encode(av.VideoFrame.from_ndarray(px, format="bgr24"))
        kind = FrameType.IDR if packet.is_keyframe else FrameType.P
        units.append(PaveFrame(PaveHeader(packet.size, k, 33 * k, kind), bytes(packet), False))
        images.append(px)
    assert [u.header.frame_type == FrameType.IDR for u in units] == [k % GOP == 0 for k in range(n)]
    return tuple(units), np.array(images)


def one_by_one(decoder: VideoDecoder, units: list[PaveFrame]) -> list[int]:
    """Return indices of the units that gave a frame."""
    return [k for k, u in enumerate(units) if decoder.newest([u]) is not None]


@needs_captures
@pytest.mark.parametrize(
    ("name", "decodable"), [("video_56_frames.pave", range(56)), ("video_starts_on_p_frames.pave", range(3, 20))]
)
def test_every_decodable_frame_of_the_captures(name: str, decodable: range) -> None:
    units = frames_of(name)
    decoder = VideoDecoder()
    images = [decoder.newest([u]) for u in units]
    assert [k for k, p in enumerate(images) if p is not None] == list(decodable)
    assert {p.px.shape for p in images if p is not None} == {(360, 640, 3)}
    assert all(p.px.std() > 10 for p in images if p is not None), "a flat frame is no frame of a room"
    assert (decoder.images, decoder.waiting, decoder.damaged) == (len(decodable), len(units) - len(decodable), 0)


def test_images_are_those_that_went_in_colours_and_all() -> None:
    units, images = clip()
    decoder = VideoDecoder()
    jump = VideoDecoder().newest(units)
    for u, px in zip(units, images, strict=True):
        image = decoder.newest([u])
        assert image is not None
        difference = image.px.astype(int) - px
        assert np.abs(difference).mean() < 4
        assert np.abs(difference.mean(axis=(0, 1))).max() < 4, "blue, green and red in their places"
    assert jump is not None
    assert jump.index == len(units) - 1
    np.testing.assert_array_equal(jump.px, image.px)


def test_after_a_gap_or_damage_everything_is_dropped_to_the_next_idr() -> None:
    units = list(clip()[0])
    units[7] = replace(units[7], discontinuity=True)
    decoder = VideoDecoder()
    assert one_by_one(decoder, units) == [0, 1, 2, 3, 4, 5, 6, 10, 11, 12, 13, 14, 15]
    assert decoder.waiting == 3
    torn = units[7].payload[: len(units[7].payload) // 2]
    units[7] = replace(clip()[0][7], payload=torn)
    decoder = VideoDecoder()
    assert one_by_one(decoder, units) == [0, 1, 2, 3, 4, 5, 6, 10, 11, 12, 13, 14, 15]
    assert (decoder.damaged, decoder.waiting) == (1, 2)


def test_an_image_that_is_not_as_its_header_says_is_refused() -> None:
    unit = clip()[0][0]
    decoder = VideoDecoder()
    assert decoder.newest([replace(unit, header=replace(unit.header, display_width=1280, display_height=720))]) is None
    assert decoder.damaged == 1


@settings(max_examples=40)
@given(
    st.lists(
        st.tuples(st.integers(0, 15), st.sampled_from(["whole", "gap", "cut", "flip", "noise"]), st.integers(0, 10**6)),
        max_size=12,
    ),
    st.integers(1, 4),
)
def test_anything_in_any_order_never_raises_and_is_counted_once(story: list[tuple[int, str, int]], batch: int) -> None:
    units = []
    for index, fate, n in story:
        u = clip()[0][index]
        data = bytearray(u.payload)
        if fate == "cut":
            del data[n % len(data) :]
        elif fate == "flip":
            data[n % len(data)] ^= 1 << n % 8
        elif fate == "noise":
            data[:] = np.random.default_rng(n).bytes(n % 2000)
        units.append(PaveFrame(u.header, bytes(data), fate == "gap"))
    decoder = VideoDecoder()
    given_out = sum(decoder.newest(units[k : k + batch]) is not None for k in range(0, len(units), batch))
    assert decoder.units == len(units)
    assert decoder.images == given_out
    image = decoder.newest([clip()[0][0]])
    assert image is not None, "a whole IDR always decodes"
    np.testing.assert_allclose(image.px.astype(int), clip()[1][0], atol=60)
