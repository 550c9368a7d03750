"""The ways by which pictures come in, and what each of them refuses: a fault that is mended at one way is mended at all."""

import asyncio
import contextlib
import importlib
import io
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import msgspec
import numpy as np
import pytest

from companion.cli.main import main
from companion.tools.calibrate.board import Collection
from companion.tools.calibrate.guide import add_file
from drivers.ardrone.pave import VideoDecoder
from drivers.camera.images import ImageRefused
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions
from drivers.camera.v4l2_frames import FrameLayout, H264Decoder
from drivers.camera.videos import WholeFrames
from drivers.clock import SystemClock
from drivers.imports.pictures import video_frames
from estimator.contracts.errors import DecklanderError
from tests.companion.test_calibrate import CHARUCO
from tests.drivers.test_v4l2_streams import camera_options, real
from tests.drivers.test_video import clip
from tests.support.image_files import film

Cell = Callable[[Path], str] | str
"""A way's treatment of such pictures: a reader of an interlaced video that returns what was said, a test by name, or a reason."""
W, H, N = 640, 360, 60
INTERLACED = {"flags": "+ilme+ildct", "x264-params": "tff=1:bframes=0", "preset": "ultrafast", "g": "10"}


def video(path: Path, fields: bool = True, n: int = N) -> Path:
    """Write frames at 25 Hz, more than FFmpeg reads to find a format, interlaced unless they are of one instant."""
    greys = [np.full((H, W, 3), 4 * k, np.uint8) for k in range(n)]
    return film(path, greys, **(INTERLACED if fields else {"preset": "ultrafast"}))


def units() -> list[bytes]:
    """Return access units of an interlaced video in Annex B, the first of them an IDR."""
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt, codec.framerate = W, H, "yuv420p", Fraction(25)
    codec.options = {"preset": "ultrafast", "tune": "zerolatency", **INTERLACED}
    px = np.zeros((H, W, 3), np.uint8)
    return [bytes(p) for _ in range(4) for p in codec.encode(av.VideoFrame.from_ndarray(px, format="bgr24"))]


def read_video(source: str, device: str) -> str:
    """Return what a camera's end or its state says, and how many frames came before."""

    async def frames() -> str:
        options = CameraOptions(source=source, device=device) if source == "stream" else camera_options(device)
        async with asyncio.timeout(60), open_camera(options, (W, H), SystemClock()) as camera:
            while camera.counters.restarts["failed"] == 0:
                try:
                    await asyncio.wait_for(camera.frames.get(), 0.1)
                    return "a frame"
                except TimeoutError:
                    continue
            return camera.down or ""

    try:
        return asyncio.run(frames())
    except DecklanderError as why:
        return str(why)


def by_file(path: Path) -> str:
    return read_video("stream", str(path))


