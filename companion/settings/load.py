"""Read the settings of the service from one TOML file.

    settings = load("rig.toml")        # or the name of a shipped profile: load("sim")
    camera, pad = camera_model(settings), pad_model(settings)

`companion.settings.model` has the keys; docs/configuration.md is their page.
"""

import difflib
import errno
import os
import re
import secrets
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from companion.settings.capabilities import vehicle_kind
from companion.settings.files import CREDENTIAL
from companion.settings.guidance import Response, response_from_mapping
from companion.settings.model import PadSettings, Settings, in_file, joined, model_with
from decklander.place import SHIPPED
from drivers.files import Largest, bytes_of
from drivers.vehicle import VehicleOptions
from estimator.attitude_history import DOWN
from estimator.contracts.address import guarded
from estimator.contracts.errors import BadInput, file_errors, refused
from estimator.contracts.tables import imported
from estimator.contracts.text import text_of
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.files import foreign_camera, is_foreign
from estimator.vision.pad.file import Calibration
from estimator.vision.pad.pad import Pad

__all__ = [
    "Settings", "body_camera", "camera_model", "complete", "find_file", "from_file", "from_mapping", "load", "pad_model",
    "read_camera", "read_toml", "response_model", "shipped", "shipped_response",
]  # fmt: skip

