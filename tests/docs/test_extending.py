"""A setting down to the core costs the files that docs/extending.md names: taken in a copy, its steps change what is fused."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
STEPS = (
    (
        "    min_confidence: Annotated[\n",
        '    confidence_scale: Annotated[float, number("factor on the least confidence", "1", 0.0, 10.0)] = 1.0\n',
    ),
    ("min_confidence, reopen_s", "confidence_scale, "),
    ('"min_confidence",', '"confidence_scale", '),
    ("o->min_confidence) {", "o->confidence_scale * "),
)
"""Steps of the page, for each file: the text before which a text is inserted."""
USED = """
from supply import core
core.bind(core.FLYING)
core.build(core.FLYING.part("base/*.c", "filter/*.c"), core.FLYING.file, ("-O0",))

import numpy as np
from companion.settings.load import from_mapping
from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf import start, step

at = Stamp(MonoNs(10**9), MonoNs(10**9), 0.0, "sim")
seen = Sighting(at, 1, "selected", np.array([0.0, 0.0, 2.0]), 0.0, False, 1e-4 * np.eye(4), 0.3)
for scale in (1.0, 10.0):
    ekf = {"confidence_scale": scale}
    rig = {"vehicle": {"kind": "ardrone"}, "camera": {"file": "sim"}, "pad": {"file": "thesis"}}
    settings = from_mapping({**rig, "estimator": {"ekf": ekf}}, "own")
    filter, _ = step(start(settings.estimator.ekf), Attitude(at, Rotation.identity(), 1e-4 * np.eye(3)))
    print(step(filter, seen)[1][0].verdict.value)
"""


def test_a_setting_down_to_the_core_is_the_four_files_of_the_page(tmp_path: Path) -> None:
    section = (ROOT / "docs/extending.md").read_text().partition("## A setting down to the core")[2].partition("\n## ")[0]
    files = re.findall(r"^\d\. `([^`]+)`", section, re.MULTILINE)
    for package in ("companion", "configs", "drivers", "estimator", "supply"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__", "*.so.1", "abi.py"))
    (tmp_path / "sitl").mkdir()  # the builder's second library, which is not built
    for file, (before, put) in zip(files, STEPS, strict=True):
        text = (tmp_path / file).read_text()
        assert text.count(before) == 1, file
        (tmp_path / file).write_text(text.replace(before, put + before))
    done = subprocess.run(
        [sys.executable, "-c", USED], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(tmp_path)}, capture_output=True,
        text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["fused", "low_confidence"]
