"""One vehicle with its sensors, advanced by the core over a moving deck and a sea, several steps in one call."""

from __future__ import annotations

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.library import start_of
from sitl.core.library import size_of
from sitl.native import Packed, sim_run
from sitl.sea.sea import Waves
from sitl.sensors.sensors import Sensors
from sitl.vehicle.vehicle import Vehicle
from sitl.vessel.vessel import Mounted

_SEA_EVERY = 5
"""Steps from one look at the water's level to the next; in between it moves with its velocity."""
_DECK = size_of("deck")


class Physics:
    """The steps of one vehicle.

    Args:
        waves: a batch of one.
    """

    def __init__(self, vehicle: Vehicle, sensors: Sensors, waves: Waves) -> None:
        self._vehicle, self._sensors = vehicle, sensors
        self._waves = waves.packed()
        self._sea = Packed("water", every=_SEA_EVERY)
        v, s = vehicle, sensors
        self._air = v.air_noise or v.noise
        self._noises = tuple(dict.fromkeys((v.noise, self._air, s.noise)))
        self._before = v.params.address, v.state.address, s.params.address, s.state.address, self._sea.address
        self._decks, self._decks_at = np.empty(0), 0
        self._waves_at = len(self._waves), start_of(self._waves)

    def run(self, decks: F64, first: int, at_most: int) -> int:
        """Take steps over a deck, up to a contact with deck or water after flight; return how many.

        Args:
            decks: (T, DECK) as `decks_of` gives them.
            first: index of the next step's row.
            at_most: how many steps to take, 1 or more; there are fewer where a block of noise ends.
        """
        if decks is not self._decks:
            self._decks, self._decks_at = decks, start_of(decks)
        n, vehicle = at_most, self._vehicle
        for noise in self._noises:
            ready = noise.prepare()
            if ready < n:
                n = ready
        vehicle.keep_limits()
        done: int = sim_run(
            *self._before, *self._waves_at, n, self._decks_at + 8 * _DECK * first,
            vehicle.noise.address, self._air.address, self._sensors.noise.address,
        )  # fmt: skip
        for noise in self._noises:
            noise.used(done)
        return done


def decks_of(pads: Mounted) -> F64:
    """Return one vessel's pad at T instants as the core's `deck`s, (T, 18): position, velocity, rotation, rates."""
    n = pads.p_ned.shape[1]
    return np.concatenate([pads.p_ned[0], pads.v_ned[0], pads.R_ned[0].reshape(n, 9), pads.w[0]], axis=1)
