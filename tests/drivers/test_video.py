"""The video of an AR.Drone 2.0 out of any stream, and images as they are decoded, whatever is lost or damaged."""

import contextlib
import resource
import struct
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.ardrone.pave import CONTROL_ADVERTISEMENT, FrameType, PaveFrame, PaveHeader, PaveParser, VideoDecoder
from drivers.camera.images import MOST_PIXELS, ImageRefused, claimed_size, decode
from drivers.camera.v4l2_frames import FrameLayout, H264Decoder, to_bgr
from drivers.camera.videos import open_video
from drivers.imports import pictures
from estimator.contracts.errors import BadInput
from tests.drivers.captures import CAPTURES, frames_of, needs_captures
from tests.support.image_files import claiming, encoded

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
        difference = image.px.astype(int) - px
        assert np.abs(difference).mean() < 4
        assert np.abs(difference.mean(axis=(0, 1))).max() < 4, "blue, green and red in their places"
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


FORMATS = [".jpg", ".png", ".bmp", ".tif", ".webp", ".ppm"]


def peak_mib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


@pytest.fixture
def untouched(monkeypatch: pytest.MonkeyPatch) -> None:
    """No decoder may be reached."""

    def never(*_: object) -> None:
        raise AssertionError("the decoder was asked")

    monkeypatch.setattr(cv2, "imdecode", never)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("size", [(64, 48), (641, 359)])
def test_the_header_gives_the_size_that_the_decoder_finds(suffix: str, size: tuple[int, int]) -> None:
    data = encoded(suffix, *size)
    assert claimed_size(data) == size
    assert decode(data, size).shape == (size[1], size[0], 3)
    with pytest.raises(ImageRefused, match=f"{size[0]}x{size[1]} px, expected 640x480 px"):
        decode(data, (640, 480))


