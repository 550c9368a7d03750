"""Declare an option: its meaning, unit, range and the source of its default, in one line beside its type and default.

    class FilterOptions(Struct, frozen=True, forbid_unknown_fields=True):
        forget_s: Annotated[float, number("silence after which the filter starts again", "s", 1.0, 600.0)] = 30.0

A key with `public=True` describes the user's vehicle, links, camera, pad, sea or wishes. Every other key of a settings file
stands under `[expert]`. A number that is declared by `tuning`, and a key with `page=True`, may be changed from a browser, and no
other may: none of them names an address, a device, a path, a secret or an id, or gives anybody a right.

The class is at once what the part takes and what the settings file may hold: the reader, `config check`, the reference page
and the JSON Schema use the same declaration.

Modules of options do not postpone the evaluation of their annotations: each reader would compile each of them from text again, a
tenth of the service's start.
"""

from collections.abc import Container
from functools import cache
from typing import Annotated, ClassVar, Literal, TypeVar, get_args, get_origin, get_type_hints

from msgspec import Meta, Struct, structs

PUBLIC = "x-public"
"""Note of a key that stands outside of `[expert]` in a settings file."""
PAGE = "x-page"
"""Note of a key that may be changed from a browser."""
_Range = tuple[str, float, float]
_Choice = tuple[str, tuple[object, ...]]
_Options = TypeVar("_Options", bound=Struct)


def number(meaning: str, unit: str, low: float, high: float, source: str = "", *, public: bool = False) -> Meta:
    """Declare a key that holds a number in `unit` ("1" for a ratio), from `low` to `high`, both included."""
    return Meta(ge=low, le=high, description=meaning, extra_json_schema=_notes(unit, source, public))


def tuning(meaning: str, unit: str, low: float, high: float, source: str = "", *, public: bool = False) -> Meta:
    """Declare a number that may be changed from a browser too."""
    return Meta(ge=low, le=high, description=meaning, extra_json_schema=_notes(unit, source, public, page=True))


def text(meaning: str, longest: int, source: str = "", shortest: int = 1, *, public: bool = False, page: bool = False) -> Meta:
    """Declare a key that holds text of `shortest` to `longest` characters."""
    return Meta(
        min_length=shortest, max_length=longest, description=meaning, extra_json_schema=_notes("", source, public, page=page)
    )


def name(meaning: str, longest: int, source: str = "", *, public: bool = False, page: bool = False) -> Meta:
    """Declare a key that holds one word of letters, digits, - and _."""
    return Meta(
        pattern=rf"^[A-Za-z0-9_-]{{1,{longest}}}(?!\n)$",
        min_length=1,
        max_length=longest,
        description=meaning,
        extra_json_schema=_notes("", source, public, page=page),
    )


def choice(meaning: str, source: str = "", *, public: bool = False, page: bool = False) -> Meta:
    """Declare a key that holds one of the words of its Literal, or true or false."""
    return Meta(description=meaning, extra_json_schema=_notes("", source, public, page=page))


def check_ranges(options: Struct) -> None:
    """Refuse options made in code that a settings file could not hold; for `__post_init__`.

    Raises:
        ValueError: a number outside its declared range or not finite, or a word that is not among the choices.
    """
    kind = type(options).__name__
    ranges, choices = _limits(type(options))
    for key, low, high in ranges:
        value = getattr(options, key)
        if not low <= value <= high:
            raise ValueError(f"{kind}.{key} must lie in {low:g} to {high:g}, got {value!r}")
    for key, words in choices:
        if getattr(options, key) not in words:
            raise ValueError(f"{kind}.{key} must be one of {', '.join(map(str, words))}, got {getattr(options, key)!r}")


def check_order(options: Struct, *relations: str) -> None:
    """Check relations of two keys, as `CheckedOptions.ORDER` has them. Raises ValueError."""
    for less, relation, more in map(str.split, relations):
        low, high = getattr(options, less), getattr(options, more)
        if low > high or (low == high and relation == "<"):
            least = "at least" if relation == "<=" else "more than"
            raise ValueError(f"{more} ({high:g}) must be {least} {less} ({low:g})")


class CheckedOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """Options whose ranges hold for those made in code, too.

    Raises:
        ValueError: a number outside its declared range or not finite, one out of order, or a word that is not among the choices.
    """

    ORDER: ClassVar[tuple[str, ...]] = ()
    """Relations of two keys, such as `first_s <= most_s`."""

    def __post_init__(self) -> None:
        check_ranges(self)
        check_order(self, *self.ORDER)


def grown(options: _Options, factor: float, keys: Container[str]) -> _Options:
    """Return options with some numbers times a factor, each within its declared range."""
    ranges, _ = _limits(type(options))
    return structs.replace(
        options, **{k: max(low, min(high, factor * getattr(options, k))) for k, low, high in ranges if k in keys}
    )


@cache
def _limits(kind: type[Struct]) -> tuple[tuple[_Range, ...], tuple[_Choice, ...]]:
    """Return the declared ranges of a class and the words of its choices, key by key."""
    ranges: list[_Range] = []
    choices: list[_Choice] = []
    for key, hint in get_type_hints(kind, include_extras=True).items():
        bare, *notes = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        ranges += [(key, n.ge, n.le) for n in notes if isinstance(n, Meta) and n.ge is not None and n.le is not None]
        if get_origin(bare) is Literal:
            choices.append((key, get_args(bare)))
    return tuple(ranges), tuple(choices)


def _notes(unit: str, source: str, public: bool, *, page: bool = False) -> dict[str, object] | None:
    given: tuple[tuple[str, object], ...] = (("x-unit", unit), ("x-source", source), (PUBLIC, public), (PAGE, page))
    return {name: note for name, note in given if note} or None
