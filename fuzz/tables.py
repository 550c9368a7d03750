"""Fuzz what a person writes (settings, scenarios, cameras and pads in TOML) and what systemd puts into the environment.

An input is either text, or a shipped file with some keys set to other values, so that the fuzzer gets past the grammar.
"""

import tempfile
import tomllib
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from companion.base.liveness import Manager, watchdog_interval_s
from companion.guidance.make_pilot import estimator_options, tracker
from companion.parts.mavlink.component import ComponentOptions
from companion.parts.mavlink.signed_links import signed_links
from companion.settings import whole_file
from companion.settings.load import SHIPPED, from_file, from_mapping, read_toml, shipped
from companion.settings.model import Settings, ardrone_options
from companion.tools.print_pad.drawing import pad_drawing
from companion.tools.print_pad.sheets import sheets
from drivers.ardrone.options import ArDroneOptions
from drivers.mavlink.signing import load_key
from estimator.contracts.errors import BadInput
from estimator.vision.camera import Camera
from estimator.vision.drawing import edges_of
from estimator.vision.pad import Pad
from fuzz.target import SHARED_MEMORY, Choices, Target, block, refused
from sitl.scenario import scenario as scenarios

Parsed = TypeVar("Parsed")

_NUMBERS = (0, -1, 1, 2**31, 2**63, 2**64, -(2**63) - 1, 10**400, 65535, 65536)
_REALS = (0.0, -0.0, 1e308, -1e308, 5e-324, float("inf"), float("-inf"), float("nan"), 1e-9, 0.5)
_WORDS = (
    "",
    "sim",
    "../x",
    "a\nb",
    "udpin://:14550",
    "serial:///dev/x:57600",
    "-1",
    "ekf",
    "é" * 40,
    "x" * 5000,
    "\0",
    "exposure=1, gain=true",
)

_DEEP = 50
"""The deepest nesting of a value. The reader of TOML refuses what is nested much deeper."""


@cache
def _files(folder: str) -> tuple[dict[str, Any], ...]:
    return tuple(read_toml(SHIPPED / folder / f"{name}.toml") for name in shipped(folder))


def _value(choices: Choices, deep: int = 0) -> Any:
    how = choices.number(1) if deep < _DEEP else 0
    kind, pick = how & 7, how >> 3
    if kind == 0:
        return _NUMBERS[pick % len(_NUMBERS)]
    if kind == 1:
        return _REALS[pick % len(_REALS)]
    if kind == 2:
        return _WORDS[pick % len(_WORDS)]
    if kind == 3:
        return choices.block().decode("utf-8", "replace")
    if kind == 4:
        return choices.signed(4)
    if kind == 5:
        return choices.real()
    if kind == 6:
        return bool(pick & 1)
    if pick & 16:
        return [_value(choices, deep + 1) for _ in range(pick % 6)]
    return {_WORDS[pick % len(_WORDS)]: _value(choices, deep + 1)}


