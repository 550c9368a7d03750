"""An editor that runs pyright knows every type of the library, from the wheel as it is installed."""

import json
import os
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path
from typing import Any

import pytest

from supply import wheels

ROOT = Path(__file__).parents[1]
MADE = {"estimator.core.abi.ffi", "estimator.core.why"}
"""Names of `estimator` without a type: the module that cffi makes, and an exception that is caught."""
FILE = '''"""A stranger's first file."""

import numpy as np

from decklander import Camera, Imu, Pad, PadTracker, RelativeEstimator, RelativeState, Stamp, shipped


def land(image: np.ndarray[tuple[int, int, int], np.dtype[np.uint8]]) -> RelativeState | None:
    camera, pad = Camera.from_mapping({}), Pad.from_mapping({})
    tracker, estimator = PadTracker(camera, pad), RelativeEstimator()
    stamp = Stamp.from_seconds(1.0, sigma_s=0.001)
    estimator.on_imu(Imu(stamp, np.zeros(3), np.array([0.0, 0.0, -9.81])))
    sighting = tracker.track(image, stamp=stamp, attitude=estimator.attitude_at(stamp))
    if sighting is not None:
        estimator.on_sighting(sighting)
        print(sighting.d_body_pad_level[2], sighting.confidence, shipped("pads/thesis.toml"))
    return estimator.at(stamp.measured_at)
'''


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bin folder of an environment with our wheel, and its needs lent by this one."""
    if shutil.which("node") is None:
        pytest.skip("there is no node here")
    done = subprocess.run(
        ["make", "-s", f"{sys.prefix}/.workflows", f"VENV={sys.prefix}"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        pytest.skip(f"pyright cannot be had here: {done.stderr[-300:]}")
    folder = tmp_path_factory.mktemp("stranger")
    venv.create(folder / "env")
    (packages,) = (folder / "env/lib").glob("python*/site-packages")
    with zipfile.ZipFile(wheels.make("x86_64", folder)) as wheel:
        wheel.extractall(packages)
    (here,) = Path(sys.prefix, "lib").glob("python*/site-packages")
    for name in ("numpy", "msgspec", "cv2"):
        (packages / name).symlink_to(here / name)
    return folder / "env/bin"


def pyright(installed: Path, folder: Path, *words: str) -> Any:
    environment = os.environ | {"PATH": f"{installed}:{os.environ['PATH']}", "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}
    command = [f"{sys.prefix}/bin/pyright", "--outputjson", *words]
    return json.loads(subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False).stdout)


def test_a_strangers_file_is_understood_in_strict_mode_and_a_mistake_in_it_is_seen(installed: Path, tmp_path: Path) -> None:
    (tmp_path / "pyrightconfig.json").write_text('{"typeCheckingMode": "strict"}')
    (tmp_path / "land.py").write_text(FILE)
    assert pyright(installed, tmp_path, "land.py")["generalDiagnostics"] == []
    (tmp_path / "land.py").write_text(FILE.replace("sighting.confidence", "sighting.sureness"))
    (wrong,) = {found["rule"] for found in pyright(installed, tmp_path, "land.py")["generalDiagnostics"]} & {
        "reportAttributeAccessIssue"
    }
    assert wrong == "reportAttributeAccessIssue"


@pytest.mark.parametrize(("package", "untyped"), [("decklander", set()), ("estimator", MADE)])
def test_every_exported_name_has_a_type(package: str, untyped: set[str], installed: Path, tmp_path: Path) -> None:
    found = pyright(installed, tmp_path, "--ignoreexternal", "--verifytypes", package)["typeCompleteness"]
    assert found["packageName"] == package
    symbols = found["symbols"]
    assert len(symbols) > 20
    assert {one["name"] for one in symbols if one["isExported"] and not one["isTypeKnown"]} | {
        one["name"] for one in symbols if one["isExported"] and one["isTypeAmbiguous"]
    } == untyped
