"""The training worlds as Gymnasium environments, which `sitl.study.gym` registers."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal, get_args

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from msgspec.structs import replace
from numpy.typing import NDArray

from companion.guidance.law.policy import STEP_S
from estimator.contracts.geometry import known_rotation
from sitl.camera.camera import Exposure
from sitl.core.abi import DL_ACTION_NUMBERS, DL_VIEW_NUMBERS
from sitl.scenario.scenario import Scenario, camera_model, load
from sitl.study.gym.training import ENDS, F32, TERMS, WEIGHTS, TrainingOptions, TrainingWorlds
from sitl.world.stage import renderer, sea_and_vessel

Perception = Literal["model", "truth"]
Observation = Literal["estimate", "truth", "pixels"]
Reward = Callable[[F32], F32]
"""Takes the terms (N, 8) of N worlds, in the order of `TERMS`, to their rewards (N,)."""
_FLYING, _TIMED_OUT = ENDS.index("goes_on"), ENDS.index("timed_out")
_MOST = 1e4
"""No number of an observation is larger."""
_GRAIN = 0x6A1
"""Keeps the noise of images apart from the other random numbers of a seed."""


def weighted(weights: Mapping[str, float] = WEIGHTS) -> Reward:
    """Return the reward that sums weight times term.

    Raises:
        KeyError: a weight is missing.
    """
    column = np.array([weights[name] for name in TERMS], np.float32)
    return partial(_sum, column)


def _sum(column: F32, terms: F32) -> F32:
    return np.asarray((terms * column).sum(axis=-1))


def _worlds(scenario: str | Scenario, vehicle: str | None, count: int, threads: int, options: dict[str, Any]) -> TrainingWorlds:
    chosen = load(scenario) if isinstance(scenario, str) else scenario
    if vehicle is not None:
        chosen = replace(chosen, vehicle=replace(chosen.vehicle, file=vehicle))
    return TrainingWorlds(chosen, count, TrainingOptions(**options), threads)


def _check(perception: str, reward: Reward | None, observation: str = "estimate") -> None:
    """Refuse what a world would fly without. Raises ValueError."""
    for name, word, of in (("perception", perception, Perception), ("observation", observation, Observation)):
        if word not in (words := get_args(of)):
            raise ValueError(f"{name} must be one of {', '.join(words)}, got {word!r}")
    if reward is not None and not callable(reward):
        raise ValueError(f"reward must be a function of the terms, got {reward!r}")


def _spaces() -> tuple[gymnasium.Space[Any], gymnasium.Space[Any]]:
    high = np.full(DL_VIEW_NUMBERS, _MOST, np.float32)
    return Box(-high, high, dtype=np.float32), Box(-1.0, 1.0, (DL_ACTION_NUMBERS,), np.float32)


def _info(worlds: TrainingWorlds, index: int) -> dict[str, Any]:
    """Return the info of a world's last step: its end, the reward's terms, and the touchdown if there was one."""
    made = {"end": ENDS[worlds.ends[index]], "terms": dict(zip(TERMS, worlds.terms[index].tolist(), strict=True))}
    touchdown = worlds.touchdowns[index].tolist()
    if not math.isnan(touchdown[0]):
        made["touchdown"] = dict(zip(("distance_m", "vertical_speed_m_s", "lateral_speed_m_s"), touchdown, strict=True))
    return made


class LandEnv(gymnasium.Env[Any, F32]):
    """One world.

    Args:
        scenario: name of a scenario, or one.
        vehicle: name of a vehicle in place of the scenario's.
        perception: `model` observes by the filter's errors, `truth` without.
        action: `tilt_thrust` (acceleration) or `velocity`; see `action_number` in sitl/core/decklander_sim.h.
        observation: `estimate` and `truth` are 21 numbers, `pixels` the bottom camera's image.
        reward: of the terms; by default `weighted()`.
        render_mode: `rgb_array` returns the camera's image, `human` shows it in a window of OpenCV or matplotlib.
        options: further fields of `TrainingOptions`.

    Raises:
        BadInput: there is no such scenario or vehicle, or its vessel keeps no steady course.
        ValueError: a word is none of those allowed, or a number is outside its range.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": round(1.0 / STEP_S)}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Scenario = "sea_state_4",
        *,
        vehicle: str | None = None,
        perception: Perception = "model",
        observation: Observation = "estimate",
        reward: Reward | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        _check(perception, reward, observation)
        seen = "truth" if perception == "truth" or observation == "truth" else "estimate"
        self.worlds = _worlds(scenario, vehicle, 1, 1, {"observation": seen, **options})
        self.observation_space, self.action_space = _spaces()
        self.render_mode, self._pixels, self._reward = render_mode, observation == "pixels", reward or weighted()
        self._grain = np.random.default_rng(_GRAIN)
        self._renderer: Any = None
        self._window: Any = None
        if self._pixels:
            camera = camera_model(self.worlds.scenario)
            self.observation_space = Box(0, 255, (camera.height, camera.width, 3), np.uint8)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; equal seeds give equal ones."""
        super().reset(seed=seed)
        chosen = int(self.np_random.integers(2**31)) if seed is None else seed
        self.worlds.begin([chosen])
        self._grain = np.random.default_rng([chosen, _GRAIN])
        if self.render_mode == "human":
            self.render()
        return self._observed(self.worlds.views[0]), {}

    def step(self, action: F32) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take one step of 20 ms. Raises ValueError for an action that is NaN."""
        w = self.worlds
        w.step(np.asarray(action, np.float32).reshape(1, DL_ACTION_NUMBERS))
        end = int(w.ends[0])
        over = end != _FLYING
        observed = self._observed(w.last_views[0] if over else w.views[0])
        if self.render_mode == "human" and not over:
            self.render()
        return observed, float(self._reward(w.terms)[0]), over and end != _TIMED_OUT, end == _TIMED_OUT, _info(w, 0)

    def render(self) -> Any:
        """Return the bottom camera's image (H, W, 3) RGB, or show it."""
        image = self._image()[..., ::-1]
        if self.render_mode != "human":
            return np.ascontiguousarray(image)
        from matplotlib import pyplot  # an extra of its own: only a window needs it

        if self._window is None:
            self._window = pyplot.imshow(image)
            pyplot.axis("off")
        self._window.set_data(image)
        pyplot.pause(0.001)
        return None

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            from matplotlib import pyplot

            pyplot.close(self._window.figure)
            self._window = None

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a copy, which makes a renderer of its own and has no window."""
        return {**self.__dict__, "_renderer": None, "_window": None}

    def _observed(self, view: F32) -> Any:
        return self._image()[..., ::-1].copy() if self._pixels else view.copy()

    def _image(self) -> NDArray[np.uint8]:
        """Return the bottom camera's image (H, W, 3) BGR of the world as it is now."""
        if self._renderer is None:
            waves, vessel = sea_and_vessel(self.worlds.scenario, [0])
            self._renderer = renderer(self.worlds.scenario, waves, vessel, 0)
        at = self.worlds.snapshot(0)
        vehicle, deck = at["vehicle"], at["deck"]
        shot = Exposure(
            t_s=float(at["t_s"]),
            R_ned_body=known_rotation(vehicle["R"].reshape(3, 3)),
            p_body_ned=vehicle["p"],
            R_ned_pad=known_rotation(deck["R"].reshape(3, 3)),
            p_pad_ned=deck["p"],
            v_body_ned=vehicle["v"],
            w_body=vehicle["w"],
            v_pad_ned=deck["v"],
            w_pad=deck["w"],
        )
        made: NDArray[np.uint8] = self._renderer.order(shot, self._grain)()
        return made


