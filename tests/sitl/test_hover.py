"""A long hover teaches the filter nothing that it cannot see."""

import numpy as np

from companion.base.observer import Decision, NullObserver
from companion.settings.load import load
from sitl.flight.flight import Flight
from tests.fly import new_flight
from tests.make import change

SETTLED_S = 20.0


class Errors(NullObserver):
    """The NEES of the pad's position at each decision of a settled hover."""

    def __init__(self) -> None:
        self.nees: list[float] = []
        self.flight: Flight | None = None

    def on_decision(self, decision: Decision) -> None:
        assert self.flight is not None
        if decision.belief is not None and decision.at > SETTLED_S * 1e9:
            error = decision.belief.d_body_pad_level - self.flight.world.truth().d_body_pad_level
            self.nees.append(float(error @ np.linalg.solve(decision.belief.cov[:3, :3], error)))


def test_a_tilted_body_is_not_distinguished_from_a_biased_accelerometer_by_standing_still() -> None:
    """Two seeds whose accelerometers are off by two sigma; a filter that learns from its own corrections is at 10, not at 3."""
    settings = change(load("sim"), guidance={"start": "signal"})
    means = []
    for seed in (1, 7):
        errors = Errors()
        errors.flight = new_flight("calm", seed, level="model", settings=settings, observers=[errors], duration_limit_s=30.0)
        errors.flight.run()
        assert len(errors.nees) > 300
        means.append(np.mean(errors.nees))
    assert max(means) < 8.0
