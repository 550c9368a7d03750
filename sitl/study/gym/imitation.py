"""Train a policy by imitation in the training worlds: a teacher that knows the truth, a student that sees the estimate.

The student flies, more and more by itself, and learns what the teacher would do where the student goes.
Sources: Ross, Gordon & Bagnell, A reduction of imitation learning and structured prediction to no-regret online learning,
AISTATS 2011 (DAgger, algorithm 3.1); Chen et al., Learning by cheating, CoRL 2019 (a teacher with the truth). Adam: Kingma & Ba,
ICLR 2015.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.guidance.law.gains import TiltGains, TiltWeights, tilt_gains
from companion.guidance.law.policy import ACTIONS, ARRAYS, F32, OBSERVED, STEP_S, Policy, forward, normal
from companion.settings.guidance import Response
from estimator.contracts.motion import G_M_S2
from sitl.study.gym.training import DOWN_MAX_M_S, ENDS, YAW_RATE_MAX_RAD_S, TrainingOptions, TrainingWorlds

Weights = dict[str, F32]
F64 = NDArray[np.float64]

_FLYING, _LANDED = (ENDS.index(name) for name in ("goes_on", "landed"))


AS_HANDED_OVER = TrainingOptions(start_low=(-2.5, -2.5, 0.4, -math.pi), start_high=(2.5, 2.5, 8.0, math.pi))
"""Episodes that begin wider and higher than the environment's own, as a mission hands over the vehicle."""


_WEIGHTS = TiltWeights(p_m=0.015, w_m_s=4.1, u_m_s2=0.3)
"""Weights of the teacher's regulator: softer than the law's, as an estimate is not the truth."""
_SPEED_MAX_M_S, _DOWN_M_S = 1.5, 0.4
"""The teacher's largest speed towards the pad, and its speed down against the deck, over the pad."""
_CONE_M, _CONE_SLOPE = 0.12, 0.2
"""Distance beside the pad at which it still goes down near the deck, and the increase with each metre of height."""
_YAW_GAIN_1_S, _PUSH_S = 0.8, 0.1
"""Gain of its heading, and time constant of the push of the air that it reckons with."""


