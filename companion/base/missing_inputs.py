"""Name the inputs that guidance waits for, so that an operator knows which part is silent."""

from companion.base.health import HealthSnapshot

SILENT_S = 2.0
"""An input that has not arrived for this long counts as missing; the slowest one, the vehicle's status, comes at 1 Hz."""
SHIP_PLACE, SHIP_SILENT_S = "ShipPlace", 15.0
"""The flow of the ship's places, where a source of them is set. AIS reports come every 10 s from a ship that lies still."""
GIMBAL = "GimbalAttitude"
"""The flow of the gimbal's attitudes, where a gimbal carries the camera."""
_NEEDED = {
    "VehicleStatus": "status from the vehicle",
    "Attitude": "attitude from the vehicle",
    "Frame": "frames from the camera",
    GIMBAL: "attitude from the gimbal",
}
"""Flows of `Health` without which no landing begins, with the words for the operator."""


def missing_inputs(health: HealthSnapshot) -> tuple[str, ...]:
    """Return what is missing, such as "no frames from the camera for 12 s"; empty if every input arrives."""
    out = []
    for flow, words in _NEEDED.items():
        if flow == GIMBAL and flow not in health.awaited:
            continue
        state = health.flows.get(flow)
        if state is None or state.age_s is None:
            out.append(f"no {words} yet")
        elif state.age_s > SILENT_S:
            out.append(f"no {words} for {state.age_s:.0f} s")
    place = health.flows.get(SHIP_PLACE)
    if place is None and SHIP_PLACE in health.awaited:
        out.append("no place from the ship yet")
    elif place is not None and place.age_s is not None and place.age_s > SHIP_SILENT_S:
        out.append(f"no place from the ship for {place.age_s:.0f} s")
    return tuple(out)
