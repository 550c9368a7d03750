"""Frames as H.264 in a recording: any frame can be requested, damage stays within its group, and a part is a video again."""

import base64
import json
from pathlib import Path

import av
import numpy as np
import pytest
from mcap.reader import make_reader

from companion.cli import main as cli
from companion.recording.frame_encoder import KEY_EACH, RECORDED, FrameEncoder, FrameSequence, is_key_frame
from companion.recording.reading import RecordedFrame, Recording, open_recording
from tests.fly import record_to


def moving_picture(n: int) -> list[np.ndarray]:
    """Return n frames of a bright square that moves over a gradient."""
    ground = np.repeat(np.linspace(20, 120, 96, dtype=np.uint8)[:, None, None], 128, axis=1).repeat(3, axis=2)
    out = []
    for k in range(n):
        image = ground.copy()
        image[30:60, k : k + 30] = (40, 200, 240)
        out.append(image)
    return out


def test_any_frame_can_be_requested_and_looks_as_it_was() -> None:
    images = moving_picture(40)
    encoder, sequence = FrameEncoder(RECORDED), FrameSequence()
    units = [encoder.encoded(image) for image in images]
    assert [k for k, unit in enumerate(units) if is_key_frame(unit)] == [0, KEY_EACH]
    frames = [sequence.add(unit) for unit in units]
    for k in (39, 3, 4, 29, 31, 0):
        frame = frames[k]
        assert frame is not None
        px = frame.px()
        assert px is not None
        assert np.abs(px.astype(int) - images[k]).mean() < 4.0
    assert sum(map(len, units)) < 40 * 128 * 96 / 10


def test_what_is_missing_or_damaged_gives_no_frame_until_the_next_key_frame() -> None:
    encoder, sequence = FrameEncoder(RECORDED), FrameSequence()
    units = [encoder.encoded(image) for image in moving_picture(KEY_EACH + 5)]
    assert sequence.add(units[5]) is None, "nothing before the first key frame"
    for junk in (b"", b"\0" * 40, b"\0\0\1", b"\0\0\1\x65" + bytes(range(200))):
        found = FrameSequence().add(junk)
        assert found is None or found.px() is None
    frames = [sequence.add(unit) for unit in units[:3]] + [sequence.add(b"\0\0\1\x41\xff\xff")] + [sequence.add(units[KEY_EACH])]
    assert frames[2] is not None
    assert frames[2].px() is not None
    assert frames[4] is not None
    assert frames[4].px() is not None


def test_an_odd_size_is_refused_and_a_changed_size_begins_again() -> None:
    encoder = FrameEncoder(RECORDED)
    with pytest.raises(ValueError, match="even width and height, got 127x96 px"):
        encoder.encoded(np.zeros((96, 127, 3), np.uint8))
    assert is_key_frame(encoder.encoded(np.zeros((96, 128, 3), np.uint8)))
    assert not is_key_frame(encoder.encoded(np.zeros((96, 128, 3), np.uint8)))
    assert is_key_frame(encoder.encoded(np.zeros((64, 64, 3), np.uint8)))


def images_of(recording: Recording) -> list[np.ndarray]:
    camera = recording.camera()
    assert camera is not None
    found = (e.frame((camera.width, camera.height)) for e in recording.events() if isinstance(e, RecordedFrame))
    return [frame.px for frame in found if frame is not None]


def test_a_recording_holds_a_video_that_viewers_and_replay_read(tmp_path: Path) -> None:
    path, part = tmp_path / "flight.mcap", tmp_path / "part.mcap"
    flown = record_to(path, seconds=1.2, frames="h264")
    images = images_of(open_recording([path]))
    assert len(images) == len(flown.frames) > 20
    for px, seen in zip(images, flown.frames, strict=True):
        assert np.abs(px.astype(int) - seen.frame.px).mean() < 6.0
    with path.open("rb") as stream:
        units = [
            (schema.name, message.data) for schema, _, message in make_reader(stream).iter_messages(topics=["/camera/video"])
        ]
    assert {name for name, _ in units} == {"foxglove.CompressedVideo"}
    decoder = av.CodecContext.create("h264", "r")
    whole = b"".join(base64.b64decode(json.loads(data)["data"]) for _, data in units)
    packets = [*decoder.parse(whole), *decoder.parse()]
    decoded = [frame for packet in packets for frame in decoder.decode(packet)] + list(decoder.decode(None))
    assert len(decoded) == len(images)
    assert cli.main(["record", "cut", str(path), "--output", str(part), "--from", "0.5"]) == 0
    assert 5 < len(images_of(open_recording([part]))) < len(images)
    assert cli.main(["report", str(path), "--output", str(tmp_path / "page.html")]) == 0
    assert "film-0" in (tmp_path / "page.html").read_text()
