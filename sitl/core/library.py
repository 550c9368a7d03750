"""The door to the built library of the simulator. A service that flies does not load it."""

from __future__ import annotations

from estimator.core.library import load

FILE = f"{__file__.rpartition('/')[0]}/libdecklander_sim.so.1"
"""Where `python -m supply.core` puts the library."""

CORE = load(FILE)
"""The library that simulates."""
