"""The readers of others' files as importers (`drivers.importer.Read`)."""

from collections.abc import Iterable

from drivers.importer import ForeignFile
from drivers.imports import dataflash, pictures, px4_ulog, tlog
from estimator.contracts.samples import Frame, Sample


def ulog(file: ForeignFile) -> Iterable[Sample]:
    """Read a PX4 log."""
    return px4_ulog.read(file.path, file.tell)


def dataflash_log(file: ForeignFile) -> Iterable[Sample]:
    """Read a dataflash log."""
    return dataflash.read(file.path, file.tell)


def telemetry_log(file: ForeignFile) -> Iterable[Sample]:
    """Read a telemetry log of a ground station."""
    return tlog.read(file.path, file.tell)


def images(file: ForeignFile) -> Iterable[Frame]:
    """Read a folder of images."""
    return pictures.folder_frames(file.path, file.size, file.tell)


def attitudes(file: ForeignFile) -> Iterable[Sample]:
    """Read a table of attitudes."""
    return pictures.attitudes(file.path, file.tell)


def video(file: ForeignFile) -> Iterable[Frame]:
    """Read a video."""
    return pictures.video_frames(file.path, file.size)
