"""Many simulated flights of one scenario in one call of the core, for controllers that learn.

An episode begins with the vehicle over the deck and ends with the contact. Its sea is the scenario's, with phases of its own. The
estimate is the truth with the filter's errors, dropouts and delay. The core's part is `sitl/core/training/worlds.c`.
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from companion.guidance.law.policy import STEP_S, TRIM_TIME_S
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import CheckedOptions, number
from estimator.contracts.motion import G_M_S2
from sitl.core.abi import DL_ACTION_NUMBERS, DL_HARMONICS_MAX, DL_REWARD_TERMS, DL_VIEW_NUMBERS, DL_VIEWS_MAX
from sitl.core.library import SIM
from sitl.scenario.scenario import Scenario, pad_model, refuse_gimbal
from sitl.vehicle.disturbances import SPREADS, keep_and_fresh
from sitl.vehicle.vehicle import Vehicle
from sitl.vessel.vessel import Vessel
from sitl.world.stage import air, airframe, deck_shape, flight_seeds, limits, sea_and_vessel, wind

F32 = NDArray[np.float32]
Actions = Literal["tilt_thrust", "velocity"]
Observations = Literal["estimate", "truth"]

_PHYSICS_STEPS = 4
DOWN_MAX_M_S, YAW_RATE_MAX_RAD_S = 0.5, 0.6
"""Values of a full action: the velocity down against the deck, the turn rate."""
ENDS = tuple(name.removeprefix("DL_EPISODE_").lower() for name in SIM.names("dl_sim_episode"))
"""Endings of an episode, by the core's number."""
TERMS = tuple(name.removeprefix("DL_REWARD_").lower() for name in list(SIM.names("dl_sim_reward"))[:-1])
"""The terms of the reward, in order."""
WEIGHTS: Mapping[str, float] = {
    "nearer": 1.0, "outside": 2.0, "effort": 0.002, "time": 0.05, "landed": 5.0, "missed_by": 3.0, "speed": 1.0, "failed": 5.0,
}  # fmt: skip
"""The weights of the shipped reward: the sum of weight times term.

nearer: metres gained, of the distance beside the pad and half of the height over it. outside: -metre seconds outside of a cone
over the pad in which the camera keeps it in view. effort: -the squared change of the action. time: -seconds. landed: 1 at a soft
contact on the pad. missed_by: -the distance from the centre at the contact over the pad's radius. speed: -the speeds at the
contact over their limits. failed: -1 where an episode ends otherwise, but not at its time limit.
"""
_WRONG = tuple(name.removeprefix("DL_WRONG_").lower() for name in list(SIM.names("dl_sim_wrong"))[:-1])
"""The differences of a wrong model that are drawn for each episode."""


class EstimateErrors(CheckedOptions, frozen=True, kw_only=True):
    """The errors of the filter's estimate, as flights of sea state 4 by the model of perception show them."""

    place_m: Annotated[float, number("standard deviation of the pad's place at touchdown", "m", 0.0, 1.0)] = 0.006
    place_by_height: Annotated[float, number("what it grows by with each metre of height", "1", 0.0, 1.0)] = 0.006
    velocity_m_s: Annotated[float, number("standard deviation of the velocity against the pad", "m/s", 0.0, 2.0)] = 0.03
    velocity_by_height: Annotated[float, number("what it grows by with each metre of height", "1/s", 0.0, 1.0)] = 0.01
    time_s: Annotated[float, number("correlation time of both", "s", 0.01, 60.0)] = 0.3
    tilt_deg: Annotated[float, number("standard deviation of the attitude's constant error", "deg", 0.0, 10.0)] = 0.5
    lost_per_s: Annotated[float, number("losses of the pad", "1/s", 0.0, 50.0)] = 0.05
    lost_for_s: Annotated[float, number("mean length of a loss", "s", 0.02, 5.0)] = 0.3
    delay_steps: Annotated[int, number("steps by which an observation is late", "1", 0, DL_VIEWS_MAX - 1)] = 1


class TrainingOptions(CheckedOptions, frozen=True, kw_only=True):
    """The rules of the training worlds."""

    action: Actions = "tilt_thrust"
    observation: Observations = "estimate"
    wrong_model: Annotated[float, number("differences of the vehicle from its file, in deviations", "1", 0.0, 10.0)] = 1.0
    """0 for none; the standard deviations are those of `sitl.vehicle.disturbances.SPREADS`."""
    start_low: tuple[float, float, float, float] = (-2.0, -2.0, 2.0, -math.pi)
    """Least values of the start: the pad forward and right of the body, m; height over it, m; heading against the arrow, rad."""
    start_high: tuple[float, float, float, float] = (2.0, 2.0, 5.0, math.pi)
    time_limit_s: Annotated[float, number("longest episode", "s", STEP_S, 3600.0)] = 30.0
    vertical_max_m_s: Annotated[float, number("fastest contact, downward, that counts as landed", "m/s", 0.0, 20.0)] = 1.0
    lateral_max_m_s: Annotated[float, number("fastest contact along the deck that counts as landed", "m/s", 0.0, 20.0)] = 0.5
    reach_m: Annotated[float, number("distance from the pad at which an episode ends", "m", 0.1, 1e4)] = 12.0
    velocity_max_m_s: Annotated[float, number("velocity of a full action, where actions are velocities", "m/s", 0.01, 50.0)] = 1.5
    errors: EstimateErrors = EstimateErrors()

    def __post_init__(self) -> None:
        super().__post_init__()
        for low, high in zip(self.start_low, self.start_high, strict=True):
            if not -math.inf < low <= high < math.inf:
                raise ValueError(f"TrainingOptions.start_low and start_high need finite numbers in order, got {low!r}, {high!r}")


