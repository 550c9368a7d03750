"""Plan of a campaign: scenario or named set, settings, perception, the code, and keys with other values (`wind.from_deg=4`).

What each scenario of a set (configs/scenarios/sets) expects is written in its own file.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import platform
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, lru_cache
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import msgspec
import numpy as np
from msgspec import Meta, Struct, field

from companion.settings.load import camera_model as camera_of_settings
from companion.settings.load import from_mapping as settings_from_mapping
from companion.settings.load import pad_model as pad_of_settings
from companion.settings.load import read_toml, shipped
from companion.settings.model import Settings
from companion.settings.overrides import Value, finite, leaves, plain
from companion.settings.schema import explain
from decklander.place import SHIPPED
from estimator.contracts.errors import BadInput, refused
from estimator.contracts.keys import choice, text
from sitl.flight.one_flight import Perception, perception_level
from sitl.scenario.overrides import Overridable, Override
from sitl.scenario.scenario import Scenario, camera_model, pad_model, refuse_gimbal
from sitl.scenario.scenario import from_mapping as scenario_from_mapping
from sitl.scenario.scenario import load as load_scenario

Point = tuple[Override, ...]
"""The varied keys of a flight with their values; empty where nothing is varied."""
POINTS_MAX = 1_000_000
_DIGITS = 9
"""Significant digits of a value, as a command line shows them: enough for any key, and short enough to read."""


class Axis(Struct, frozen=True):
    """One varied key with its values."""

    key: str
    text: str
    """Text as the person wrote it."""
    values: tuple[Value, ...]


def parse_axis(text: str, given: Overridable, where: str) -> Axis:
    """Return the axis that `KEY=LOW:HIGH:STEP` or `KEY=A,B,C` means.

    Raises:
        BadInput: it has another form, or the key is unknown.
    """
    key, equals, span = text.partition("=")
    if not equals or not span:
        raise BadInput(f"{where} {text!r}: write KEY=LOW:HIGH:STEP or KEY=A,B,C, as in wind.speed_m_s=0:10:2")
    if ":" not in span:
        return Axis(key, text, tuple(given.value(key, item, where) for item in span.split(",")))
    parts = span.split(":")
    if len(parts) != 3:
        raise BadInput(f"{where} {text!r}: a range is LOW:HIGH:STEP")
    present = given.value(key, parts[0], where)
    if isinstance(present, bool | str):
        raise BadInput(f"{where} {text!r}: {key} holds no number; list its values, as in {key}=A,B")
    low, high, step = (finite(part, f"{where}: {key}") for part in parts)
    if step == 0.0 or (high - low) / step < 0.0:
        raise BadInput(f"{where} {text!r}: steps of {step:g} do not lead from {low:g} to {high:g}")
    count = math.floor((high - low) / step * (1.0 + 1e-9)) + 1
    if count > POINTS_MAX:
        raise BadInput(f"{where} {text!r}: {count} values are more than {POINTS_MAX}")
    whole = not isinstance(given._find(key, where), float)
    steps = [float(f"{low + n * step:.{_DIGITS}g}") for n in range(count)]
    return Axis(key, text, tuple(int(v) if whole and v == int(v) else v for v in steps))


def factorial(axes: Sequence[Axis]) -> list[Point]:
    """Return all combinations of the axes' values; a single empty point without axes.

    Raises:
        BadInput: a key is varied twice, or there are too many combinations.
    """
    keys = [axis.key for axis in axes]
    for key in keys:
        if keys.count(key) > 1:
            raise BadInput(f"--vary: {key} is given twice")
    if (count := math.prod(len(axis.values) for axis in axes)) > POINTS_MAX:
        raise BadInput(f"--vary: {count} combinations are more than {POINTS_MAX}")
    return [
        tuple((axis.key, value) for axis, value in zip(axes, values, strict=True))
        for values in itertools.product(*(axis.values for axis in axes))
    ]


def described(kind: str, axes: Sequence[Axis]) -> dict[str, Any]:
    """Return a design as plain values, for the manifest."""
    return {"kind": kind, "axes": [axis.text for axis in axes], "keys": [axis.key for axis in axes]}


_FOLDER = "scenarios/sets"
_LEVELS = "how the service perceives the pad in this scenario; a set says it for all that do not"


class SetMember(Struct, frozen=True, forbid_unknown_fields=True):
    """One scenario of a set."""

    name: Annotated[str, text("a shipped scenario, or a path relative to the set's file", 200)]
    perception: Annotated[Literal["pixels", "model", "truth"], choice(_LEVELS)] | None = None


class ScenarioSet(Struct, frozen=True, forbid_unknown_fields=True):
    """Scenarios that are flown together."""

    title: Annotated[str, text("one line for people", 120)]
    scenario: Annotated[tuple[SetMember, ...], Meta(min_length=1, max_length=500, description="in the order of the table")]
    perception: Annotated[Literal["pixels", "model", "truth"], choice("how the service perceives the pad")] = "model"
    base: (
        Annotated[str, text("a scenario that takes the place of the base that each scenario names, as another sea", 200)] | None
    ) = None

    def __post_init__(self) -> None:
        names = [member.name for member in self.scenario]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"scenario {twice[0]!r} is listed twice")

    def level(self, member: SetMember) -> Literal["pixels", "model", "truth"]:
        """Return how a member perceives the pad."""
        return member.perception or self.perception


def set_of(names: Sequence[str]) -> ScenarioSet:
    """Return the set of these scenarios.

    Raises:
        BadInput: one of them is named twice.
    """
    try:
        return ScenarioSet(", ".join(names), tuple(map(SetMember, names)))
    except ValueError as why:
        raise BadInput(str(why)) from why


def shipped_sets() -> list[str]:
    """Return the names of the shipped sets."""
    return shipped(_FOLDER)


def is_set(name_or_path: str) -> bool:
    """Return whether a name or a path means a set of scenarios, and not one scenario."""
    if name_or_path in shipped_sets():
        return True
    path = Path(name_or_path)
    try:
        return path.is_file() and "scenario" in read_toml(path)
    except (BadInput, OSError, ValueError):
        return False


def place_of(name_or_path: str, member: str) -> str:
    """Return the path of a set's scenario if it lies beside the set's file, else the name of the shipped one."""
    beside = _path_of(name_or_path).parent / member
    return str(beside) if beside.is_file() else member


def load_set(name_or_path: str) -> tuple[ScenarioSet, dict[str, Scenario]]:
    """Return a set and the scenario of each member, by the member's name.

    Raises:
        BadInput: the file cannot be read; a key is unknown, missing or wrong; or a scenario has such a fault.
    """
    path = _path_of(name_or_path)
    data: dict[str, Any] = read_toml(path)
    try:
        chosen = msgspec.convert(data, ScenarioSet, strict=True)
    except msgspec.ValidationError as why:
        raise BadInput(f"{path}: {explain(ScenarioSet, data, str(why))}") from why
    scenarios = {}
    for n, member in enumerate(chosen.scenario):
        with refused(f"{path}: scenario[{n}].name", BadInput):
            scenarios[member.name] = load_scenario(place_of(name_or_path, member.name), chosen.base)
    return chosen, scenarios


def _path_of(name_or_path: str) -> Path:
    return SHIPPED / _FOLDER / f"{name_or_path}.toml" if name_or_path in shipped_sets() else Path(name_or_path)


_PACKAGES = ("companion", "drivers", "estimator", "sitl")
_SOURCES = (".py", ".toml", ".npz", ".c", ".h")


@cache
def code_version() -> dict[str, str]:
    """Return what a flight's result depends on beside its scenario, seed and settings, by name."""
    return {
        "sources": sources_digest(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "machine": platform.machine(),
    }


def sources_digest() -> str:
    """Return a digest of the names and contents of all source files of the installed packages."""
    digest = hashlib.blake2b(digest_size=16)
    roots = {package: Path(next(iter(import_module(package).__path__))) for package in _PACKAGES}
    for package, root in (roots | {"configs": SHIPPED}).items():
        for path in sorted(root.rglob("*")):
            if path.suffix in _SOURCES:
                content = path.read_bytes()
                digest.update(f"{package}/{path.relative_to(root).as_posix()}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def differing(ours: Mapping[str, Any], other: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """Yield each key with the value of both tables where they differ; None where one has none."""
    one, two = (dict(leaves(table)) for table in (ours, other))
    return ((key, one.get(key), two.get(key)) for key in one | two if one.get(key) != two.get(key))


def differences(ours: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Return in words the first three differences of two tables, as of two versions of the code; empty where they agree."""
    found = [f"{key} {str(two)[:32]} instead of {str(one)[:32]}" for key, one, two in differing(ours, other)]
    return ", ".join([*found[:3], *([f"{len(found) - 3} more"] if found[3:] else [])])


FORMAT = 1
"""Version of the campaign folder."""


class Job(Struct, frozen=True):
    """One flight of a campaign."""

    seed: int
    point: Point = ()
    scenario: str = ""
    """Name of the scenario in a campaign of a set; empty in a campaign of one scenario."""

    @property
    def key(self) -> str:
        """The flight's name within its campaign."""
        return " ".join(filter(None, (self.scenario, f"{self.seed}", canonical(dict(self.point)) if self.point else "")))


class CampaignPlan(Struct, frozen=True):
    """Common settings of all flights of a campaign, as plain values that can be sent to another machine and kept in a file."""

    name: str
    """Name of the scenario as the person wrote it."""
    scenario: Mapping[str, Any]
    settings: Mapping[str, Any]
    perception: Perception
    perception_model: str | None
    """File of the error model of perception; None for the shipped one of the settings' vision."""
    design: Mapping[str, Any]
    """Choice of the points: the varied keys with their ranges; empty if nothing is varied."""
    files: Mapping[str, str]
    """Digests of the files that scenario and settings name."""
    options: tuple[str, ...] = ()
    """Further arguments of `decklander simulate` that fly one flight of the campaign again."""
    own: bool = False
    """True for the settings of a person (see `Overridable`)."""

    def of(self, job: Job) -> CampaignPlan:
        """Return the plan by which a job is flown."""
        return self

    def base(self) -> bytes:
        """Return what a worker needs beside a job, as JSON."""
        needed = ("name", "scenario", "settings", "perception", "perception_model", "own")
        return canonical({name: getattr(self, name) for name in needed}).encode()

    def identity(self) -> dict[str, Any]:
        """Return what two runs must share to be one campaign, and what a report says of it."""
        return {
            "format": FORMAT,
            "name": self.name,
            "perception": self.perception,
            "perception_model": self.perception_model,
            "scenario": self.scenario,
            "settings": self.settings,
            "design": self.design,
            "files": self.files,
            "code": code_version(),
        }


class SetPlan(Struct, frozen=True):
    """Plan of a campaign over a set of scenarios: one plan for each scenario, by its name."""

    name: str
    title: str
    members: Mapping[str, CampaignPlan]
    options: tuple[str, ...] = ()
    """Options as those of a `CampaignPlan`, without the level of perception, which each flight gives."""
    places: Mapping[str, str] = field(default_factory=dict)
    """Path of each scenario that is not found by its name alone."""

    @property
    def perception(self) -> str:
        """The levels of perception, in words."""
        return ", ".join(dict.fromkeys(plan.perception for plan in self.members.values()))

    def of(self, job: Job) -> CampaignPlan:
        """Return the plan by which a job is flown."""
        return self.members[job.scenario]

    def identity(self) -> dict[str, Any]:
        """Return what two runs must share to be one campaign, and what a report says of it."""
        each = {name: plan.identity() for name, plan in self.members.items()}
        first = next(iter(each.values()))
        own = ("scenario", "settings", "perception", "perception_model")
        files = {f"{name}: {key}": digest for name, one in each.items() for key, digest in one["files"].items()}
        return {
            **first,
            "name": self.name,
            "perception": self.perception,
            "scenario": {**first["scenario"], "title": self.title},
            "files": files,
            "members": {name: {key: one[key] for key in own} for name, one in each.items()},
        }


AnyPlan = CampaignPlan | SetPlan
"""Plan of a campaign: one scenario or a set of them."""


def digest_of(plan: AnyPlan) -> str:
    """Return a short digest of a plan's identity, which names the campaign's default folder."""
    return hashlib.blake2b(canonical(plan.identity()).encode(), digest_size=4).hexdigest()


def make_plan(
    name: str,
    scenario: Scenario,
    settings: Settings,
    perception: Perception,
    perception_model: str | None = None,
    options: tuple[str, ...] = (),
) -> CampaignPlan:
    """Return the plan of a campaign in which nothing is varied.

    Files that were shipped with the code go by their bare names, so that a worker with another place of installation finds its
    own.

    Raises:
        BadInput: a camera or pad file is missing or has a fault, or as `sitl.scenario.scenario.refuse_gimbal`.
    """
    refuse_gimbal(scenario)
    named: list[tuple[str, Path]] = []
    tables = plain(scenario), plain(settings)
    for whose, table in zip(("scenario", "settings"), tables, strict=True):
        for key, part in table.items():
            if isinstance(part, dict) and isinstance(file := part.get("file"), str):
                path = Path(file)
                named += [(f"{whose}: {key}{behind}", one) for behind, one in files_from(path)]
                if path.suffix == ".toml" and path.parent.parent == SHIPPED:
                    part["file"] = path.stem
    if scenario.vessel.motion:
        named.append(("scenario: vessel.motion", Path(scenario.vessel.motion)))
    if settings.guidance.controller == "policy" and (path := Path(settings.guidance.policy_file)).is_file():
        named.append(("settings: guidance.policy_file", path))
    if perception_model is not None and (path := Path(perception_model)).is_file():
        named.append(("perception model", path))
    files = {label: hashlib.blake2b(path.read_bytes(), digest_size=8).hexdigest() for label, path in named}
    camera_model(scenario)
    pad_model(scenario)
    camera_of_settings(settings)
    pad_of_settings(settings)
    return CampaignPlan(name, tables[0], tables[1], perception, perception_model, {}, files, options)


def files_from(path: Path, depth: int = 4) -> Iterator[tuple[str, Path]]:
    """Return a file and all that it names under a key `file`, as a vessel names its recording, each with the keys before it.

    Raises:
        BadInput: a TOML file among them cannot be read.
    """
    if not path.is_file():
        return
    yield "", path
    if path.suffix == ".toml" and depth:
        for keys, named in _named(read_toml(path)):
            yield from ((f": {keys}{more}", one) for more, one in files_from(path.parent / named, depth - 1))


def _named(table: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key, value in table.items():
        if isinstance(value, dict):
            if isinstance(file := value.get("file"), str):
                yield key, file
            yield from ((f"{key}.{inner}", file) for inner, file in _named(value))


@lru_cache(maxsize=64)
def unpacked(base: bytes) -> tuple[str, Overridable, Perception, str | None]:
    """Return the name, the scenario with its settings, the perception and its error model's file of a plan's base.

    Raises:
        BadInput: the base comes from code that knows other keys.
    """
    data = json.loads(base)
    scenario = scenario_from_mapping(data["scenario"], "the campaign's scenario")
    settings = settings_from_mapping(data["settings"], "the campaign's settings")
    given = Overridable(scenario, settings, own=data["own"])
    return data["name"], given, perception_level(data["perception"]), data["perception_model"]


def canonical(value: Any) -> str:
    """Return JSON with sorted keys and no spaces: equal values give equal text."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def seeds_of(first: int, runs: int) -> range:
    """Return the seeds of a campaign.

    Raises:
        BadInput: the first is negative, or there are none.
    """
    if first < 0:
        raise BadInput(f"--seed must be 0 or more, got {first}")
    if runs < 1:
        raise BadInput(f"--runs must be 1 or more, got {runs}")
    return range(first, first + runs)
