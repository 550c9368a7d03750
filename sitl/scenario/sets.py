"""Named sets of scenarios: which ones a campaign flies together, and how each perceives the pad.

    chosen = load("thirty_faults")     # a shipped one (configs/scenarios/sets) or a path

What each scenario expects is said in its own file.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from companion.settings.load import SHIPPED, read_toml, shipped
from companion.settings.refusal import explain
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import choice, text
from sitl.scenario.scenario import Scenario
from sitl.scenario.scenario import load as load_scenario

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


def load(name_or_path: str) -> tuple[ScenarioSet, dict[str, Scenario]]:
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
        try:
            scenarios[member.name] = load_scenario(place_of(name_or_path, member.name), chosen.base)
        except BadInput as why:
            raise BadInput(f"{path}: scenario[{n}].name: {why}") from why
    return chosen, scenarios


def _path_of(name_or_path: str) -> Path:
    return SHIPPED / _FOLDER / f"{name_or_path}.toml" if name_or_path in shipped_sets() else Path(name_or_path)