_DEEP_PARTS = 50
_PART = r"""(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DEEP_KEY = re.compile(rf"{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{_DEEP_PARTS},}}")
"""A dotted key with this many parts is not one of ours, and the time to read it grows with their square."""
_QUOTED = r"'([^']*)'"
_TUPLE = re.compile(rf"\((?:{_QUOTED},? ?)+\)")
"""A table's name in Python's words."""
_Table = TypeVar("_Table", bound=msgspec.Struct)
KINDS = {
    "vehicle.kind": "a settings file: give it by --config",
    "fx": "a camera file: settings and scenarios name it as camera.file",
    "regions": "a pad file: settings and scenarios name it as pad.file",
    "scenario": "a set of scenarios: give it to decklander campaign",
    "title": "a scenario: give it to decklander simulate or campaign",
}
"""Our kinds of TOML files by a key that only such a file has, or one that is none of those before it."""


def load(name_or_path: str | Path) -> Settings:
    """Return the settings in a file, or those of a shipped profile (`configs/*.toml`) by its bare name.

    The camera and pad files are read too, so that the result can be flown. In the result `camera.file` and `pad.file` name a
    shipped file or are paths relative to the working directory; so are those of keys and certificates.

    Raises:
        BadInput: the file cannot be read or is not TOML; a key is unknown, missing, of the wrong type or out of range; or a
            camera or pad file has such a fault. The text is one line that names the file and the key.
    """
    path = find_file(str(name_or_path), "", Path(), "settings")
    return complete(from_file(read_toml(path, "vehicle.kind"), str(path)), path)


def complete(settings: Settings, path: Path) -> Settings:
    """Return settings that were read from a file with their references resolved, as `load` does.

    Args:
        path: the settings file, to whose folder the references are relative.

    Raises:
        BadInput: keys do not go together, or a file that the settings name is missing or has a fault.
    """
    settings.refuse_faults(str(path))
    camera = _reference(settings.camera.file, "cameras", path, "camera.file")
    pad = _reference(settings.pad.file, "pads", path, "pad.file")
    found = msgspec.structs.replace(settings.camera, file=camera)
    settings = msgspec.structs.replace(settings, camera=found, pad=PadSettings(pad))
    anchored = {name: _anchored(getattr(settings, name), path.parent) for name in settings.__struct_fields__}
    settings = msgspec.structs.replace(settings, **anchored)
    follow = settings.guidance.follow_deck
    if not follow.response_by_vehicle:
        named = _reference(follow.response, "responses", path, "guidance.follow_deck.response")
        guidance = msgspec.structs.replace(settings.guidance, follow_deck=msgspec.structs.replace(follow, response=named))
        settings = msgspec.structs.replace(settings, guidance=guidance)
    camera_model(settings)
    pad_model(settings)
    response_model(settings)
    return settings


def from_file(data: Mapping[str, Any], where: str) -> Settings:
    """Return the settings that the mapping of a settings file describes, with the keys of experts in its table `expert`.

    Args:
        data: the mapping.
        where: name of the file, for errors.

    Raises:
        BadInput: as for `load`, except that camera and pad files are not read. The keys are named as the file has them.
    """
    with refused(where, BadInput):
        tables = joined(data)
    try:
        return from_mapping(tables, where)
    except BadInput as why:
        output = str(why).removeprefix(f"{where}: ")
        key = output.partition(" ")[0].rstrip(":,")
        raise BadInput(f"{where}: {in_file(key)}{output[len(key) :]}") from why


def from_mapping(data: Mapping[str, Any], where: str) -> Settings:
    """Return the settings that whole tables describe, those of experts among them.

    Args:
        data: the tables.
        where: name of their source, for errors.

    Raises:
        BadInput: as for `load`, except that camera and pad files are not read.
    """
    model = Settings
    try:
        kind = _vehicle_of(data)
        model = model_with(kind)
        return _guard(msgspec.convert(_with_defaults_of(kind, data), model, strict=True))
    except BadInput as why:
        raise BadInput(f"{where}: {_shown(str(why), data)}") from None
    except msgspec.ValidationError as why:
        from companion.settings.schema import explain  # it describes the whole model

        raise BadInput(f"{where}: {_shown(explain(model, data, str(why)), data)}") from why


def _vehicle_of(data: Mapping[str, Any]) -> type[VehicleOptions]:
    """Return the table [vehicle] of the kind that the data name; the port itself where they name none, which is refused."""
    vehicle = data.get("vehicle")
    word = vehicle.get("kind") if isinstance(vehicle, Mapping) else None
    found: type[VehicleOptions] = imported(vehicle_kind(word).options) if isinstance(word, str) else VehicleOptions
    return found


def _shown(text: str, data: Mapping[str, Any]) -> str:
    """Return what is written about the tables without the passwords in them."""
    for value in data.values():
        if isinstance(value, Mapping):
            text = _shown(text, value)
        elif isinstance(value, str):
            text = text.replace(value, str(guarded(value))) if value else text
    return text


def _guard(table: _Table) -> _Table:
    """Let each text of the table that holds a password print itself without it."""
    for key in table.__struct_fields__:
        value = getattr(table, key)
        if isinstance(value, msgspec.Struct):
            _guard(value)
        elif isinstance(value, str) and (text := guarded(value)) is not value:
            msgspec.structs.force_setattr(table, key, text)
    return table


def _with_defaults_of(vehicle: type[VehicleOptions], data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the mapping with the defaults of a kind of vehicle for its missing keys; its own values win."""
    for (name, part), values in vehicle.defaults.items():
        table = data.get(name, {})
        given = table.get(part, {}) if isinstance(table, Mapping) else None
        if isinstance(given, Mapping):
            data = {**data, name: {**table, part: {**values, **given}}}
    return data


def camera_model(settings: Settings) -> Camera:
    """Return the camera that `settings.camera.file` names.

    Raises:
        BadInput: the file is missing or has a fault.
    """
    path = find_file(settings.camera.file, "cameras", Path(), "camera.file")
    return read_camera(path)


def read_camera(path: Path) -> Camera:
    """Return the camera of our own file, or of one of ROS, OpenCV or Kalibr.

    Raises:
        BadInput: it cannot be read, is none of them, or has a fault.
    """
    text = read_text(path)
    foreign = is_foreign(text, str(path))
    return Camera.from_mapping(foreign_camera(text, str(path)) if foreign else toml_of(text, path, "fx"), str(path))


def mount_assumed(path: Path) -> tuple[str, ...]:
    """Return a line for a camera file of another program, which says nothing of the mount; none for our own."""
    if path.suffix.lower() == ".toml":
        return ()
    return (
        f"{path}: it has no mount: counted as at the body's origin, the nose up in the picture: decklander calibrate mount, or a "
        "file of our own with p_body_cam_m and rpy_body_cam_deg",
    )


NOMINAL_SIGMA = 0.02
"""Share of the focal length from which nobody has measured a lens: a calibration reaches 0.005."""