class LandVectorEnv(VectorEnv[F32, F32, Any]):
    """Many worlds that one call of the core steps; an episode that ends is followed by the next in the same step.

    Args:
        num_envs: number of worlds.
        threads: number of threads that share them.
        scenario, vehicle, perception, observation, reward, options: as those of `LandEnv`, without pixels.

    Raises:
        BadInput, ValueError: as `LandEnv`.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 64,
        scenario: str | Scenario = "sea_state_4",
        *,
        vehicle: str | None = None,
        perception: Perception = "model",
        threads: int = 1,
        reward: Reward | None = None,
        **options: Any,
    ) -> None:
        _check(perception, reward)
        seen = "truth" if perception == "truth" else "estimate"
        self.num_envs, self.render_mode = num_envs, None
        self.worlds = _worlds(scenario, vehicle, num_envs, threads, {"observation": seen, **options})
        self.single_observation_space, self.single_action_space = _spaces()
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        self._reward = reward or weighted()

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[F32, dict[str, Any]]:
        """Begin an episode in every world; world i of seed s is the single environment of seed s + i."""
        if isinstance(seed, int) or seed is None:
            super().reset(seed=seed)
            first = int(self.np_random.integers(2**31)) if seed is None else seed
            seeds = [first + i for i in range(self.num_envs)]
        else:
            seeds = [int(self.np_random.integers(2**31)) if s is None else s for s in seed]
        return self.worlds.begin(seeds).copy(), {}

    def step(self, actions: F32) -> tuple[F32, F32, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Take one step of 20 ms in every world. Raises ValueError for an action that is NaN, and no world takes it."""
        w = self.worlds
        w.step(actions)
        over, timed_out = w.ends != _FLYING, w.ends == _TIMED_OUT
        info: dict[str, Any] = {}
        if over.any():
            info = {"final_obs": w.last_views.copy(), "_final_obs": over, "end": w.ends.copy(), "touchdown": w.touchdowns.copy()}
        return w.views.copy(), self._reward(w.terms), over & ~timed_out, timed_out, info
