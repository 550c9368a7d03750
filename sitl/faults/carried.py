"""The faults that cannot act on a vehicle, of those that a scenario may list."""

from collections.abc import Sequence

from estimator.contracts.errors import BadInput
from sitl.faults.acts import Vehicles
from sitl.faults.fault import Fault

_WHY: dict[Vehicles, str] = {
    "ardrone": "an AR.Drone has no modes, failsafes or remote control; they go with --autopilot",
    "stand-in": "an autopilot flies by GNSS and not by optical flow",
    "program": "a program has loops, a battery and failsafes of its own",
    "own physics": "a program has loops, rotors, a battery and failsafes of its own",
}


def refuse_others(name: str, faults: Sequence[Fault], vehicle: Vehicles) -> None:
    """Refuse faults that cannot act.

    Args:
        name: of the scenario, for the message.
        vehicle: the one that flies.

    Raises:
        BadInput: there are some; the message names them.
    """
    others = dict.fromkeys(fault.words for fault in faults if not fault.carried_by(vehicle))
    if others:
        raise BadInput(f"{name}: its faults ({', '.join(others)}) cannot act: {_WHY[vehicle]}")