def lens_assumed(camera: Camera) -> tuple[str, ...]:
    """Return a line for a camera whose focal length is hardly known; none for one that was measured."""
    if camera.focal_sigma < NOMINAL_SIGMA:
        return ()
    return (
        f"the lens is a nominal one, not measured (focal_sigma {camera.focal_sigma:g}): distances may be "
        f"{100.0 * camera.focal_sigma:.0f} % off: decklander calibrate camera",
    )


def body_camera(settings: Settings) -> Camera:
    """Return the camera on the body; one on a gimbal as it is while that points straight down.

    Raises:
        BadInput: the file is missing or has a fault.
    """
    camera = camera_model(settings)
    return camera.held(DOWN) if settings.camera.gimbal.given else camera


def pad_model(settings: Settings) -> Pad:
    """Return the pad that `settings.pad.file` names.

    Raises:
        BadInput: the file is missing or has a fault, or vision cannot distinguish this pad from other things on decks.
    """
    path = find_file(settings.pad.file, "pads", Path(), "pad.file")
    return _pad_to_detect(read_text(path), path)


def pad_of_file(path: Path) -> Pad:
    """Return the pad of a file; the flights of one process share it.

    Raises:
        BadInput: the file is missing or has a fault.
    """
    return _pad(read_text(path), path)


@lru_cache(maxsize=16)
def _pad(text: str, path: Path) -> Pad:
    return Pad.from_mapping(toml_of(text, path, "regions"), str(path))


@lru_cache(maxsize=16)
def _pad_to_detect(text: str, path: Path) -> Pad:
    pad = with_known_calibration(_pad(text, path))
    pad.check_for_detection(str(path))
    return pad


def with_known_calibration(pad: Pad) -> Pad:
    """Return a pad with the calibration that was kept for its drawing, if its file has none."""
    if pad.is_calibrated:
        return pad
    if (file := calibration_file(pad)) is None:
        return pad
    try:
        kept = msgspec.json.decode(file.read_bytes(), type=Calibration)
    except (OSError, msgspec.DecodeError):
        return pad
    return replace(pad, calibration=kept) if kept.drawing == pad.fingerprint else pad


def calibration_file(pad: Pad) -> Path | None:
    """Return where a drawing's calibration is kept; None without a home."""
    return (kept := kept_folder()) and kept / "pads" / f"{pad.fingerprint}.json"


def kept_folder() -> Path | None:
    """Return where commands keep what they find and make: the service's state, else the user's cache; None without a home."""
    state, cache = os.environ.get("STATE_DIRECTORY", "").split(":")[0], os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(state) if state else (Path(cache) if cache else Path.home() / ".cache") / "decklander"
    except RuntimeError:  # a number that has no name, in a container, and no HOME
        return None


def response_model(settings: Settings) -> Response:
    """Return the vehicle's response that `settings.guidance.follow_deck.response` names, or that of the kind of vehicle.

    Raises:
        BadInput: the file is missing or has a fault.
    """
    o = settings.guidance.follow_deck
    name = settings.vehicle.response if o.response_by_vehicle else o.response
    return shipped_response(name, "guidance.follow_deck.response")


def shipped_response(name: str, what: str = "response") -> Response:
    """Return a shipped response by its name, or that of a path; errors begin with `what`.

    Raises:
        BadInput: there is none of that name.
    """
    path = find_file(name, "responses", Path(), what)
    return response_from_mapping(read_toml(path), str(path))


