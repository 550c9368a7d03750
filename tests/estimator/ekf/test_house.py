"""The filter is a library of its own."""

import subprocess
import sys
from pathlib import Path

from estimator.ekf import state

FOLDER = Path(__file__).parents[3] / "estimator" / "ekf"


def test_importing_it_is_cheap() -> None:
    """Importing the filter and starting one loads numpy, and nothing that takes long or that the library must not know."""
    watched = {"scipy", "matplotlib", "filterpy", "asyncio", "drivers"}
    loaded = f"{{m.split('.')[0] for m in sys.modules}} & {watched}"
    code = f"import sys, estimator.ekf; estimator.ekf.start(); print(sorted({loaded}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=FOLDER.parents[1], check=True)
    assert done.stdout.strip() == "[]"


def test_names_of_components_agree_with_their_slices() -> None:
    components = range(state.N)
    assert components[state.ATT_ERR] == state.ATT_AXES
    assert components[state.POS_REL] == state.POS_AXES
    assert components[state.VEL] == state.VEL_AXES
    assert list(components[state.POS_HORIZONTAL]) == [state.POS_NORTH, state.POS_EAST]
    assert list(components[state.VESSEL_VEL]) == [state.VESSEL_NORTH, state.VESSEL_EAST]
