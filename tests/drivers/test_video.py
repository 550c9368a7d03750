"""The video of an AR.Drone 2.0: PaVE frames out of any stream, and images out of access units, whatever is lost or damaged."""

import struct
from dataclasses import replace
from fractions import Fraction
from functools import cache

import av
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.ardrone.pave import CONTROL_ADVERTISEMENT, FrameType, PaveFrame, PaveHeader, PaveParser, VideoDecoder
from tests.drivers.captures import CAPTURES, frames_of, needs_captures

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
    torn = units[7].payload[: len(units[7].payload) // 2]
    for hurt in (replace(units[7], discontinuity=True), replace(units[7], payload=torn)):
        units[7] = hurt
        decoder = VideoDecoder()
        seen = [k for k, unit in enumerate(units) if decoder.newest([unit]) is not None]
        assert seen == [0, 1, 2, 3, 4, 5, 6, 10, 11, 12, 13, 14, 15]


def test_an_image_that_is_not_as_its_header_says_is_refused() -> None:
    unit = clip()[0][0]
    wrong = replace(unit, header=replace(unit.header, display_width=1280, display_height=720))
    assert VideoDecoder().newest([wrong]) is None


@settings(max_examples=40)
@given(
    st.lists(
        st.tuples(st.integers(0, 15), st.sampled_from(["whole", "gap", "cut", "flip", "noise"]), st.integers(0, 10**6)),
        max_size=12,
    ),
    st.integers(1, 4),
)
def test_after_anything_in_any_order_a_whole_idr_decodes(story: list[tuple[int, str, int]], batch: int) -> None:
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
    for k in range(0, len(units), batch):
        decoder.newest(units[k : k + batch])
    image = decoder.newest([clip()[0][0]])
    assert image is not None
    np.testing.assert_allclose(image.px.astype(int), clip()[1][0], atol=60)


def pave_frame(number: int, payload: bytes, header_size: int = 68, kind: int = FrameType.P, **more: int) -> bytes:
    header = PaveHeader(len(payload), number, 33 * number, kind, header_size=header_size, **more)
    return header.pack() + payload


STREAM = [pave_frame(n, bytes((n * 7 + k) % 251 for k in range(150 + 11 * n)), (64, 68, 76)[n % 3]) for n in range(8)]
BYTES = b"".join(STREAM)
STARTS = [sum(map(len, STREAM[:k])) for k in range(len(STREAM))]


def packed(frames: list[PaveFrame]) -> list[bytes]:
    return [f.header.pack() + f.payload for f in frames]


@needs_captures
@pytest.mark.parametrize(("name", "count", "size"), [("video_56_frames.pave", 56, 68), ("video_starts_on_p_frames.pave", 20, 64)])
def test_captures_come_out_whole_and_pack_to_their_own_bytes(name: str, count: int, size: int) -> None:
    data = (CAPTURES / name).read_bytes()
    frames = frames_of(name)
    assert len(frames) == count
    assert {f.header.header_size for f in frames} == {size}
    assert data.startswith(b"".join(packed(frames)))
    one = frames[-1].header
    assert (one.codec, one.display_width, one.display_height, one.encoded_height) == (4, 640, 360, 368)


@needs_captures
def test_a_jump_in_the_frame_number_is_a_discontinuity() -> None:
    assert [i for i, f in enumerate(frames_of("video_starts_on_p_frames.pave")) if f.discontinuity] == [1]


def test_every_header_field_has_its_place() -> None:
    header = PaveHeader(
        payload_size=0x01020304, frame_number=5, timestamp_ms=6, frame_type=3, version=7, codec=8, header_size=76,
        encoded_width=9, encoded_height=10, display_width=11, display_height=12, total_chunks=13, chunk_index=2, control=1,
        stream_position=1 << 40 | 14, stream_id=15, total_slices=16, slice_index=3, sps_size=17, pps_size=18,
        padding=b"pq", advertised_size=19, reserved=b"reserved-012", extension=b"extension-01",
    )  # fmt: skip
    data = header.pack()
    assert struct.unpack_from("<4sBBHI", data) == (b"PaVE", 7, 8, 76, 0x01020304)
    assert struct.unpack_from("<II", data, 20) == (5, 6)
    assert struct.unpack_from("<IIH", data, 32) == (14, 1 << 8, 15)
    assert struct.unpack_from("<I", data, 48) == (19,)
    small = PaveHeader(4, 1, 2, 3, header_size=76, extension=b"extension-01", chunk_index=1, slice_index=1, control=2)
    assert [frame.header for frame in PaveParser().feed(data + small.pack() + bytes(4))] == [small], "16 MB are not plausible"


@settings(max_examples=400)
@example(0, 0, b"", 1)
@given(
    st.integers(0, STARTS[4]),
    st.integers(0, 400),
    st.one_of(
        st.binary(max_size=300), st.integers(1, 70).map(lambda n: b"PaVE" * n), st.integers(0, 250).map(lambda n: BYTES[:n])
    ),
    st.sampled_from([1, 61, 977, len(BYTES) + 600]),
)
def test_damage_costs_the_frames_it_touches_and_no_other(at: int, lost: int, inserted: bytes, chunk: int) -> None:
    """Bytes lost, inserted or both, at any place: frames that lie wholly before or after come out, the first after marked."""
    data = BYTES[:at] + inserted + BYTES[at + lost :]
    parser = PaveParser()
    frames = [f for k in range(0, len(data), chunk) for f in parser.feed(data[k : k + chunk])]
    out = packed(frames)
    after = [f for f, s in zip(STREAM, STARTS, strict=True) if s >= at + lost]
    before = [f for f, s in zip(STREAM, STARTS, strict=True) if s + len(f) <= at]
    assert out[: len(before)] == before
    assert out[len(out) - len(after) :] == after
    if at not in STARTS and (lost or inserted) and len(out) == len(before) + len(after):
        assert frames[len(before)].discontinuity


@settings(max_examples=200)
@given(st.lists(st.binary(max_size=200), max_size=6))
def test_garbage_never_raises_and_the_stream_behind_it_is_read(chunks: list[bytes]) -> None:
    parser = PaveParser()
    for chunk in chunks:
        parser.feed(chunk)
    assert packed(parser.feed(BYTES))[-len(STREAM) :] == STREAM


def test_an_absurd_size_does_not_swallow_the_stream() -> None:
    liar = PaveHeader(1 << 20, 3, 99, FrameType.P).pack()
    frames = PaveParser().feed(liar + BYTES)
    assert packed(frames) == STREAM
    assert frames[0].discontinuity


def test_an_advertisement_has_no_payload_and_breaks_nothing() -> None:
    advertisement = PaveHeader(0, 1, 33, FrameType.P, control=CONTROL_ADVERTISEMENT, advertised_size=5000).pack()
    frames = PaveParser().feed(STREAM[0] + advertisement + STREAM[1] + STREAM[2])
    assert [f.header.advertisement for f in frames] == [False, True, False, False]
    assert frames[1].payload == b""
    assert not any(f.discontinuity for f in frames)
