"""Make the pilot that replays a recording: as it was recorded, with other settings, or with another steering path."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import get_args

import msgspec

from companion.guidance.make_pilot import make_pilot
from companion.guidance.pilot import Pilot
from companion.recording.reading import CAMERA, PAD, Recording
from companion.settings.load import Settings, load
from companion.settings.model import CameraSettings, PadSettings
from estimator import pipeline
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import PathName
from estimator.options import EstimatorOptions


def available_paths() -> tuple[PathName, ...]:
    """Return the paths that the estimator can run."""
    found: list[PathName] = []
    for name in get_args(PathName):
        try:
            pipeline.start(EstimatorOptions(path=name))
        except ValueError:
            continue
        found.append(name)
    return tuple(found)


def settings_of(recording: Recording, config: str | None) -> Settings:
    """Return the settings in `config` if it is given, else those that the recording was made with.

    Raises:
        BadInput: neither is available.
    """
    if config is not None:
        return load(config)
    try:
        settings = recording.settings()
    except BadInput as why:
        raise BadInput(f"{why} (made by another version? name settings with --config)") from why
    if settings is None:
        raise BadInput(f"{recording.name}: holds no settings; name some with --config")
    return settings


def pilot_of(recording: Recording, settings: Settings, path: PathName | None, *, own_camera: bool, alone: bool = False) -> Pilot:
    """Return a pilot that runs every path (or one `alone`) and steers by `path` (else by the settings' own).

    Args:
        own_camera: use the camera and the pad of the recording instead of those that the settings name.

    Raises:
        BadInput: a camera or pad file is missing or has a fault, or there is no such path.
    """
    paths = available_paths()
    steering = path or settings.estimator.path
    if steering not in paths:
        raise BadInput(f"--path {steering}: there are {', '.join(paths)}")
    shadows = [] if alone else [p for p in paths if p != steering]
    # The path bypasses the settings' own check, so that paths that the settings do not offer can be compared.
    estimator = msgspec.structs.replace(settings.estimator, path=steering)
    with tempfile.TemporaryDirectory(prefix="decklander-") as folder:
        if own_camera and CAMERA in recording.attachments and PAD in recording.attachments:
            for name in (CAMERA, PAD):
                (Path(folder) / name).write_bytes(recording.attachments[name])
            settings = msgspec.structs.replace(
                settings,
                camera=CameraSettings(str(Path(folder) / CAMERA), gimbal=settings.camera.gimbal),
                pad=PadSettings(str(Path(folder) / PAD)),
            )
        return make_pilot(msgspec.structs.replace(settings, estimator=estimator), shadows=shadows)