class Teacher:
    """The tilt law's regulator on the true state of every world, with the true push of the air and the deck's acceleration.

    Args:
        worlds: what it flies.
        response: how the vehicle answers.

    Raises:
        ValueError: there are no gains for such a vehicle.
    """

    def __init__(self, worlds: TrainingWorlds, response: Response) -> None:
        self._worlds, self._response = worlds, response
        self._gains: TiltGains = tilt_gains(response.tilt, _WEIGHTS, STEP_S)
        n = worlds.count
        self._under_way = np.zeros((n, len(self._gains.under_way), 2))
        self._lag, self._push, self._lean, self._deck_v = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 3))
        self._begun = np.ones(n, bool)

    def actions(self) -> F32:
        """Return the actions (N, 4) for the worlds as they are; call it once before each step, and `flown` after it."""
        w, g = self._worlds.truth, self._gains
        vehicle, deck = w["vehicle"], w["deck"]
        p, v = deck["p"] - vehicle["p"], deck["v"] - vehicle["v"]
        R = vehicle["R"].reshape(-1, 3, 3)
        heading = np.arctan2(R[:, 1, 0], R[:, 0, 0])
        lean = np.stack([-R[:, 0, 2], -R[:, 1, 2]], axis=1) * (G_M_S2 / R[:, 2, 2])[:, None]
        fresh = self._begun
        a_deck = np.where(fresh[:, None], 0.0, (deck["v"] - self._deck_v) / STEP_S)
        rate = np.where(fresh[:, None], 0.0, (lean - self._lean) / STEP_S)
        keep = math.exp(-STEP_S / _PUSH_S)
        push = np.where(fresh[:, None], 0.0, keep * self._push + (1.0 - keep) * (vehicle["a"][:, :2] - lean))
        self._push, self._lean, self._deck_v = push, lean, deck["v"].copy()
        reference = a_deck[:, :2] - push
        # A place far away asks for no more than the largest speed.
        far = p[:, :2]
        reach = _SPEED_MAX_M_S * g.w / g.p
        far = far * np.minimum(1.0, reach / np.maximum(1e-9, np.hypot(*far.T)))[:, None]
        wanted = g.p * far + g.w * v[:, :2] + g.a * (lean - reference) + g.rate * rate + g.lag * (self._lag - reference)
        for k, gain in enumerate(g.under_way):
            wanted += gain * (self._under_way[:, k] - reference)
        tilt = reference - wanted
        c, s = np.cos(heading), np.sin(heading)
        level = np.stack([c * tilt[:, 0] + s * tilt[:, 1], c * tilt[:, 1] - s * tilt[:, 0]], axis=1)
        made = np.zeros((len(p), ACTIONS))
        made[:, :2] = (level - w["trim"]) / self._worlds.acceleration_m_s2
        beside, height = np.hypot(*p[:, :2].T), p[:, 2]
        down = np.clip(_DOWN_M_S * 3.0 * (1.0 - beside / (_CONE_M + _CONE_SLOPE * np.maximum(0.0, height))), 0.0, _DOWN_M_S)
        made[:, 2] = (down + self._response.climb.lag_s * a_deck[:, 2]) / DOWN_MAX_M_S
        Rd = deck["R"].reshape(-1, 3, 3)
        yaw = np.angle(np.exp(1j * (heading - np.arctan2(Rd[:, 1, 0], Rd[:, 0, 0]))))
        made[:, 3] = -_YAW_GAIN_1_S * yaw / YAW_RATE_MAX_RAD_S
        self._heading = heading
        return np.clip(made, -1.0, 1.0).astype(np.float32)

    def flown(self, actions: F32, trim: F64) -> None:
        """Take note of the actions that were flown, with the trim that was on them."""
        tilt = self._worlds.acceleration_m_s2 * np.clip(actions[:, :2], -1.0, 1.0) + trim
        c, s = np.cos(self._heading), np.sin(self._heading)
        flown = np.stack([c * tilt[:, 0] - s * tilt[:, 1], s * tilt[:, 0] + c * tilt[:, 1]], axis=1)
        lag_s = self._response.tilt.lag_s
        if lag_s > 1e-4:
            keep = math.exp(-STEP_S / lag_s)
            self._lag = keep * self._lag + (1.0 - keep) * self._under_way[:, -1]
        self._under_way = np.concatenate([flown[:, None], self._under_way[:, :-1]], axis=1)
        self._begun = self._worlds.ends != _FLYING
        self._under_way[self._begun], self._lag[self._begun] = 0.0, 0.0


class EpisodesFlown(NamedTuple):
    """Episodes that ended: how many, the share that landed, and the median distance of those from the centre."""

    episodes: int
    landed: float
    distance_m: float


def tally(ends: list[NDArray[np.int8]], touchdowns: list[F32]) -> EpisodesFlown:
    """Return what came of the episodes that ended with any of some steps."""
    over = np.concatenate(ends)
    distances = np.concatenate(touchdowns)[over == _LANDED, 0]
    count = int((over != _FLYING).sum())
    landed = int((over == _LANDED).sum())
    return EpisodesFlown(count, landed / max(1, count), float(np.median(distances)) if landed else math.nan)


def fly_policy(policy: Policy, worlds: TrainingWorlds, seed: int) -> EpisodesFlown:
    """Fly the first episode of every world by a policy, from a seed on, and return what came of them."""
    seen = worlds.begin(range(seed, seed + worlds.count))
    ends, touchdowns = np.zeros(worlds.count, np.int8), np.full((worlds.count, 3), np.nan, np.float32)
    while (flying := ends == _FLYING).any():
        worlds.step(policy.act(seen))
        seen = worlds.views
        ends[flying], touchdowns[flying] = worlds.ends[flying], worlds.touchdowns[flying]
    return tally([ends], [touchdowns])


