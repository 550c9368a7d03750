"""Decide whether the pipeline is alive: whether guidance decides and uses its inputs, not whether the process runs. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass

from companion.base.health import HealthSnapshot
from estimator.contracts.estimates import Verdict

SAMPLE_KINDS = ("Attitude", "Imu", "BodyVelocity", "VehicleStatus")
"""Flows that keep arriving while the vehicle is in reach."""


@dataclass(frozen=True, slots=True)
class LivenessLimits:
    """The longest time that each stage may take before it counts as stuck, seconds."""

    guidance_s: float = 1.0
    """Longest time between two guidance cycles, seconds."""
    frame_s: float = 3.0
    """Longest time that vision may spend on one frame, seconds."""
    samples_s: float = 10.0
    """Longest time without a sample from a vehicle that last reported flying, seconds. A landed or unknown one may be off."""


def stuck(health: HealthSnapshot, flying: bool, limits: LivenessLimits | None = None) -> str | None:
    """Return why the pipeline is not alive, as text; None while it is.

    Args:
        flying: whether the vehicle flew according to its latest status.
    """
    limits = limits or LivenessLimits()
    decided = health.flows.get("Decision")
    age_s = None if decided is None else decided.age_s
    if age_s is None:
        return "guidance has not begun"
    if age_s > limits.guidance_s:
        return f"guidance has decided nothing for {age_s:.1f} s"
    frames = health.flows.get("Frame")
    if frames is not None and frames.age_s is not None and frames.age_s > limits.frame_s:
        done = sum(n for verdict, n in health.frames.items() if verdict != Verdict.REPLACED.value)
        if frames.count > done:
            return f"vision has not been done with a frame for {frames.age_s:.1f} s"
    silence_s = _youngest_s(health)
    if flying and silence_s is not None and silence_s > limits.samples_s:
        return f"no sample of the flying vehicle for {silence_s:.1f} s"
    return None


def _youngest_s(health: HealthSnapshot) -> float | None:
    flows: Mapping[str, float | None] = {kind: health.flows[kind].age_s for kind in SAMPLE_KINDS if kind in health.flows}
    ages = [age for age in flows.values() if age is not None]
    return min(ages) if ages else None
