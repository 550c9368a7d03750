"""Train a policy in the training worlds by proximal policy optimization, with numpy alone.

Source: Schulman et al., Proximal policy optimization algorithms, 2017 (clipped objective, eq. 7); Schulman et al., High-dimensional
continuous control using generalized advantage estimation, ICLR 2016 (eq. 16). Adam: Kingma & Ba, ICLR 2015.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from companion.guidance.policy import ACTIONS, F32, OBSERVED, Policy
from sitl.gym.environment import Reward, weighted
from sitl.gym.training import DOWN_MAX_M_S, ENDS, TrainingWorlds

Weights = dict[str, F32]

_FLYING, _LANDED, _TIMED_OUT = (ENDS.index(name) for name in ("goes_on", "landed", "timed_out"))


@dataclass(frozen=True, slots=True)
class PpoOptions:
    """The numbers of the training."""

    rollout: int = 128
    """Steps of each world between two updates."""
    epochs: int = 3
    minibatch: int = 4096
    width: int = 64
    discount: float = 0.995
    trace: float = 0.95
    clip: float = 0.2
    learning_rate: float = 1e-3
    entropy: float = 1e-3
    log_std: float = -1.5
    """Logarithm of the first standard deviation of an action."""
    gradient_max: float = 0.5


class Progress(NamedTuple):
    """One update: steps so far, episodes that ended, share of them that landed, their mean distance from the centre, mean reward."""

    steps: int
    episodes: int
    landed: float
    distance_m: float
    reward: float


class Trainer:
    """A policy with its value function, and the optimizer's memory.

    Args:
        worlds: where it flies.
        seed: of weights and exploration.
        first: the policy that training goes on from; None begins anew.
        reward: of the terms.
    """

    def __init__(
        self,
        worlds: TrainingWorlds,
        seed: int,
        first: Policy | None = None,
        options: PpoOptions | None = None,
        reward: Reward | None = None,
    ) -> None:
        self._worlds, self._o, self._reward = worlds, options or PpoOptions(), reward or weighted()
        self._rng = rng = np.random.default_rng([seed, 0x990])
        self._actor, self._critic = (_network(rng, self._o.width, out, gain) for out, gain in ((ACTIONS, 0.01), (1, 1.0)))
        self._log_std = np.full(ACTIONS, self._o.log_std, np.float32)
        self._mean, self._scale = np.zeros(OBSERVED, np.float32), np.ones(OBSERVED, np.float32)
        self._measured = False
        if first is not None:
            self._actor = {key: first.weights[key].copy() for key in self._actor}
            self._mean, self._scale, self._measured = first.weights["mean"].copy(), first.weights["scale"].copy(), True
            self._log_std[:] = first.record.get("log_std", self._o.log_std)
        self._trained = {**{f"a{k}": v for k, v in self._actor.items()}, **{f"c{k}": v for k, v in self._critic.items()}}
        self._trained["log_std"] = self._log_std
        self._moments = {key: (np.zeros_like(v), np.zeros_like(v)) for key, v in self._trained.items()}
        self._updates = 0

    def train(self, steps: int, seed: int) -> Iterator[Progress]:
        """Train for so many steps of all worlds together, and yield after each update.

        Args:
            seed: of the first world; the others count on from it.
        """
        worlds, o = self._worlds, self._o
        seen = worlds.begin(range(seed, seed + worlds.count)).copy()
        per_update = o.rollout * worlds.count
        for update in range(max(1, steps // per_update)):
            batch, seen, figures = self._rollout(seen)
            left = 1.0 - update * per_update / steps
            self._update(batch, o.learning_rate * max(0.05, left))
            yield Progress((update + 1) * per_update, *figures)

    def imitate(self, steps: int, seed: int) -> None:
        """Begin with what a proportional-derivative law does, which the worlds are flown by meanwhile."""
        worlds, o = self._worlds, self._o
        seen = worlds.begin(range(seed, seed + worlds.count)).copy()
        for _ in range(max(1, steps // (o.rollout * worlds.count))):
            x, given = [], []
            for _ in range(o.rollout):
                action = _prior(seen, worlds.acceleration_m_s2)
                x.append(seen)
                given.append(action)
                worlds.step(action + np.float32(0.2) * self._rng.standard_normal(action.shape, np.float32))
                seen = worlds.views.copy()
            if not self._measured:
                self._measure(np.concatenate(x))
            inputs, wanted = self._normal(np.concatenate(x)), np.concatenate(given)
            for _ in range(o.epochs):
                order = self._rng.permutation(len(inputs))
                for first in range(0, len(order), o.minibatch):
                    part = order[first : first + o.minibatch]
                    layers = _forward(self._actor, inputs[part])
                    pull = (layers[-1] - wanted[part]) / len(part)
                    made = _backward(self._actor, inputs[part], layers, pull)
                    self._adam({f"a{k}": v for k, v in made.items()}, o.learning_rate)

    def policy(self, record: dict[str, Any]) -> Policy:
        """Return the policy as it is now, with its record."""
        weights = {key: value.copy() for key, value in self._actor.items()}
        full = {"acceleration_m_s2": self._worlds.acceleration_m_s2, "down_m_s": DOWN_MAX_M_S, "log_std": self._log_std.tolist()}
        return Policy({**weights, "mean": self._mean.copy(), "scale": self._scale.copy()}, {**record, **full})

    def _rollout(self, seen: F32) -> tuple[dict[str, F32], F32, tuple[int, float, float, float]]:
        """Fly, and return the batch, the next observations, and episodes, landed share, distance and reward."""
        o, w, n = self._o, self._worlds, self._worlds.count
        shape = (o.rollout, n)
        batch = {"x": np.empty((*shape, OBSERVED), np.float32), "u": np.empty((*shape, ACTIONS), np.float32)}
        reward, value, kept, logp = (np.empty(shape, np.float32) for _ in range(4))
        ended: list[F32] = []
        episodes = landed = 0
        std = np.exp(self._log_std)
        for t in range(o.rollout):
            x = self._normal(seen)
            noise = self._rng.standard_normal((n, ACTIONS), np.float32)
            batch["x"][t], batch["u"][t] = x, _forward(self._actor, x)[-1] + std * noise
            logp[t] = -0.5 * (noise * noise).sum(axis=1) - self._log_std.sum()
            value[t] = _forward(self._critic, x)[-1][:, 0]
            w.step(batch["u"][t])
            reward[t], over = self._reward(w.terms), w.ends != _FLYING
            late = w.ends == _TIMED_OUT
            if late.any():  # an episode that was only cut off goes on in the value of its last state
                reward[t, late] += o.discount * _forward(self._critic, self._normal(w.last_views[late]))[-1][:, 0]
            kept[t] = ~over
            episodes += int(over.sum())
            landed += int((w.ends == _LANDED).sum())
            ended.append(w.touchdowns[w.ends == _LANDED, 0])
            seen = w.views.copy()
        advantage, follows, ahead = np.empty(shape, np.float32), _forward(self._critic, self._normal(seen))[-1][:, 0], np.zeros(n)
        for t in reversed(range(o.rollout)):
            delta = reward[t] + o.discount * kept[t] * follows - value[t]
            ahead = delta + o.discount * o.trace * kept[t] * ahead
            advantage[t], follows = ahead, value[t]
        batch |= {"advantage": advantage, "target": advantage + value, "logp": logp}
        distances = np.concatenate(ended)
        figures = episodes, landed / max(1, episodes), float(distances.mean()) if distances.size else math.nan, float(reward.mean())
        return {key: x.reshape(o.rollout * n, *x.shape[2:]) for key, x in batch.items()}, seen, figures

    def _measure(self, seen: F32) -> None:
        """Take the mean and the scale of observations, by which the networks see them from now on."""
        self._mean, self._scale, self._measured = seen.mean(axis=0), seen.std(axis=0).clip(1e-2), True

    def _normal(self, seen: F32) -> F32:
        x: F32 = np.clip((seen - self._mean) / self._scale, -10.0, 10.0)
        return x

    def _update(self, batch: dict[str, F32], rate: float) -> None:
        o, count = self._o, len(batch["x"])
        batch["advantage"] = (batch["advantage"] - batch["advantage"].mean()) / (batch["advantage"].std() + 1e-6)
        for _ in range(o.epochs):
            order = self._rng.permutation(count)
            for first in range(0, count, o.minibatch):
                part = {key: value[order[first : first + o.minibatch]] for key, value in batch.items()}
                self._adam(self._gradients(part), rate)

    def _gradients(self, part: dict[str, F32]) -> Weights:
        o, n, std = self._o, len(part["x"]), np.exp(self._log_std)
        actor = _forward(self._actor, part["x"])
        z = (part["u"] - actor[-1]) / std
        ratio = np.exp(np.clip(-0.5 * (z * z).sum(axis=1) - self._log_std.sum() - part["logp"], -20.0, 20.0))
        a = part["advantage"]
        flows = np.where(a > 0, ratio < 1 + o.clip, ratio > 1 - o.clip)
        pull = (-(a * ratio) * flows / n)[:, None]
        made = {f"a{k}": v for k, v in _backward(self._actor, part["x"], actor, pull * z / std).items()}
        made["log_std"] = (pull * (z * z - 1.0)).sum(axis=0) - o.entropy
        critic = _forward(self._critic, part["x"])
        error = critic[-1] - part["target"][:, None]
        made |= {f"c{k}": v for k, v in _backward(self._critic, part["x"], critic, error / n).items()}
        return made

    def _adam(self, gradients: Weights, rate: float) -> None:
        for net in "ac":
            size = math.sqrt(sum(float((g * g).sum()) for key, g in gradients.items() if key[0] == net))
            for key in [key for key in gradients if key[0] == net]:
                gradients[key] = gradients[key] * min(1.0, self._o.gradient_max / (size + 1e-9))
        self._updates += 1
        for key, g in gradients.items():
            m, v = self._moments[key]
            m += 0.1 * (g - m)
            v += 0.001 * (g * g - v)
            step = m / (1 - 0.9**self._updates) / (np.sqrt(v / (1 - 0.999**self._updates)) + 1e-8)
            self._trained[key] -= (rate * step).astype(np.float32)
        np.clip(self._log_std, -3.0, 0.5, out=self._log_std)


def _prior(seen: F32, acceleration_m_s2: float) -> F32:
    """Return the actions (N, 4) of a proportional-derivative law: towards the pad, and down within a cone over it."""
    made = np.zeros((len(seen), ACTIONS), np.float32)
    made[:, :2] = (0.8 * seen[:, :2] + 1.4 * seen[:, 3:5]) / acceleration_m_s2
    beside = np.hypot(seen[:, 0], seen[:, 1])
    made[:, 2] = np.clip(2.0 * (0.15 + 0.3 * seen[:, 2] - beside), 0.0, 1.0) * 0.7
    return np.clip(made, -1.0, 1.0)


def _network(rng: np.random.Generator, width: int, out: int, gain: float) -> Weights:
    """Return the first weights of two hidden layers: orthogonal, the last ones small."""
    made: Weights = {}
    for layer, (a, b, size) in enumerate(((OBSERVED, width, 1.4), (width, width, 1.4), (width, out, gain))):
        q, _ = np.linalg.qr(rng.standard_normal((max(a, b), min(a, b))))
        made[f"w{layer}"] = (size * (q if a >= b else q.T)).astype(np.float32)
        made[f"b{layer}"] = np.zeros(b, np.float32)
    return made


def _forward(net: Weights, x: F32) -> tuple[F32, F32, F32]:
    """Return both hidden layers and the output."""
    first = np.tanh(x @ net["w0"] + net["b0"])
    second = np.tanh(first @ net["w1"] + net["b1"])
    return first, second, second @ net["w2"] + net["b2"]


def _backward(net: Weights, x: F32, layers: tuple[F32, F32, F32], pull: F32) -> Weights:
    """Return the gradient of the weights for one (N, out) of the output."""
    first, second, _ = layers
    by_second = (pull @ net["w2"].T) * (1.0 - second * second)
    by_first = (by_second @ net["w1"].T) * (1.0 - first * first)
    return {
        "w2": second.T @ pull, "b2": pull.sum(axis=0), "w1": first.T @ by_second, "b1": by_second.sum(axis=0),
        "w0": x.T @ by_first, "b0": by_first.sum(axis=0),
    }  # fmt: skip
