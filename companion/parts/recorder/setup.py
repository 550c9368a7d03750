"""Make the recorders that the settings describe, restartable beside a flight, and the metadata of every recording."""

import platform
from collections.abc import Callable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Literal

from companion.base.containment import CallGuard, RestartablePart
from companion.base.health import Health
from companion.cycle.ports import Assembly
from companion.parts.recorder.folder import Folder, SingleFile, start_of
from companion.parts.recorder.recorder import PART, Recorder
from companion.recording.channels import CAMERA, PAD, SETTINGS
from companion.recording.mcap_file import About, Attachment
from companion.settings import schema
from companion.settings.load import body_camera, find_file, pad_model
from companion.settings.model import Settings
from companion.settings.service import FrameForm, RecorderOptions
from drivers.clock import wall_offset_ns
from estimator.contracts.time import Clock, MonoNs
from estimator.vision.camera.camera import Camera

_PACKAGES = ("decklander", "numpy", "opencv-python-headless", "av", "mcap")


def about(settings: Settings, flight: Mapping[str, str], offset_ns: int = 0, named: Settings | None = None) -> About:
    """Return versions, settings (or those `named`), camera and pad, and the facts in `flight`, as a scenario and seed.

    Raises:
        BadInput: the camera or pad file is missing.
    """
    files = [Attachment(SETTINGS, "application/toml", schema.toml(named or settings).encode())]
    for name, text, folder in ((CAMERA, settings.camera.file, "cameras"), (PAD, settings.pad.file, "pads")):
        path = find_file(text, folder, Path(), name)
        files.append(Attachment(name, "application/toml", path.read_bytes()))
    return About({"versions": versions(), "flight": dict(flight)}, files, offset_ns, pad_model(settings))


def versions() -> dict[str, str]:
    """Return the versions of everything that a result may depend on."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "unknown"
    return found


def recorder_of(settings: Settings, clock: Clock, health: Health) -> Recorder:
    """Return the service's recorder; it is paused if it is not enabled, so that an operator may start it.

    Raises:
        BadInput: the camera or pad file is missing.
    """
    r = settings.recorder
    storage_policy = Folder(Path(r.folder), start_of(Path(r.folder)), r.max_file_mb, r.max_total_mb, r.min_free_mb, r.delete)
    described = about(settings, {"kind": "service"}, wall_offset_ns(clock))
    recorder = Recorder(storage_policy, body_camera(settings), described, r, health, close_s=1.5)
    if not r.enabled:
        recorder.switch(False)
    return recorder


def recorder_to_file(path: Path, camera: Camera, described: About, *, frames: FrameForm = "jpeg", live: bool = False) -> Recorder:
    """Return a recorder of one flight into one file. A flight in virtual time waits for the disk; a `live` one never does."""
    options = RecorderOptions(frames=frames)
    return Recorder(SingleFile(path), camera, described, options, lossless=not live)


class RecorderBeside(RestartablePart[Recorder]):
    """The restartable recorder; see `RestartablePart`."""

    def __init__(self, make: Callable[[], Recorder], health: Health) -> None:
        self._wanted: bool | None = None
        self._guard = CallGuard(f"{PART}.on_link", health)
        super().__init__(PART, lambda: self._as_wanted(make()))

    @property
    def rests(self) -> bool:
        """True if it takes nothing: it is paused, or being started again."""
        return self.now is None or self.now.rests

    def switch(self, on: bool) -> str | None:
        """Start or stop recording for the operator; return the reason if that is impossible, else None."""
        self._wanted = on
        return self.now.switch(on) if self.now is not None else ("the recorder failed; it is being started again" if on else None)

    def on_link(self, at: MonoNs, link: str, direction: Literal["in", "out"], data: bytes, name: str | None = None) -> None:
        """Record one message of a link. Links call this between the vehicle and guidance, so it never raises."""
        if self.now is not None and not self.now.rests:
            self._guard.call(self.now.on_link, at, link, direction, data, name)

    def _as_wanted(self, recorder: Recorder) -> Recorder:
        if self._wanted is not None:
            recorder.switch(self._wanted)
        return recorder


def join(service: Assembly) -> None:
    """Add the recorder, which an operator may switch."""
    settings, clock, health = service.settings, service.clock, service.health
    recorder = RecorderBeside(lambda: recorder_of(settings, clock, health), health)
    service.observers.append(recorder)
    service.extras[PART] = recorder.run
    service.recording, service.tap = recorder.switch, recorder.on_link