_HELD = ("_kept", "views", "last_views", "terms", "touchdowns", "ends")
"""The arrays in which training worlds hold all that changes."""


class TrainingWorlds:
    """Worlds of one scenario that step together.

    Args:
        scenario: its vessel keeps a steady course.
        count: number of worlds.
        threads: number of threads that share the worlds. The results do not depend on it.

    Attributes:
        views: (count, DL_VIEW_NUMBERS) the newest observations; of a world whose episode ended those of its next one.
        terms: (count, DL_REWARD_TERMS) of the last step's reward.
        ends: (count,) how the episodes ended with the last step, numbers of `ENDS`.
        last_views: (count, DL_VIEW_NUMBERS) the last observations of episodes that ended with the last step.
        touchdowns: (count, 3) of those which ended with a contact: distance from the centre, m, and speeds down and along the
            deck, m/s; else NaN.

    Raises:
        BadInput: the scenario's vessel turns, or moves as recorded.
        ValueError: there is no world or no thread.
    """

    def __init__(self, scenario: Scenario, count: int, options: TrainingOptions | None = None, threads: int = 1) -> None:
        refuse_gimbal(scenario)
        if count < 1 or threads < 1:
            raise ValueError(f"training worlds and their threads must be 1 or more, got {count!r} and {threads!r}")
        self.options = o = options or TrainingOptions()
        self.scenario, self.count, self._threads = scenario, count, threads
        self._rules = _rules(scenario, o)
        self._kept = np.zeros(count, SIM.dtype("dl_sim_training_world"))
        self._worlds = SIM.array("dl_sim_training_world", self._kept)
        self.views: F32 = np.zeros((count, DL_VIEW_NUMBERS), np.float32)
        self.last_views: F32 = np.zeros((count, DL_VIEW_NUMBERS), np.float32)
        self.terms: F32 = np.zeros((count, DL_REWARD_TERMS), np.float32)
        self.touchdowns: F32 = np.full((count, 3), np.nan, np.float32)
        self.ends: NDArray[np.int8] = np.zeros(count, np.int8)
        self._actions: F32 = np.zeros((count, DL_ACTION_NUMBERS), np.float32)
        edges = np.linspace(0, count, min(threads, count) + 1).astype(int)
        self._parts = [self._part(int(a), int(b)) for a, b in pairwise(edges)]
        self._pool = ThreadPoolExecutor(len(self._parts) - 1, "worlds") if len(self._parts) > 1 else None

    def __getstate__(self) -> dict[str, Any]:
        """Return what the worlds are and hold, for copies and other processes: the core's memory and the threads stay here."""
        names = "scenario", "count", "options", "_threads", *_HELD
        return {name: getattr(self, name) for name in names}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["scenario"], state["count"], state["options"], state["_threads"])  # type: ignore[misc]
        for name in _HELD:
            getattr(self, name)[:] = state[name]

    def _part(self, first: int, end: int) -> tuple[int, Any, Any, Any]:
        rows = slice(first, end)
        out = SIM.new(
            "dl_sim_training_step",
            views=self.views[rows], terms=self.terms[rows], last_views=self.last_views[rows], touchdowns=self.touchdowns[rows],
            ends=self.ends[rows],
        )  # fmt: skip
        return end - first, self._worlds + first, SIM.array("float", self._actions[rows]), out

    def begin(self, seeds: Sequence[int]) -> F32:
        """Begin an episode in every world and return the first observations (count, DL_VIEW_NUMBERS).

        Args:
            seeds: one a world; equal seeds give equal worlds for good, wherever they stand.

        Raises:
            ValueError: there are not `count` of them.
        """
        if len(seeds) != self.count:
            raise ValueError(f"{len(seeds)} seeds for {self.count} worlds")
        for world, seed in zip(self._kept, seeds, strict=True):
            world["random"] = np.random.SeedSequence(seed).generate_state(4, np.uint64)
        SIM.lib.dl_sim_training_begin(self._rules, self.count, self._worlds, SIM.array("float", self.views))
        return self.views

    @property
    def acceleration_m_s2(self) -> float:
        """The acceleration of a full action."""
        return float(self._rules.acceleration_max_m_s2)

    @property
    def truth(self) -> NDArray[Any]:
        """The core's `dl_sim_training_world` of every world, (count,), whose members are read by name."""
        return self._kept

    def snapshot(self, index: int) -> NDArray[Any]:
        """Return the core's `dl_sim_training_world` of one world, whose members are read by name."""
        return self._kept[index]  # type: ignore[no-any-return]

    def step(self, actions: F32) -> None:
        """Take one step in every world; a world whose episode ends begins the next one.

        Args:
            actions: (count, DL_ACTION_NUMBERS), each -1 to 1; more is cut off.

        Raises:
            ValueError: one is NaN, or they have another shape.
        """
        if np.isnan(actions).any():
            raise ValueError("an action is not a number (NaN): no world takes the step")
        self._actions[:] = actions
        waiting = [self._pool.submit(self._step, part) for part in self._parts[1:]] if self._pool else []
        self._step(self._parts[0])
        for part in waiting:
            part.result()

    def _step(self, part: tuple[int, Any, Any, Any]) -> None:
        count, worlds, actions, out = part
        SIM.lib.dl_sim_training_step_all(self._rules, count, worlds, actions, out)


