"""Small changes to a C source, one at a time: the same kinds as in `operators`, found in its text.

Comments, preprocessor lines and texts are left alone. Operators count where a blank stands on either side of them, as the house
writes binary ones, so a pointer's star and a sign are none. A change that the compiler refuses is no mutant.
"""

import re
from collections.abc import Iterator

from mutants.operators import Mutant

_LEFT_ALONE = re.compile(r'/\*.*?\*/|//[^\n]*|^[ \t]*#[^\n]*|"[^"\n]*"', re.DOTALL | re.MULTILINE)
_OPERATORS = {
    "<": ("<=", ">"), "<=": ("<", ">"), ">": (">=", "<"), ">=": (">", "<"), "==": ("!=",), "!=": ("==",),
    "+": ("-",), "-": ("+",), "*": ("/",), "/": ("*",), "+=": ("-=",), "-=": ("+=",), "*=": ("/=",), "/=": ("*=",),
    "&&": ("||",), "||": ("&&",),
}  # fmt: skip
_NAMES = {"fmin": "fmax", "fmax": "fmin", "sin": "cos", "cos": "sin"}
_DECLARED = re.compile(r"\s*(static )?(const )?(double|int|int32_t|int64_t)\b[^=;]*\[")
"""Code before the size of a declared array: one more element changes nothing."""
_FILLED = re.compile(r"\](\[\w+\])* = \{")
"""Code behind the size of a declared array that is initialized at once."""
_FUNCTION = re.compile(r"^\w[\w *]*?(\w+)\(", re.MULTILINE)
_PLACES = re.compile(
    r"(?<= )(?P<operator>[<>=!]=|[-+*/]=|&&|\|\||[-+*/<>])(?= )"
    r"|(?<![\w.])(?P<real>\d+\.\d*(?:e[-+]?\d+)?|\d+e[-+]?\d+)"
    r"|(?<![\w.])(?P<whole>\d+)(?![\w.])"
    r"|\b(?P<name>fmin|fmax|sin|cos)(?=\()"
)


def c_mutants(source: str) -> Iterator[Mutant]:
    """Every mutant of a C source, by place."""
    bare = _LEFT_ALONE.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), source)
    for place in _PLACES.finditer(bare):
        line = source.count("\n", 0, place.start()) + 1
        start, end = source.rfind("\n", 0, place.start()) + 1, source.find("\n", place.end())
        if place["whole"] and (_DECLARED.fullmatch(bare, start, place.start()) or _FILLED.match(bare, place.end())):
            continue
        for changed in _changes(place):
            text = source[: place.start()] + changed + source[place.end() :]
            before = source[start:end].strip()
            after = (source[start : place.start()] + changed + source[place.end() : end]).strip()
            yield Mutant(line, f"{before}  ->  {after}", text, _function_at(bare, place.start()))


def _function_at(bare: str, at: int) -> str:
    heads = _FUNCTION.findall(bare, 0, at)
    return str(heads[-1]) if heads else ""


def _changes(place: re.Match[str]) -> Iterator[str]:
    if place["operator"]:
        yield from _OPERATORS[place["operator"]]
    elif place["real"]:
        value = float(place["real"])
        yield repr(2.0 * value) if value else "1.0"
        if value not in (0.0, 1.0):
            yield "0.0"
    elif place["whole"]:
        yield str(int(place["whole"]) + 1)
    else:
        yield _NAMES[place["name"]]