def read_toml(path: Path, kind: str = "") -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises:
        BadInput: the file cannot be read or is not TOML.
    """
    return toml_of(read_text(path), path, kind)


@contextmanager
def whole(path: Path, like: Path | None = None) -> Iterator[Path]:
    """Give a path to write to; what is written takes the place of the file, or of the one that it links to, unless that fails.

    Args:
        like: the file whose owner and mode the new one gets; None for the one before.
    """
    if path.exists() and not path.is_file():
        yield path  # a device or a pipe, which nothing may take the place of
        return
    path = path.resolve()
    like = like or path
    beside = path.with_name(f".new-{secrets.token_hex(4)}-{path.name}")
    beside.touch(exist_ok=False)
    try:
        if like.exists():
            status = like.stat()
            with suppress(PermissionError):
                os.chown(beside, status.st_uid, status.st_gid)
            beside.chmod(status.st_mode & 0o777)
        yield beside
        with beside.open("rb") as file:
            os.fsync(file.fileno())
        try:
            beside.replace(path)
        except OSError as why:
            if why.errno != errno.EBUSY:
                raise
            _write_in_place(path, beside.read_bytes())  # a mount of this one file, as containers have them, is never replaced
    finally:
        beside.unlink(missing_ok=True)


def _write_in_place(path: Path, content: bytes) -> None:
    with path.open("r+b") as file:
        file.write(content)
        file.truncate()
        file.flush()
        os.fsync(file.fileno())


def write_whole(path: Path, content: str | bytes, like: Path | None = None) -> None:
    """Write a file by `whole`, a text as UTF-8. Raises OSError."""
    with whole(path, like) as beside:
        beside.write_bytes(content if isinstance(content, bytes) else content.encode())


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
        BadInput: the file cannot be read, is a device or a pipe, or is larger than any settings.
    """
    return text_of(bytes_of(path, Largest.SETTINGS), str(path))


def toml_of(text: str, path: Path, kind: str = "") -> dict[str, Any]:
    """Return the content of a TOML file by its text; if a kind of `KINDS` is given, it must be of that one.

    Raises:
        BadInput: it is not TOML, or another of our files; the text names the path.
    """
    if _DEEP_KEY.search(text) is not None:
        raise BadInput(f"{path}: not valid TOML: a key of more than {_DEEP_PARTS} parts")
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as why:  # a number of thousands of digits is a plain ValueError
        fault = _TUPLE.sub(lambda found: f"[{'.'.join(re.findall(_QUOTED, found[0]))}]", str(why))
        raise BadInput(f"{path}: not valid TOML: {fault.replace('Cannot overwrite a value', 'a key is there twice')}") from why
    keys = {*data, *(f"vehicle.{key}" for key in vehicle)} if isinstance(vehicle := data.get("vehicle"), dict) else {*data}
    found = next((key for key in KINDS if key in keys), kind)
    if kind and found != kind:
        raise BadInput(f"{path}: it is {KINDS[found]}")
    return data


def shipped(folder: str = "") -> list[str]:
    """Return the names of the shipped files of one kind: "" profiles, "cameras", "pads", "responses"."""
    return sorted(p.stem for p in (SHIPPED / folder).glob("*.toml"))


def _is_name(text: str) -> bool:
    return text.replace("_", "").replace("-", "").isalnum()


def find_file(text: str, folder: str, base: Path, what: str) -> Path:
    """Return the file that `text` means: a shipped one by its bare name (see `shipped`), or a path from `base`.

    Raises:
        BadInput: there is no such file; the text begins with `what` and names the nearest shipped one.
    """
    if _is_name(text) and text in shipped(folder):
        return SHIPPED / folder / f"{text}.toml"
    wrong = f"{what}: not a usable file name {text[:60]!r}"
    with file_errors(wrong), refused(wrong, ValueError):
        path = base / text
        exists = path.exists()
    if exists and text:
        return path
    near = difflib.get_close_matches(text, shipped(folder), n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"shipped ones are {', '.join(shipped(folder))}"
    raise BadInput(f"{what}: there is no file {str(path) if text else text!r} and no shipped one of that name ({hint})")


def _anchored(table: _Table, base: Path) -> _Table:
    """Return a table of the settings with its relative paths made relative to the working directory.

    Args:
        base: folder of the settings file, to which the paths are relative.
    """
    given = {key: getattr(table, key) for key in table.__struct_fields__ if key.endswith("_file") or key == "spool"}
    return msgspec.structs.replace(
        table, **{key: str(base / path) for key, path in given.items() if path and not path.startswith(CREDENTIAL)}
    )


def _reference(text: str, folder: str, settings_file: Path, keypath: str) -> str:
    found = find_file(text, folder, settings_file.parent, f"{settings_file}: {keypath}")
    return text if found.parent == SHIPPED / folder and _is_name(text) else str(found)
