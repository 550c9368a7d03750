"""The size that an image claims is compared before it is decoded: a small file cannot take gigabytes."""

import contextlib
import resource
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera import images
from drivers.camera.images import MOST_PIXELS, ImageRefused, claimed_size, decode
from drivers.camera.v4l2_formats import FrameLayout, H264Decoder, to_bgr
from drivers.camera.videos import open_video
from drivers.imports import video
from estimator.contracts.errors import BadInput
from tests.support.image_files import claiming, encoded

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
def test_the_header_tells_the_size_that_the_decoder_finds(suffix: str, size: tuple[int, int]) -> None:
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


def test_a_file_without_end_is_read_no_further_than_an_image_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(images, "MOST_BYTES", 1 << 20)
    with pytest.raises(ImageRefused, match="more than 1 MiB"):
        images.load(Path("/dev/zero"))


def test_an_image_on_its_side_is_turned_only_where_that_is_asked_for() -> None:
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    data = encoded(".jpg")
    turned = data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:]
    assert decode(turned, (64, 48)).shape == (48, 64, 3)
    assert decode(turned, (48, 64), turned=True).shape == (64, 48, 3)
    with pytest.raises(ImageRefused, match="48x64 px, expected 64x48"):
        decode(turned, (64, 48), turned=True)


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
    """A short video of 3072 pixels square in some 30 kB."""
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
        next(video.frames(large, (640, 480)))
    decoder = H264Decoder()
    assert decoder.decode(large.read_bytes(), FrameLayout("H264", 640, 480, 0)) is None
    assert decoder.waiting
    assert peak_mib() - before < 20
    with open_video(str(large)) as container:
        assert next(container.decode(video=0)).width == 3072