class ImitationOptions(Struct, frozen=True, kw_only=True):
    """The numbers of the training."""

    rounds: int = 60
    steps: int = 200
    """Steps of each world in a round."""
    teacher_rounds: int = 3
    """Rounds over which the teacher's share of the flying goes from 1 to 0."""
    batches: int = 600
    """Steps of the optimizer after each round."""
    batch: int = 1024
    width: int = 64
    learning_rate: float = 2e-3
    explore: float = 0.15
    """Standard deviation of what is added to the actions, in half of the worlds."""
    kept_most: int = 1_500_000
    """Examples that are kept; the oldest are forgotten."""
    settle_steps: int = 100
    """The first steps of an episode teach nothing: its trim begins at zero, and a mission's has long settled."""
    near_m: float = 0.4
    """Examples weigh 1 at the deck, and half at this height."""


class RoundProgress(NamedTuple):
    """A round: its number, examples so far, what came of the student's flights, and the root mean square of its error."""

    round: int
    examples: int
    flown: EpisodesFlown
    error: float


class Imitation:
    """A student in training.

    Args:
        worlds: where it flies, of one vehicle. It learns to expect their winds, so that several are better than one.
        response: how the vehicle answers, for the teacher.
        seed: of weights and exploration.
        first: the policy that training goes on from; None begins anew.
    """

    def __init__(
        self,
        worlds: Sequence[TrainingWorlds],
        response: Response,
        seed: int,
        first: Policy | None = None,
        *,
        options: ImitationOptions | None = None,
    ) -> None:
        self._worlds, self._o = worlds, options or ImitationOptions()
        self._teachers = [Teacher(one, response) for one in worlds]
        self._rng = rng = np.random.default_rng([seed, 0x1A17])
        self._first = first is not None
        self.weights: Weights = _network(rng, self._o.width) if first is None else {k: first.weights[k].copy() for k in ARRAYS}
        self._trained = [name for name in ARRAYS if name not in ("mean", "scale")]
        self._moments = {name: (np.zeros_like(self.weights[name]), np.zeros_like(self.weights[name])) for name in self._trained}
        self._updates = 0
        self._seen: list[F32] = []
        self._wanted: list[F32] = []
        self._gathered = 0

    def rounds(self, seed: int, done: Callable[[], float]) -> Iterator[RoundProgress]:
        """Train until all is done, and yield after each round.

        Args:
            seed: of the first world; the others count on from it.
            done: returns how much of the training is done; it ends at 1.
        """
        o, number = self._o, 0
        for w in self._worlds:
            w.begin(range(seed, seed + w.count))
            seed += w.count
        while (share := done()) < 1.0:
            by_teacher = 0.0 if self._first else max(0.0, 1.0 - number / o.teacher_rounds)
            ends: list[NDArray[np.int8]] = []
            touchdowns: list[F32] = []
            for w, teacher in zip(self._worlds, self._teachers, strict=True):
                self._gather(w, teacher, by_teacher, ends, touchdowns)
            flown = tally(ends, touchdowns)
            while sum(map(len, self._seen)) > o.kept_most:
                del self._seen[: o.steps], self._wanted[: o.steps]
            if number == 0 and not self._first:
                self._begin()
            number += 1
            yield RoundProgress(number, self._gathered, flown, self._fit(o.learning_rate * max(0.02, 1.0 - share)))

    def policy(self, record: dict[str, Any]) -> Policy:
        """Return the policy as it is now, with its record."""
        first = self._worlds[0]
        starts = np.abs([*first.options.start_low[:2], *first.options.start_high[:2]])
        full = {"acceleration_m_s2": first.acceleration_m_s2, "place_m": float(starts.max())}
        return Policy({name: self.weights[name].copy() for name in ARRAYS}, {**record, **full})

    def _gather(
        self, w: TrainingWorlds, teacher: Teacher, share: float, ends: list[NDArray[np.int8]], touchdowns: list[F32]
    ) -> None:
        """Fly a round in some worlds and keep what was seen, what the teacher would have done, and what came of it.

        Args:
            share: of the worlds, that the teacher flies itself.
        """
        o, rng = self._o, self._rng
        by_teacher = rng.uniform(size=(w.count, 1)) < share
        loud = (np.arange(w.count) % 2 == 0)[:, None]
        wander = np.zeros((w.count, ACTIONS), np.float32)
        for _ in range(o.steps):
            seen, taught = w.views.copy(), teacher.actions()
            settled = w.truth["steps"] >= o.settle_steps
            self._seen.append(seen[settled])
            self._wanted.append(taught[settled])
            own = forward(self.weights, normal(self.weights, seen))[-1]
            wander = 0.9 * wander + 0.436 * rng.standard_normal(wander.shape, np.float32)
            action = np.clip(np.where(by_teacher, taught, own) + o.explore * wander * loud, -1.0, 1.0)
            trim = w.truth["trim"].copy()
            w.step(action)
            teacher.flown(action, trim)
            quiet = ~loud[:, 0] & ~by_teacher[:, 0]
            ends.append(np.where(quiet, w.ends, 0).astype(np.int8))
            touchdowns.append(w.touchdowns.copy())
        self._gathered += o.steps * w.count

    def _begin(self) -> None:
        """Take mean and scale of the observations, and the linear part by least squares."""
        seen, wanted = np.concatenate(self._seen), np.concatenate(self._wanted)
        self.weights["mean"], self.weights["scale"] = seen.mean(axis=0), seen.std(axis=0).clip(1e-2)
        x = normal(self.weights, seen).astype(float)
        inside = (np.abs(wanted[:, :2]) < 1.0).all(axis=1)
        x, wanted = x[inside], wanted[inside]
        self.weights["linear"][:] = np.linalg.solve(
            x.T @ x + len(x) * 1e-3 * np.eye(OBSERVED), x.T @ (wanted - wanted.mean(axis=0))
        )

    def _fit(self, rate: float) -> float:
        """Fit the network to what is kept; return the error."""
        o = self._o
        seen, wanted = np.concatenate(self._seen), np.concatenate(self._wanted)
        error = 0.0
        for _ in range(o.batches):
            rows = self._rng.integers(len(seen), size=o.batch)
            x, y = normal(self.weights, seen[rows]), wanted[rows]
            weight = (1.0 / (1.0 + np.maximum(0.0, seen[rows, 2]) / o.near_m))[:, None]
            layers = forward(self.weights, x)
            # What lies beyond the stick's end on the teacher's side is as good as the end.
            beyond = (np.abs(y) >= 1.0) & (layers[-1] * y > 1.0)
            miss = np.where(beyond, 0.0, layers[-1] - y)
            error += float((weight * miss[:, :2] ** 2).sum() / (2.0 * weight.sum()))
            self._adam(_backward(self.weights, x, layers, (weight * miss / weight.sum()).astype(np.float32)), rate)
        return math.sqrt(error / o.batches)

    def _adam(self, gradients: Weights, rate: float) -> None:
        self._updates += 1
        for name, g in gradients.items():
            m, v = self._moments[name]
            m += 0.1 * (g - m)
            v += 0.001 * (g * g - v)
            step = m / (1.0 - 0.9**self._updates) / (np.sqrt(v / (1.0 - 0.999**self._updates)) + 1e-8)
            self.weights[name] -= (rate * step).astype(np.float32)