def test_a_progressive_jpeg_with_fill_bytes_and_a_lossless_webp() -> None:
    px = np.full((48, 64, 3), 90, np.uint8)
    progressive = cv2.imencode(".jpg", px, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    assert claimed_size(progressive) == (64, 48)
    assert claimed_size(progressive.replace(b"\xff\xc2", b"\xff\xff\xff\xc2", 1)) == (64, 48)
    assert claimed_size(cv2.imencode(".webp", px, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()) == (64, 48)


@pytest.mark.usefixtures("untouched")
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("side", [16384, 30000])
def test_a_claim_of_gigabytes_never_reaches_the_decoder(suffix: str, side: int) -> None:
    bomb = claiming(suffix, side, side)
    assert len(bomb) < 1000
    with pytest.raises(ImageRefused, match=f"{side}x{side} px, expected at most {MOST_PIXELS / 1e6:.0f} million"):
        decode(bomb)
    with pytest.raises(ImageRefused, match="expected 640x480"):
        decode(bomb, (640, 480))
    if suffix == ".jpg":
        assert to_bgr(bomb, FrameLayout("MJPG", 640, 480, 0)) is None


def test_a_tag_of_orientation_turns_nothing() -> None:
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    data = encoded(".jpg")
    tagged = data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:]
    assert np.array_equal(decode(tagged, (64, 48)), decode(data))


def scene(seed: int) -> np.ndarray:
    """Return a picture of flat parts, edges, a gradient and grain, (240, 320, 3)."""
    rng = np.random.default_rng(seed)
    px = np.repeat(np.linspace(60, 140, 320)[None, :, None], 240, 0) + np.zeros((240, 320, 3))
    for _ in range(12):
        x, y, w, h = rng.integers(0, 260, 4)
        cv2.rectangle(px, (int(x), int(y)), (int(x + w // 4), int(y + h // 4)), rng.uniform(0, 255, 3).tolist(), -1)
    return np.clip(px + rng.normal(0, 3, px.shape), 0, 255).astype(np.uint8)


AROUND = [(b"", b"\r\n"), (b"", b"\xff" * 64), (b"", bytes(64)), (b"", b"\x12\xa0\x55" * 200), (b"\0", b""), (b"\r\n\r\n", b"\0")]


@pytest.mark.parametrize(("before", "after"), AROUND)
def test_bytes_around_a_whole_jpeg_are_no_damage(before: bytes, after: bytes) -> None:
    whole = cv2.imencode(".jpg", scene(1))[1].tobytes()
    assert np.array_equal(decode(before + whole + after, (320, 240)), decode(whole))


@pytest.mark.parametrize("interval", [0, 8])
@pytest.mark.parametrize("progressive", [0, 1])
def test_a_jpeg_torn_in_the_middle_is_refused(progressive: int, interval: int) -> None:
    """Both end marks are whole; libjpeg would fill or shift what follows, and only warn."""
    options = [cv2.IMWRITE_JPEG_QUALITY, 80, cv2.IMWRITE_JPEG_PROGRESSIVE, progressive, cv2.IMWRITE_JPEG_RST_INTERVAL, interval]
    whole, other = (cv2.imencode(".jpg", scene(seed), options)[1].tobytes() for seed in (2, 3))
    rng = np.random.default_rng(4)
    begin = whole.index(b"\xff\xda") + 14
    taken = 0
    for n in range(200):
        at, size = int(rng.integers(begin, len(whole) - 700)), int(rng.integers(20, 600))
        torn = (
            whole[:at] + whole[at + size :],
            whole[:at] + bytes(size) + whole[at + size :],
            whole[:at] + other[at:-2] + b"\xff\xd9",
            whole[:at] + b"\xff\xd9",
            whole[:at] + rng.bytes(size) + whole[at + size :],
        )[n % 5]
        with contextlib.suppress(ImageRefused):
            taken += decode(torn, (320, 240)) is not None
    assert taken <= 8, "some gaps leave what an encoder might have written: docs/decisions/camera-drivers.md"
    for scan in range(1, whole.count(b"\xff\xda")):  # a progressive one that ends between two of its scans is a coarse picture
        with pytest.raises(ImageRefused, match="ends before its last scan"):
            decode(b"\xff\xda".join(whole.split(b"\xff\xda")[: scan + 1]) + b"\xff\xd9")


def test_most_flipped_bits_that_shift_what_follows_are_refused() -> None:
    """A wrong bit that leaves valid codes shifts the brightness of all blocks behind it, and no decoder warns."""
    rng, shifted, refused = np.random.default_rng(6), 0, 0
    for seed in range(80):
        px = slanted(seed)
        whole = cv2.imencode(".jpg", px, [cv2.IMWRITE_JPEG_QUALITY, 75])[1].tobytes()
        clean = decode(whole)
        begin = whole.index(b"\xff\xda") + 14
        torn = bytearray(whole)
        torn[int(rng.integers(begin, len(whole) - 2))] ^= 1 << int(rng.integers(8))
        seen = cv2.imdecode(np.frombuffer(bytes(torn), np.uint8), cv2.IMREAD_COLOR)
        if (np.abs(seen.astype(int) - clean).max(axis=2) > 12).mean() < 0.05:
            continue
        shifted += 1
        try:
            decode(bytes(torn))
        except ImageRefused:
            refused += 1
    assert shifted > 12
    assert refused > 0.7 * shifted, f"{refused} of {shifted}"


@pytest.mark.parametrize("quality", [10, 40, 75, 95])
@pytest.mark.parametrize("factor", [cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422])
def test_no_whole_jpeg_is_refused_for_its_edges(quality: int, factor: int) -> None:
    """Horizons of all slants, bars along the rows of blocks, and haze."""
    for seed in range(24):
        px = slanted(seed)
        if seed % 3 == 0:
            px[: 16 * (seed % 5 + 1)] = 0
        if seed % 4 == 0:
            px = (200 + px.astype(int) // 10).astype(np.uint8)
        options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, factor]
        decode(cv2.imencode(".jpg", px, options)[1].tobytes())


def slanted(seed: int) -> NDArray[np.uint8]:
    """Return an image of 320x240 px: a flat deck and the sea behind an edge that is nearly level, with noise."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:240, :320]
    edge = rows - rng.uniform(40, 200) - rng.uniform(-0.15, 0.15) * (columns - 160)
    part = np.clip(edge / rng.uniform(0.5, 3.0), -1.0, 1.0)[..., None]
    px = rng.uniform(60, 200, 3) + part * rng.uniform(-50, 50, 3) + rng.normal(0, 2, (240, 320, 3))
    return np.clip(px, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("suffix", "bits"), [(".png", 10), (".png", 12), (".png", 16), (".tif", 14), (".pgm", 10), (".pgm", 5)])
def test_deep_images_are_scaled_by_what_they_state(suffix: str, bits: int) -> None:
    grey = np.tile(np.arange(256, dtype=np.float64), (48, 1))
    deep = np.rint(grey / 255 * ((1 << bits) - 1)).astype(np.uint16)
    if suffix == ".pgm":
        raw = deep.astype(">u2" if bits > 8 else np.uint8).tobytes()
        data = b"P5\n# a comment 7\n256 48\n%d\n" % ((1 << bits) - 1) + raw
    else:
        data = cv2.imencode(suffix, deep)[1].tobytes()
    px = decode(data, (256, 48))
    assert px.dtype == np.uint8
    assert np.abs(px[:, :, 1] - grey).max() <= 255 / ((1 << bits) - 1) / 2 + 0.5


@settings(max_examples=60)
@given(st.one_of(st.binary(max_size=80), st.tuples(st.sampled_from(FORMATS), st.integers(0, 60), st.binary(max_size=8))))
def test_no_bytes_raise_anything_else(what: bytes | tuple[str, int, bytes]) -> None:
    if isinstance(what, tuple):
        suffix, at, junk = what
        data = bytearray(encoded(suffix))
        data[at : at + len(junk)] = junk
        what = bytes(data)
    with contextlib.suppress(ImageRefused):
        assert decode(what, (64, 48)).shape == (48, 64, 3)


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a short video of 3072 pixels square in some 30 kB."""
    path = tmp_path_factory.mktemp("videos") / "large.h264"
    with av.open(str(path), "w") as out:
        stream = out.add_stream("libx264", rate=10, options={"preset": "ultrafast"})
        stream.width = stream.height = 3072
        stream.pix_fmt = "yuv420p"
        frame = av.VideoFrame(3072, 3072, "yuv420p")
        for plane in frame.planes:
            plane.update(bytes(plane.buffer_size))
        out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
    return path


def test_a_video_of_far_larger_frames_is_refused_before_it_is_decoded(large: Path) -> None:
    assert large.stat().st_size < 100_000
    before = peak_mib()
    with pytest.raises(ImageRefused, match="frames of 3072x3072 px, expected 640x480 px"):
        open_video(str(large), (640, 480))
    with pytest.raises(BadInput, match=r"large\.h264: not a readable video: frames of 3072x3072 px"):
        next(pictures.video_frames(large, (640, 480)))
    decoder = H264Decoder()
    assert decoder.decode(large.read_bytes(), FrameLayout("H264", 640, 480, 0)) is None
    assert decoder.waiting
    assert peak_mib() - before < 20
    with open_video(str(large)) as container:
        assert next(container.decode(video=0)).width == 3072