def _rules(scenario: Scenario, o: TrainingOptions) -> Any:
    """Return the core's `dl_sim_training`.

    Raises:
        BadInput: as `TrainingWorlds`.
    """
    _, vessel = sea_and_vessel(scenario, [0])
    if type(vessel) is not Vessel:
        raise BadInput("training worlds need a vessel on a steady course")
    harmonics = vessel.harmonics[0]
    if len(harmonics) > DL_HARMONICS_MAX:
        raise BadInput(f"the scenario has {len(harmonics)} waves, and training worlds hold {DL_HARMONICS_MAX}")
    physics_s = STEP_S / _PHYSICS_STEPS
    shape = deck_shape(vessel.hull, math.radians(scenario.vessel.pad_yaw_deg))
    vehicle = Vehicle(airframe(scenario), shape, physics_s, flight_seeds(0).flight, wind(scenario), air(scenario, vessel.hull))
    vehicle.limits, vehicle.current = limits(scenario), scenario.sea.current_ne_m_s
    vehicle.keep_limits()
    e = o.errors
    keep, fresh = keep_and_fresh(1.0, e.time_s, STEP_S)
    rules = SIM.new(
        "dl_sim_training",
        harmonics=len(harmonics), physics_steps=_PHYSICS_STEPS, steps_max=round(o.time_limit_s / STEP_S),
        velocity_actions=o.action == "velocity", true_view=o.observation == "truth", view_delay=e.delay_steps, step_s=STEP_S,
        cos_course=math.cos(vessel.heading_rad[0]), sin_course=math.sin(vessel.heading_rad[0]),
        acceleration_max_m_s2=G_M_S2 * math.tan(vehicle.limits.euler_angle_max_rad), velocity_max_m_s=o.velocity_max_m_s,
        velocity_gain=1.5, down_max_m_s=DOWN_MAX_M_S, yaw_rate_max_rad_s=YAW_RATE_MAX_RAD_S,
        start_low=o.start_low, start_high=o.start_high, pad_radius_m=pad_model(scenario).disc_radius_m,
        vertical_max_m_s=o.vertical_max_m_s, lateral_max_m_s=o.lateral_max_m_s, reach_m=o.reach_m,
        trim_keep=math.exp(-STEP_S / TRIM_TIME_S), place_sigma_m=e.place_m, place_sigma_by_height=e.place_by_height,
        velocity_sigma_m_s=e.velocity_m_s, velocity_sigma_by_height=e.velocity_by_height, error_keep=keep, error_fresh=fresh,
        tilt_sigma_rad=math.radians(e.tilt_deg), lost_share=1.0 - math.exp(-e.lost_per_s * STEP_S),
        found_share=1.0 - math.exp(-STEP_S / e.lost_for_s),
        wrong_sigma=[o.wrong_model * SPREADS[name] for name in _WRONG],
    )  # fmt: skip
    SIM.fill(SIM.ffi.addressof(rules, "course"), v=vessel.way_at(0.0), heading_rad=float(vessel.heading_rad[0]))
    SIM.fill(SIM.ffi.addressof(rules, "pad"), d=vessel.d_vessel_pad, R=vessel.R_vessel_pad.matrix)
    rules.vehicle_params, rules.vehicle = vehicle.params[0], vehicle.state[0]
    for sway, wave in zip(rules.sway, harmonics, strict=False):
        w, re, im = float(wave["w_rad_s"]), wave["re"], wave["im"]
        SIM.fill(
            SIM.ffi.addressof(sway),
            by_re=[*re, *(w * im)], by_im=[*-im, *(w * re)], turn_re=math.cos(w * STEP_S), turn_im=-math.sin(w * STEP_S),
        )  # fmt: skip
    return rules