def _network(rng: np.random.Generator, width: int) -> Weights:
    """Return the first weights: orthogonal hidden layers, and an output of nothing."""
    made: Weights = {"linear": np.zeros((OBSERVED, ACTIONS), np.float32)}
    for layer, (a, b, size) in enumerate(((OBSERVED, width, 1.0), (width, width, 1.0), (width, ACTIONS, 0.01))):
        q, _ = np.linalg.qr(rng.standard_normal((max(a, b), min(a, b))))
        made[f"w{layer}"] = (size * (q if a >= b else q.T)).astype(np.float32)
        made[f"b{layer}"] = np.zeros(b, np.float32)
    return made | {"mean": np.zeros(OBSERVED, np.float32), "scale": np.ones(OBSERVED, np.float32)}


def _backward(net: Weights, x: F32, layers: tuple[F32, F32, F32], pull: F32) -> Weights:
    """Return the gradient of the weights for one (N, 4) of the output."""
    first, second, _ = layers
    by_second = (pull @ net["w2"].T) * (1.0 - second * second)
    by_first = (by_second @ net["w1"].T) * (1.0 - first * first)
    return {
        "w2": second.T @ pull, "b2": pull.sum(axis=0), "w1": first.T @ by_second, "b1": by_second.sum(axis=0),
        "w0": x.T @ by_first, "b0": by_first.sum(axis=0), "linear": x.T @ pull,
    }  # fmt: skip
