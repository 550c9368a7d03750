"""Whether the pipeline is alive: not that the process runs, but that guidance decides and what comes in is used. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from companion.runtime.health import HealthSnapshot
from estimator.contracts.estimates import Verdict

SAMPLE_KINDS = ("Attitude", "Imu", "BodyVelocity", "VehicleStatus")
"""Flows that a vehicle in reach keeps going."""


@dataclass(frozen=True, slots=True)
class LivenessLimits:
    """How long each may take before it counts as stuck, seconds."""

    guidance_s: float = 1.0
    """Between two rounds."""
    frame_s: float = 3.0
    """For vision to be done with the frame it has."""
    samples_s: float = 10.0
    """Without any sample of a vehicle that flew when it was last heard. One that stands, or was never heard, may be off."""


def stuck(health: HealthSnapshot, flying: bool, limits: LivenessLimits | None = None) -> str | None:
    """Why the pipeline is not alive, in words; None while it is.

    Args:
        flying: whether the vehicle flew when it was last heard of.
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
