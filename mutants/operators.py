"""Small changes to a module's source, one at a time, and a test should notice each."""

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass

_COMPARE: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.Lt), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
}  # fmt: skip
_BINARY: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.MatMult: ast.Add,
    ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr,
}  # fmt: skip
_PAIRS = ("min", "max"), ("sin", "cos"), ("any", "all"), ("minimum", "maximum")
_NAMES = dict(_PAIRS) | {other: one for one, other in _PAIRS}


@dataclass(frozen=True, slots=True)
class Mutant:
    """One changed source."""

    line: int
    change: str
    """The source before and after the change."""
    source: str
    within: str = ""
    """The C function that was changed."""


def mutants(source: str) -> Iterator[Mutant]:
    """Every mutant of a module, by line. Texts, annotations and what only makes an error's text are left alone."""
    tree = ast.parse(source)
    for node, field, number in _places(tree):
        original = _at(node, field, number)
        for changed in _changes(original):
            line = getattr(original, "lineno", getattr(node, "lineno", 0))
            _put(node, field, number, changed)
            text = ast.unparse(ast.fix_missing_locations(tree))
            _put(node, field, number, original)
            shown = _shown(node, original, changed, field, number)
            yield Mutant(line, shown, text)


def _shown(node: ast.AST, original: object, changed: object, field: str, number: int | None) -> str:
    def text(part: object) -> str:
        if isinstance(part, ast.cmpop | ast.operator | ast.boolop):
            whole = copy.deepcopy(node)
            _put(whole, field, number, part)
            return ast.unparse(whole)
        if isinstance(part, ast.If):
            return f"if {ast.unparse(part.test)}"
        return ast.unparse(part) if isinstance(part, ast.AST) else str(part)

    return f"{text(original)}  ->  {text(changed)}"


def _places(tree: ast.AST) -> Iterator[tuple[ast.AST, str, int | None]]:
    """Every child that may be changed, with the way to it."""
    for node in _walked(tree):
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list", "keywords") and not isinstance(node, ast.Call):
                continue
            if isinstance(value, list):
                yield from ((node, field, i) for i, item in enumerate(value) if isinstance(item, ast.AST))
            elif isinstance(value, ast.AST):
                yield node, field, None


def _walked(node: ast.AST) -> Iterator[ast.AST]:
    """Walk as `ast.walk` does, but not into types, raised errors, slots of a frozen class, logging and asserts."""
    if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom):
        return
    if isinstance(node, ast.Call) and ast.unparse(node.func).startswith(("_log.", "log.", "dataclass", "NewType", "TypeVar")):
        return
    yield node
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list") or (field == "keywords" and isinstance(node, ast.ClassDef)):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _walked(child)


def _at(node: ast.AST, field: str, number: int | None) -> object:
    value = getattr(node, field)
    return value if number is None else value[number]


def _put(node: ast.AST, field: str, number: int | None, value: object) -> None:
    if number is None:
        setattr(node, field, value)
    else:
        getattr(node, field)[number] = value


def _changes(node: object) -> Iterator[ast.AST]:
    match node:
        case ast.cmpop():
            yield from (kind() for kind in _COMPARE.get(type(node), ()))
        case ast.operator() if type(node) in _BINARY:
            yield _BINARY[type(node)]()
        case ast.And():
            yield ast.Or()
        case ast.Or():
            yield ast.And()
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield node.operand
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float(value)):
            yield ast.Constant(value * 2.0 if value else 1.0)
            if value not in (0.0, 1.0):
                yield ast.Constant(0.0)
        case ast.Name(id=name) if name in _NAMES:
            yield ast.Name(_NAMES[name], ast.Load())
        case ast.Attribute(attr=name) if name in _NAMES:
            yield ast.Attribute(node.value, _NAMES[name], ast.Load())
        case ast.IfExp():
            yield node.body
            yield node.orelse
        case ast.If() if not isinstance(node.test, ast.Constant):
            yield _like(node, ast.If(ast.Constant(False), node.body, node.orelse))
            yield _like(node, ast.If(ast.Constant(True), node.body, node.orelse))
        case ast.AugAssign():
            yield _like(node, ast.Pass())
        case ast.Assign(targets=[ast.Subscript() | ast.Attribute()]):
            yield _like(node, ast.Pass())
        case ast.Expr(value=ast.Call()):
            yield _like(node, ast.Pass())


def _like(old: ast.stmt, new: ast.stmt) -> ast.stmt:
    return ast.copy_location(new, old)
