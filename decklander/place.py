"""The place of the program's packages, and of the files that are shipped with it.

Beside `decklander` stand four packages of general names: `companion`, `drivers`, `estimator` and `sitl`. A robot's workspace on
PYTHONPATH may have folders of the same names. `claim` lets ours be found first, in this process and in those that it starts.
"""

import os
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

PACKAGES = ("companion", "drivers", "estimator", "sitl")
_TOP = Path(__file__).resolve().parents[1]
SHIPPED = next(folder for folder in (Path(__file__).parent / "configs", _TOP / "configs") if folder.is_dir())
"""The folder of shipped files: in the package, where it was installed, or beside it in a checkout."""


class _OwnPlace(MetaPathFinder):
    """Finds the packages that were claimed beside this one, whatever `sys.path` holds before."""

    def __init__(self) -> None:
        self.claimed = set[str]()

    def find_spec(self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        return PathFinder.find_spec(fullname, [str(_TOP)], target) if path is None and fullname in self.claimed else None


_FINDER = _OwnPlace()


def claim(*names: str) -> None:
    """Let these packages be found beside this one from now on.

    Raises:
        ImportError: a foreign package of such a name is imported already; the text is one line that names it and its place.
    """
    for name in names:
        there = sys.modules.get(name)
        where = [str(Path(folder).resolve()) for folder in getattr(there, "__path__", ())]
        if there is not None and where != [str(_TOP / name)]:
            held = ", ".join(where) or getattr(there, "__file__", None) or "this program"
            raise ImportError(f"a package {name!r} of {held} is imported already and hides the one of {_TOP}")
    _FINDER.claimed.update(names)
    if _FINDER not in sys.meta_path:
        sys.meta_path.insert(0, _FINDER)


def unhide() -> None:
    """Take folders of PYTHONPATH that hide our packages from what this process starts, and find others in them last."""
    given = os.environ.get("PYTHONPATH")
    if not given:
        return
    folders = given.split(os.pathsep)
    theirs = (folder for folder in folders if Path(folder).resolve() != _TOP)
    hiding = {os.path.abspath(folder) for folder in theirs if any(Path(folder, name).is_dir() for name in PACKAGES)}
    sys.path.sort(key=hiding.__contains__)
    os.environ["PYTHONPATH"] = os.pathsep.join(folder for folder in folders if os.path.abspath(folder) not in hiding)


def shipped(path: str) -> Path:
    """Return a shipped file by its path in `configs`, such as `cameras/sim.toml`.

    Raises:
        FileNotFoundError: there is none.
    """
    file = SHIPPED / path
    if not file.is_file():
        raise FileNotFoundError(f"no file {path!r} is shipped: {SHIPPED}")
    return file
