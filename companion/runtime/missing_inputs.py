"""Name the inputs that guidance waits for, so that an operator knows which part is silent."""

from __future__ import annotations

from companion.runtime.health import HealthSnapshot

SILENT_S = 2.0
"""An input that has not arrived for this long counts as missing; the slowest one, the vehicle's status, comes at 1 Hz."""
_NEEDED = {
    "VehicleStatus": "status from the vehicle",
    "Attitude": "attitude from the vehicle",
    "Frame": "frames from the camera",
}
"""Flows of `Health` without which no landing begins, with the words for the operator."""


def missing_inputs(health: HealthSnapshot) -> tuple[str, ...]:
    """Return what is missing, such as "no frames from the camera for 12 s"; empty if every input arrives."""
    out = []
    for flow, words in _NEEDED.items():
        state = health.flows.get(flow)
        if state is None or state.age_s is None:
            out.append(f"no {words} yet")
        elif state.age_s > SILENT_S:
            out.append(f"no {words} for {state.age_s:.0f} s")
    return tuple(out)