def by_stream(path: Path) -> str:
    def serve() -> None:
        client, _ = server.accept()
        with client, contextlib.suppress(OSError):  # the reader has seen enough
            data = path.read_bytes()
            for at in range(0, len(data), len(data) // N):
                client.sendall(data[at : at + len(data) // N])
                time.sleep(0.01)

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=serve, daemon=True).start()
        return read_video("stream", f"tcp://127.0.0.1:{server.getsockname()[1]}")


def by_detect(path: Path) -> str:
    with contextlib.redirect_stderr(io.StringIO()) as said:
        assert main(["detect", str(path), "--camera", "sim"]) == 2
    return said.getvalue()


def by_gstreamer(_: Path) -> str:
    return read_video("gstreamer", f"videotestsrc ! video/x-raw,width={W},height={H},interlace-mode=interleaved,framerate=25/1")


def by_import(path: Path) -> str:
    with pytest.raises(DecklanderError) as why:
        list(video_frames(path, (W, H)))
    return str(why.value)


def by_calibrate(path: Path) -> str:
    with pytest.raises(DecklanderError) as why:
        add_file(path, Collection(CHARUCO, moving=True), lambda collection: None)
    return str(why.value)


def by_units(path: Path) -> str:
    """Return the refusal of what takes access units: a camera that sends H.264, an AR.Drone, our own recordings."""
    decoder, layout = H264Decoder(), FrameLayout("H264", W, H, 0)
    assert [decoder.decode(unit, layout) for unit in units()] == [None] * len(units())
    drone = [replace(whole, payload=unit) for whole, unit in zip(clip(4)[0], units(), strict=True)]
    assert VideoDecoder().newest(drone) is None
    return " ".join(SAID)


SAID = ("interlaced", "two instants", "progressive")
V4L2, STREAMS, CLIPS = "tests.drivers.test_v4l2.", "tests.drivers.test_v4l2_streams.", "tests.drivers.test_video."
FILES, BAGS, DDS = "tests.drivers.imports.test_imports.", "tests.companion.ros2.test_bag.", "tests.companion.ros2.test_dds."
DETECT = "tests.companion.test_detect."
ROWS = STREAMS + "test_a_frame_is_rows_without_their_padding_and_a_hole_in_the_numbers_is_counted"
TOPIC = DDS + "test_an_image_topic_is_a_camera_with_its_own_times"
TORN_JPEG = CLIPS + "test_a_jpeg_torn_in_the_middle_is_refused"
CLAIM = DETECT + "test_detect_and_calibrate_name_the_image_and_its_claim"
DOCTOR = "tests.companion.doctor.test_gather.test_a_camera_of_another_size_that_is_slow"
LARGE = CLIPS + "test_a_video_of_far_larger_frames_is_refused_before_it_is_decoded"
DECODED, ALONE = "a decoder gives out whole lines", "a picture alone has no place in which it could say so"
OWN = "it is the lens that is to be found, and its size is the pictures'"
NO_LENS = "nothing in it says what lens took it"
WAYS: dict[str, tuple[Cell, Cell, Cell, Cell, Cell]] = {
    # way: interlaced, torn, of another size, of odd lines, of another lens
    "V4L2": (
        V4L2 + "test_pictures_of_two_instants_are_refused_by_what_the_driver_says",
        V4L2 + "test_a_share_of_torn_frames_is_reported_with_its_cure",
        V4L2 + "test_an_image_that_claims_another_size_is_named_once_and_counted",
        V4L2 + "test_a_line_that_cannot_hold_the_width_is_one_error_with_its_numbers",
        NO_LENS,
    ),
    "V4L2 with H.264": (
        by_units, V4L2 + "test_h264_waits_for_an_image_that_stands_alone_after_any_damage",
        V4L2 + "test_torn_bytes_are_refused_and_never_raise", DECODED, NO_LENS,
    ),
    "libcamera": (
        "its sensors expose each frame once", STREAMS + "test_each_end_has_its_error",
        "tests.drivers.test_libcamera.test_settings_that_the_camera_cannot_do_are_one_clear_error", ROWS, NO_LENS,
    ),
    "GStreamer": (
        by_gstreamer, STREAMS + "test_garbage_is_a_lost_camera",
        STREAMS + "test_a_text_that_is_no_pipeline_is_one_clear_error", ROWS, NO_LENS,
    ),
    "topic of ROS 2": (ALONE, TOPIC, TOPIC, TOPIC, TOPIC),
    "stream": (by_stream, TORN_JPEG, DOCTOR, DECODED, NO_LENS),
    "video as a camera": (by_file, STREAMS + "test_what_is_no_video_is_reported_at_once", DOCTOR, DECODED, NO_LENS),
    "AR.Drone": (
        by_units, CLIPS + "test_after_a_gap_or_damage_everything_is_dropped_to_the_next_idr",
        CLIPS + "test_an_image_that_is_not_as_its_header_says_is_refused", DECODED, NO_LENS,
    ),
    "detect, a picture": (
        ALONE, DETECT + "test_a_broken_image_is_named_and_the_others_are_done", CLAIM, DECODED, NO_LENS,
    ),
    "detect, a video": (
        by_detect, "a damaged frame is left out, as `WholeFrames` does at each way of a video",
        DETECT + "test_what_flight_refuses_is_not_found_and_another_size_ends_nothing", DECODED, NO_LENS,
    ),
    "record import, a video": (by_import, FILES + "test_a_raw_video_is_read_at_its_rate", LARGE, DECODED, NO_LENS),
    "record import, a folder": (
        ALONE, FILES + "test_images_without_times_damaged_ones_and_twins_are_named", CLAIM, DECODED, NO_LENS,
    ),
    "bag": (ALONE, BAGS + "test_a_damaged_bag_is_refused_or_reported", TOPIC, TOPIC, "the settings name the camera's file"),
    "calibrate, pictures": (ALONE, CLAIM, CLAIM, DECODED, OWN),
    "calibrate, a video": (by_calibrate, "a damaged frame is left out, as `WholeFrames` does", LARGE, DECODED, OWN),
    "recording": (
        by_units, "tests.companion.test_strange_recordings.test_what_lies_behind_a_damaged_sector_is_still_there",
        DETECT + "test_a_recorded_image_of_another_size_than_the_camera_s_is_not_decoded", DECODED, "it holds its camera",
    ),
}  # fmt: skip


def test_each_source_of_a_camera_is_a_way() -> None:
    options: Any = msgspec.inspect.type_info(CameraOptions)
    source = next(field.type for field in options.fields if field.name == "source")
    named = {"v4l2": "V4L2", "gstreamer": "GStreamer", "ros2": "topic of ROS 2", "vehicle": "AR.Drone"}
    assert {named.get(str(name), str(name)) for name in source.type.values} <= WAYS.keys()


@pytest.mark.parametrize("way", WAYS)
def test_each_cell_is_a_test_or_a_reason(way: str) -> None:
    for cell in WAYS[way]:
        if callable(cell):
            continue
        module, _, name = cell.rpartition(".")
        assert callable(getattr(importlib.import_module(module), name)) if module.startswith("tests.") else " " in cell


@pytest.mark.parametrize(
    "read",
    [
        pytest.param(one, marks=real if one is by_gstreamer else ())
        for one in dict.fromkeys(row[0] for row in WAYS.values())
        if callable(one)
    ],
)
def test_an_interlaced_video_is_refused_in_words_at_each_way(read: Callable[[Path], str], tmp_path: Path) -> None:
    said = read(video(tmp_path / "fields.ts"))
    assert all(word in said for word in SAID), said


def test_a_progressive_video_and_a_claim_of_one_frame_are_read(tmp_path: Path) -> None:
    assert len(list(video_frames(video(tmp_path / "whole.ts", fields=False), (W, H)))) == N
    frames, good = WholeFrames(), av.VideoFrame(W, H, "yuv420p")
    fields = SimpleNamespace(interlaced_frame=True)
    for _ in range(20):
        assert all(frames.px(good) is not None for _ in range(6))
        assert frames.px(fields) is None  # type: ignore[arg-type]
    frames.end()


def test_film_on_television_is_refused_by_two_frames_of_five() -> None:
    frames, good, fields = WholeFrames(), av.VideoFrame(W, H, "yuv420p"), SimpleNamespace(interlaced_frame=True)
    shown: list[Any] = [good, good, good, fields, fields]
    with pytest.raises(ImageRefused, match="interlaced"):
        list(map(frames.px, shown * 3))


def test_a_short_video_of_fields_is_refused_too(tmp_path: Path) -> None:
    with pytest.raises(DecklanderError, match="interlaced"):
        list(video_frames(video(tmp_path / "short.ts", n=2), (W, H)))
