"""The door to the library of the simulator. A service that flies does not load it."""

from estimator.core.library import Door
from sitl.core import abi

FILE = f"{__file__.rpartition('/')[0]}/libdecklander_sim.so.1"
"""Path of the library that `python -m supply.core` builds."""

SIM = Door(abi, FILE)
"""The library that simulates."""
