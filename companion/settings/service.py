"""The table [recorder] of the settings."""

from typing import Annotated, ClassVar, Literal

from estimator.contracts.keys import CheckedOptions, choice, text, tuning

FrameForm = Literal["jpeg", "h264", "png", "none"]


class RecorderOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Recordings of everything the service receives, decides and says, as MCAP files (docs/recordings.md).

    Raises:
        ValueError: a number outside its range, or numbers that do not go together.
    """

    enabled: Annotated[bool, choice("whether the service records from its start on", public=True, page=True)] = False
    folder: Annotated[str, text("where recordings go, from the working directory", 4096, public=True)] = "recordings"
    frames: Annotated[
        FrameForm,
        choice(
            "how frames are kept: as a video, a twentieth of the size of images; as images; exactly, ten times the size; or not "
            "at all",
            public=True,
            page=True,
        ),
    ] = "jpeg"
    jpeg_quality: Annotated[int, tuning("quality of JPEG frames", "1", 50, 100)] = 90
    max_file_mb: Annotated[float, tuning("a file that is larger ends, and a new one begins", "MB", 1.0, 100_000.0)] = 500.0
    max_file_s: Annotated[float, tuning("a file that is longer ends, and a new one begins", "s", 1.0, 86_400.0)] = 600.0
    max_total_mb: Annotated[
        float,
        tuning("while all recordings in the folder are larger than this, one is deleted", "MB", 1.0, 10_000_000.0, public=True),
    ] = 8000.0
    delete: Annotated[
        Literal["oldest", "uploaded"],
        choice("the oldest, or the oldest that `record upload` has uploaded; nothing is recorded while there is none", page=True),
    ] = "oldest"
    min_free_mb: Annotated[
        float, tuning("nothing is recorded while less than this is free on the disk", "MB", 0.0, 1_000_000.0, public=True)
    ] = 500.0
    flush_s: Annotated[
        float, tuning("interval between written chunks, the most that a killed process loses", "s", 0.01, 60.0)
    ] = 1.0
    sync_s: Annotated[
        float, tuning("interval between synchronisations with the disk, the most that a power cut loses", "s", 0.1, 600.0)
    ] = 5.0
    queue_records: ClassVar[int] = 4096  # Records that may wait for the disk; further ones are dropped and counted
    queue_frames: ClassVar[int] = 15  # Frames among them, about 0.7 MB each

    retry_s: Annotated[
        float, tuning("back-off before the disk or folder is tried again after a fault; it doubles each time", "s", 0.01, 60.0)
    ] = 5.0
    retry_cap_s: Annotated[float, tuning("longest such back-off", "s", 0.01, 600.0)] = 60.0

    ORDER = ("max_file_mb <= max_total_mb", "retry_s <= retry_cap_s")
