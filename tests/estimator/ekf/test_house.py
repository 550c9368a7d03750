"""The filter is a library of its own."""

import ast
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).parents[3] / "estimator" / "ekf"


def test_imports() -> None:
    for path in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module]
            for name in names:
                assert name.split(".")[0] in {
                    "__future__",
                    "collections",
                    "copy",
                    "dataclasses",
                    "math",
                    "struct",
                    "typing",
                    "numpy",
                    "estimator",
                    "functools",
                    "itertools",
                    "msgspec",
                }, path
                assert not name.startswith("estimator.vision"), path


def test_importing_it_is_cheap() -> None:
    """Importing the filter and starting one loads numpy, and nothing that takes long or that the library must not know."""
    watched = {"scipy", "matplotlib", "filterpy", "asyncio", "drivers"}
    loaded = f"{{m.split('.')[0] for m in sys.modules}} & {watched}"
    code = f"import sys, estimator.ekf; estimator.ekf.start(); print(sorted({loaded}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=FOLDER.parents[1], check=True)
    assert done.stdout.strip() == "[]"
