"""Sight of the pad lost near the deck, while the filter takes a bias of the accelerometer for a heave of the deck."""

from __future__ import annotations

from msgspec.structs import replace

from sitl.one_flight import fly, settings_for
from sitl.scenario import load
from sitl.truth import Truth

SEED = 7020
"""Its accelerometer is wrong by 0.8 m/s^2, and below 0.2 m neither camera nor ultrasound measures the height."""


def test_it_touches_nothing_and_goes_around() -> None:
    scenario = replace(load("ardrone1"), duration_limit_s=16.0)
    settings = settings_for(scenario, None)
    heights_m: list[float] = []

    def on_truth(truth: Truth) -> None:
        heights_m.append(float(truth.d_body_pad_level[2]))

    ending = fly("ardrone1", scenario, SEED, settings, "model", on_truth=on_truth)
    assert not ending.contacts
    assert min(heights_m) < settings.guidance.cone.gate_m
    assert heights_m[-1] > settings.guidance.tries.safe_height_m
