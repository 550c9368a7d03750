"""The command line.

A robot's workspace on PYTHONPATH may have folders of our packages' names. Ours are found before those, also by programs that a
command starts.
"""

import os
import sys
from pathlib import Path

_OURS = ("configs", "drivers", "estimator", "sitl", "study")
_ROOT = Path(__file__).resolve().parents[2]

if given := os.environ.get("PYTHONPATH"):
    folders = given.split(os.pathsep)
    theirs = (folder for folder in folders if Path(folder).resolve() != _ROOT)
    hiding = {os.path.abspath(folder) for folder in theirs if any(Path(folder, name).is_dir() for name in _OURS)}
    sys.path.sort(key=hiding.__contains__)
    os.environ["PYTHONPATH"] = os.pathsep.join(folder for folder in folders if os.path.abspath(folder) not in hiding)
