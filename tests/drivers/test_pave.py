import struct

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.ardrone.pave import CONTROL_ADVERTISEMENT, FrameType, PaveFrame, PaveHeader, PaveParser
from tests.drivers.captures import CAPTURES, frames_of, needs_captures


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
    parser = PaveParser()
    frames = parser.feed((CAPTURES / "video_starts_on_p_frames.pave").read_bytes())
    assert [i for i, f in enumerate(frames) if f.discontinuity] == [1]
    assert parser.number_gaps == 194


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
    assert PaveHeader.unpack(small.pack()) == small
    assert PaveHeader.unpack(data) is None, "16 MB of payload are not plausible"


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
    parser = PaveParser()
    frames = parser.feed(liar + BYTES)
    assert packed(frames) == STREAM
    assert parser.torn == 1
    assert frames[0].discontinuity


def test_an_advertisement_has_no_payload_and_breaks_nothing() -> None:
    advertisement = PaveHeader(0, 1, 33, FrameType.P, control=CONTROL_ADVERTISEMENT, advertised_size=5000).pack()
    frames = PaveParser().feed(STREAM[0] + advertisement + STREAM[1] + STREAM[2])
    assert [f.header.advertisement for f in frames] == [False, True, False, False]
    assert frames[1].payload == b""
    assert not any(f.discontinuity for f in frames)