def _keys(table: dict[str, Any], before: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    found = []
    for key, value in table.items():
        found.append((*before, key))
        if isinstance(value, dict):
            found += _keys(value, (*before, key))
    return found


def table(data: bytes, bases: tuple[dict[str, Any], ...], more: tuple[tuple[str, ...], ...] = ()) -> dict[str, Any] | None:
    """Return the table of an input, or None if it is refused.

    The input is a TOML file after a zero, otherwise one of the bases with keys changed, added or removed.
    """
    choices = Choices(data)
    how = choices.number(1)
    if how == 0:
        with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
            path = Path(folder) / "fuzz.toml"
            path.write_bytes(choices.rest())
            try:
                return read_toml(path)
            except BadInput as why:
                refused(why)
                return None
    made: dict[str, Any] = _copy(bases[how % len(bases)])
    while choices and (known := (*_keys(made), *more)):
        path_of_key = known[choices.number(2) % len(known)]
        where = made
        for name in path_of_key[:-1]:
            inner = where.setdefault(name, {})
            where = inner if isinstance(inner, dict) else {}
        if choices.number(1) == 0xFF:
            where.pop(path_of_key[-1], None)
        else:
            where[path_of_key[-1]] = _value(choices)
    return made


def _parsed(made: dict[str, Any] | None, parse: Callable[[dict[str, Any], str], Parsed]) -> Parsed | None:
    """Return what `parse` makes of a table, or None if it refuses it or there is none."""
    if made is None:
        return None
    try:
        return parse(made, "fuzz.toml")
    except BadInput as why:
        refused(why)
        return None


def _copy(value: Any) -> Any:
    return {k: _copy(v) for k, v in value.items()} if isinstance(value, dict) else value


@cache
def _all_settings() -> tuple[tuple[str, ...], ...]:
    """Return every key that can be set, from the description of the settings."""
    return tuple(_keys(tomllib.loads(whole_file.toml(from_file(_files("")[0], "fuzz")))))


def run_settings(data: bytes) -> None:
    """Parse settings: refused in one line, or every part can be built from them, and they survive writing and reading."""
    settings = _parsed(table(data, _files(""), _all_settings()), from_mapping)
    if settings is None or settings.fault() is not None:
        return
    with suppress(BadInput):
        _options(settings)
    assert from_file(tomllib.loads(whole_file.toml(settings)), "again") == settings


def _options(settings: Settings) -> None:
    """Build the options that `run` makes of settings before it opens anything."""
    estimator_options(settings)
    if isinstance(settings.vehicle, ArDroneOptions):
        ardrone_options(settings)
    else:
        ComponentOptions(0.39, settings.guidance.stale_after_s, settings.landing_target)
        signed_links(settings.vehicle, {})
    tracker(settings)
    settings.camera.control_values()


def run_scenario(data: bytes) -> None:
    """Parse a scenario: refused in one line, or its camera and pad are found or refused."""
    scenario = _parsed(table(data, _files("scenarios")), scenarios.from_mapping)
    if scenario is None:
        return
    with suppress(BadInput):
        scenarios.camera_model(scenario)
    with suppress(BadInput):
        scenarios.pad_model(scenario)


def run_camera(data: bytes) -> None:
    """Parse a camera: refused in one line, or its rays and pixels are finite."""
    camera = _parsed(table(data, _files("cameras")), Camera.from_mapping)
    if camera is None:
        return
    if camera.distorted:
        return  # numbers that describe no real lens: its rays may be anything
    corners = np.array([[0.0, 0.0], [camera.width - 1.0, 0.0], [camera.cx, camera.cy]])
    assert np.all(np.isfinite(camera.rays(corners)))
    assert np.all(np.isfinite(camera.project(np.array([[0.0, 0.0, 1.0], [0.1, 0.1, 2.0]]))))


def run_pad(data: bytes) -> None:
    """Parse a pad: refused in one line, or the pad can be drawn and its edges are finite."""
    pad = _parsed(table(data, _files("pads")), Pad.from_mapping)
    if pad is None:
        return
    edges_of(pad)
    drawing = pad_drawing(pad)
    if pad.disc_radius_m < 1.0:
        with suppress(BadInput):
            sheets(drawing, "a4")


def _table_seeds(folder: str) -> Iterator[bytes]:
    for name in shipped(folder):
        yield b"\0" + (SHIPPED / folder / f"{name}.toml").read_bytes()
    for n in range(12):
        yield bytes([1 + n, 3 * n, 0, 0, 8 * (n % 4) + n % 8]) + block(b"x" * n) + bytes([2 * n, 0, 0xFF])


def settings_seeds() -> Iterator[bytes]:
    """Yield the shipped vehicle profiles, and each with a key or two changed."""
    yield from _table_seeds("")


def scenario_seeds() -> Iterator[bytes]:
    """Yield the shipped scenarios, one with a fault, and each with a key or two changed."""
    yield b'\0title = "gust"\n[[faults]]\nkind = "gust"\nspeed_m_s = 5.0\nat_s = 1.0\nfor_s = 2.0\n'
    yield from _table_seeds("scenarios")


def camera_seeds() -> Iterator[bytes]:
    """Yield the shipped cameras, and each with a key or two changed."""
    yield from _table_seeds("cameras")


def pad_seeds() -> Iterator[bytes]:
    """Yield the shipped pads, and each with a key or two changed."""
    yield from _table_seeds("pads")


def run_environment(data: bytes) -> None:
    """Process what systemd passes, of any content: refused in one line, or used."""
    choices = Choices(data)
    names = ("WATCHDOG_USEC", "WATCHDOG_PID", "NOTIFY_SOCKET", "CREDENTIALS_DIRECTORY", "STATE_DIRECTORY")
    environment = {}
    for name in names:
        value = choices.block().decode("utf-8", "surrogateescape").replace("\0", "")
        if value:
            environment[name] = value
    for use in (
        lambda: watchdog_interval_s(environment, 1),
        lambda: _notify(environment),
        lambda: load_key("credential:" + choices.block().decode("utf-8", "replace"), environment),
    ):
        try:
            use()
        except BadInput as why:
            refused(why)


def _notify(environment: dict[str, str]) -> None:
    manager = Manager.of(environment)
    if manager is not None:
        manager.say(READY="1", STATUS="fuzz")
        manager.close()


def environment_seeds() -> Iterator[bytes]:
    """Yield environments as a unit's process finds them, and impossible ones."""
    folder = str(Path("/nonexistent")).encode()
    yield block(b"30000000") + block(b"1") + block(b"@fuzz") + block(folder) + block(folder) + block(b"mavlink-key")
    yield block(b"") + block(b"") + block(b"/nonexistent/notify") + block(b"") + block(b"") + block(b"../x")
    yield block(b"1e3") + block(b"x") + block(b"vsock:1:2") + block(b"/") + block(b"") + block(b"\xff")


TARGETS = {
    "settings": Target(run_settings, settings_seeds, 8192),
    "scenario": Target(run_scenario, scenario_seeds, 8192),
    "camera": Target(run_camera, camera_seeds),
    "pad": Target(run_pad, pad_seeds),
    "environment": Target(run_environment, environment_seeds, 1024),
}
