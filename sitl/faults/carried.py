"""The faults that act on a flight with an autopilot, of those that a scenario may list."""

from collections.abc import Sequence

from estimator.contracts.errors import BadInput
from sitl.faults.fault import Corrupted, Fault, Signal
from sitl.faults.kinds import STREAMS

TELEMETRY: frozenset[Signal] = frozenset({"accelerometer", "gyro", "attitude", "heading", "velocity", "range"})
"""The signals that an autopilot's telemetry can tell wrong (`sitl.emulators.autopilots.telemetry`)."""
CARRIED = frozenset(
    {*STREAMS, "link_lost", "light_falls", "lens_covered", "operator", "service_killed", "vessel_reports", "corrupted"}
)
"""Kinds that act beside any program: those of its streams, of the light on its camera and its lens, of the service, of people and
of the ship's reports, and what the telemetry tells wrong."""
OF_THE_STAND_IN = frozenset({"failsafe", "low_battery"})
"""Kinds that act on a stand-in besides; a program has failsafes and a battery of its own."""


def carries(signal: Signal, error: str) -> bool:
    """Return whether a signal can be wrong in this way."""
    streams = signal in ("samples", "frames") or (signal == "commands" and error in ("late", "doubled"))
    return streams or signal in TELEMETRY or signal == "sighting" or signal.startswith("ship_")


def refuse_others(name: str, faults: Sequence[Fault], *, stand_in: bool) -> None:
    """Refuse faults that cannot act.

    Args:
        name: of the scenario, for the message.
        stand_in: whether a stand-in flies in the place of a program.

    Raises:
        BadInput: there are some; the message names them.
    """
    kinds = CARRIED | OF_THE_STAND_IN if stand_in else CARRIED
    others = [_words(fault) for fault in faults if not _acts(fault, kinds)]
    if others:
        names = ", ".join(dict.fromkeys(others))
        raise BadInput(f"{name}: its faults ({names}) are for the simulated AR.Drone alone; here {', '.join(sorted(kinds))} act")


def _acts(fault: Fault, kinds: frozenset[str]) -> bool:
    return fault.kind in kinds and (not isinstance(fault, Corrupted) or carries(fault.signal, fault.error))


def _words(fault: Fault) -> str:
    return f"{fault.kind} {fault.signal}" if isinstance(fault, Corrupted) else fault.kind
