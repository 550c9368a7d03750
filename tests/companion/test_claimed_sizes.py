"""Images that claim gigabytes, given to every command that reads images: one line, exit code 2, and no decoder is asked."""

from pathlib import Path

import cv2
import pytest

from companion.cli.main import main
from companion.recording.reading import RecordedFrame, open_recording
from tests.support.image_files import claiming

GOLDEN = Path(__file__).parents[1] / "golden/frames.mcap"


@pytest.fixture(autouse=True)
def _no_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError("the decoder was asked")

    monkeypatch.setattr(cv2, "imdecode", never)
    monkeypatch.setattr(cv2, "imread", never)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("side", [16384, 30000])
def test_detect_and_calibrate_name_the_image_and_its_claim(tmp_path, capsys, suffix, side):
    path = tmp_path / f"bomb{suffix}"
    path.write_bytes(claiming(suffix, side, side))
    assert path.stat().st_size < 1000
    for words, output in (
        (["detect", str(path), "--camera", "sim"], f"{side}x{side} px, but"),
        (
            ["calibrate", "camera", str(path), "--out", str(tmp_path / "camera.toml")],
            f"{side}x{side} px, expected at most 67 million pixels",
        ),
    ):
        assert main(words) == 2
        err = capsys.readouterr().err.strip().splitlines()
        assert len([line for line in err if "bomb" in line]) == 1
        assert output in "".join(err)
        assert "Traceback" not in "".join(err)


def test_a_recorded_image_of_another_size_than_the_camera_s_is_not_decoded() -> None:
    recorded = next(e for e in open_recording([GOLDEN]).events() if isinstance(e, RecordedFrame) and e.image is not None)
    bomb = RecordedFrame(recorded.record, claiming(".png", 30000, 30000))
    assert bomb.frame((640, 360)) is None
