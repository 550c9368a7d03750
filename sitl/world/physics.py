"""One vehicle with its sensors, advanced by the core over a moving deck and a sea, several steps in one call."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.core.library import SIM
from sitl.sea.sea import Waves
from sitl.sensors.sensors import Sensors
from sitl.vehicle.vehicle import Vehicle
from sitl.vessel.vessel import Mounted

_SEA_EVERY = 5
"""Steps from one look at the water's level to the next; in between it moves with its velocity."""


class Physics:
    """The steps of one vehicle.

    Args:
        waves: a batch of one.
    """

    def __init__(self, vehicle: Vehicle, sensors: Sensors, waves: Waves) -> None:
        self._vehicle, self._sensors = vehicle, sensors
        v, s = vehicle, sensors
        self._air = v.air_noise or v.noise
        self._noises = tuple(dict.fromkeys((v.noise, self._air, s.noise)))
        self._sea, core_waves = SIM.new("sim_water", every=_SEA_EVERY), waves.packed()
        self._flight = SIM.new(
            "sim_flight", vehicle_params=v.params, vehicle=v.state, sensor_params=s.params, sensors=s.state,
            water=self._sea, waves=core_waves, harmonics=len(core_waves),
        )  # fmt: skip
        self._decks: NDArray[Any] = np.empty(0)
        self._first_deck: Any = None

    def run(self, decks: NDArray[Any], first: int, at_most: int) -> int:
        """Take steps over a deck, up to a contact with deck or water after flight; return how many.

        Args:
            decks: the deck at each step, as `decks_of` gives them.
            first: index of the next step's deck.
            at_most: how many steps to take, 1 or more; there are fewer where a block of noise ends.

        Raises:
            IndexError: there are not so many decks.
        """
        if decks is not self._decks:
            self._decks, self._first_deck = decks, SIM.array("sim_deck", decks)
        if not 0 <= first <= len(decks) - at_most:
            raise IndexError(f"{at_most} steps from {first} on, but {len(decks)} decks")
        n, vehicle = at_most, self._vehicle
        for noise in self._noises:
            ready = noise.prepare()
            if ready < n:
                n = ready
        vehicle.keep_limits()
        done: int = SIM.lib.sim_run(
            self._flight, n, self._first_deck + first, vehicle.noise.row, self._air.row, self._sensors.noise.row
        )
        for noise in self._noises:
            noise.used(done)
        return done


def decks_of(pads: Mounted) -> NDArray[Any]:
    """Return one vessel's pad at T instants as the core's `sim_deck`s, (T,)."""
    decks = np.empty(pads.p_ned.shape[1], SIM.dtype("sim_deck"))
    decks["p"], decks["v"], decks["R"], decks["w"] = pads.p_ned[0], pads.v_ned[0], pads.R_ned[0].reshape(-1, 9), pads.w[0]
    return decks
