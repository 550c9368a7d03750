"""Scope of a source change: function bodies alone, which can be replaced in a running process, or more."""

import gc
from collections import defaultdict
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType, FunctionType

Name = tuple[str, int]
"""A function's qualified name, and its number among those of this name in the order of their lines."""


def changed_functions(original: str, changed: str, path: Path) -> dict[Name, CodeType] | None:
    """Return the functions whose bodies differ, with the changed code; None where more than bodies of functions differs."""
    (shell, before), (changed_shell, after) = (_outermost(compile(text, str(path), "exec")) for text in (original, changed))
    if shell != changed_shell or before.keys() != after.keys():
        return None
    return {name: code for name, code in after.items() if code != before[name]}


def _outermost(module: CodeType) -> tuple[list[object], dict[Name, CodeType]]:
    """Return what a module runs when it is imported, and its functions and methods without those inside of them."""
    shell: list[object] = []
    found: dict[Name, CodeType] = {}
    numbers: dict[str, int] = defaultdict(int)
    waiting = [module]
    while waiting:
        code = waiting.pop(0)
        inner = [one for one in code.co_consts if isinstance(one, CodeType)]
        constants = [(type(one), one) for one in code.co_consts if not isinstance(one, CodeType)]
        shell.append((code.co_qualname, code.co_code, code.co_names, constants))
        for one in inner:
            if one.co_flags & CO_OPTIMIZED:
                found[one.co_qualname, numbers[one.co_qualname]] = one
                numbers[one.co_qualname] += 1
            else:
                waiting.append(one)
    return shell, found


def living_functions(path: Path) -> dict[Name, FunctionType]:
    """Return the functions of a file that were made when it was imported."""
    by_name: dict[str, list[FunctionType]] = defaultdict(list)
    for one in gc.get_objects():
        if type(one) is FunctionType and one.__code__.co_filename == str(path) and "<locals>" not in one.__code__.co_qualname:
            by_name[one.__code__.co_qualname].append(one)
    found: dict[Name, FunctionType] = {}
    for name, functions in by_name.items():
        functions.sort(key=lambda function: function.__code__.co_firstlineno)
        found |= {(name, k): function for k, function in enumerate(functions)}
    return found
