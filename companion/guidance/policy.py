"""The controller `policy`: a small neural network that was trained in simulated worlds (`sitl.gym`), run by numpy.

It flies the horizontal part always, and descends where the mission has ordered a descent, no faster than ordered. Gate, limits and
heading stay those of the mission and of the PID controller.
"""

from __future__ import annotations

import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from companion.guidance.controller import Knowledge, Target
from companion.guidance.pid import Pid
from companion.guidance.pid_controller import PidController
from companion.settings.load import SHIPPED
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.errors import BadInput, unusable
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs, seconds_between

F32 = NDArray[np.float32]

FOLDER = "policies"
OBSERVED, ACTIONS = 21, 4
"""Numbers of an observation and of an action."""
TRIM_TIME_S = 2.0
"""Time constant of the trim, the mean of what the lean gives beyond the measured acceleration: wind, drag, the attitude's error."""
_LAYERS = 3
_BYTES_MAX = 16_000_000
_SCALES = ("acceleration_m_s2", "down_m_s")


class Policy:
    """A network of two hidden layers (tanh): observation to the mean of the action.

    Args:
        weights: `w0`, `b0`, `w1`, `b1`, `w2`, `b2`, float32; `mean` and `scale` (21,) of the observations.
        record: how it was trained; it holds the values of a full action, `acceleration_m_s2` and `down_m_s`.

    Raises:
        ValueError: an array is missing, of another shape, or not finite.
    """

    def __init__(self, weights: dict[str, F32], record: dict[str, Any]) -> None:
        width = OBSERVED
        for layer in range(_LAYERS):
            w, b = weights[f"w{layer}"], weights[f"b{layer}"]
            if w.ndim != 2 or w.shape[0] != width or b.shape != (w.shape[1],):
                raise ValueError(f"layer {layer} has the shapes {w.shape} and {b.shape} behind {width} numbers")
            width = w.shape[1]
        if width != ACTIONS or weights["mean"].shape != (OBSERVED,) or weights["scale"].shape != (OBSERVED,):
            raise ValueError(f"it does not take {OBSERVED} numbers to {ACTIONS}")
        if not all(np.isfinite(x).all() for x in weights.values()) or not (weights["scale"] > 0.0).all():
            raise ValueError("its numbers are not finite")
        if not all(isinstance(record.get(key), float) and 0.0 < record[key] < 100.0 for key in _SCALES):
            raise ValueError(f"its record lacks {' and '.join(_SCALES)}")
        self.weights, self.record = weights, record

    def act(self, observed: F32) -> F32:
        """Return the actions (N, 4), -1 to 1, for observations (N, 21)."""
        x = np.clip((observed - self.weights["mean"]) / self.weights["scale"], -10.0, 10.0)
        for layer in range(_LAYERS - 1):
            x = np.tanh(x @ self.weights[f"w{layer}"] + self.weights[f"b{layer}"])
        return np.clip(x @ self.weights["w2"] + self.weights["b2"], -1.0, 1.0)

    def write(self, path: Path) -> None:
        """Write it as an npz file.

        Raises:
            BadInput: the file cannot be written.
        """
        record = np.frombuffer(json.dumps(self.record).encode(), np.uint8)
        try:
            with path.open("wb") as file:
                np.savez(file, record=record, **self.weights)
        except OSError as why:
            raise unusable(str(path), why) from why


def read_policy(name_or_path: str) -> Policy:
    """Return a shipped policy by its bare name, or the one of a file.

    Raises:
        BadInput: there is no such file, or it holds no policy. One line.
    """
    shipped = SHIPPED / FOLDER / f"{name_or_path}.npz"
    path = shipped if name_or_path.isidentifier() and shipped.is_file() else Path(name_or_path)
    try:
        if path.stat().st_size > _BYTES_MAX:
            raise BadInput(f"{path}: too large for a policy")
        with np.load(path, allow_pickle=False) as arrays:
            weights = {key: np.asarray(arrays[key], np.float32) for key in arrays.files if key != "record"}
            record = json.loads(arrays["record"].tobytes())
        return Policy(weights, record)
    except OSError as why:
        raise unusable(str(path), why) from why
    except (ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile) as why:
        raise BadInput(f"{path}: not a policy ({why}); `decklander train` writes one") from why


class PolicyMemory(Struct, frozen=True, eq=False):
    """The controller's memory."""

    trim: tuple[float, float] = (0.0, 0.0)
    """The trim, m/s^2 forward and right."""
    action: tuple[float, ...] = (0.0,) * ACTIONS
    at: MonoNs | None = None
    plain: Pid = field(default_factory=Pid.start)
    """The memory of the PID controller, which keeps heights and the heading."""


class PolicyController:
    """The controller.

    Args:
        policy: the network.
        plain: the PID controller, which keeps heights and the heading, and flies where the estimator path knows no motion of the
            body.

    Raises:
        ValueError: the vehicle takes velocities over the ground and no tilt.
    """

    name = "policy"
    climb_max_m_s: None = None

    def __init__(self, policy: Policy, plain: PidController, *, over_ground: bool = False) -> None:
        if over_ground:
            raise ValueError("a policy commands tilt, and this vehicle takes velocities")
        self._policy, self._plain = policy, plain
        self._full_m_s2, self._down_m_s = (float(policy.record[key]) for key in _SCALES)

    def start(self) -> PolicyMemory:
        """Return the memory before the first cycle."""
        return PolicyMemory()

    def step(self, memory: PolicyMemory, now: MonoNs, knowledge: Knowledge, target: Target | None) -> tuple[PolicyMemory, Command]:
        """Run one guidance cycle; `Hover` without a target or an estimate."""
        relative, body, deck = knowledge.relative, knowledge.body, knowledge.deck
        plain, kept = self._plain.step(memory.plain, now, knowledge, target)
        memory = replace(memory, plain=plain)
        if body is not None:
            keep = 0.0 if memory.at is None else math.exp(-min(1.0, max(0.0, seconds_between(memory.at, now))) / TRIM_TIME_S)
            beyond = (lean - a for lean, a in zip(body.lean_m_s2, body.a_level.tolist(), strict=False))
            trim = tuple(keep * old + (1.0 - keep) * new for old, new in zip(memory.trim, beyond, strict=True))
            memory = replace(memory, trim=trim, at=now)
        if target is None or relative is None or body is None or deck is None or not isinstance(kept, Velocity):
            return memory, kept if target is not None else Hover()
        place = relative.d_body_pad_level - np.array([*target.d_body_pad_level[:2], 0.0])
        observed = observation(memory, place, relative, body, deck, now)
        action = self._policy.act(observed[None])[0].astype(float)
        a = self._full_m_s2 * action[:2]
        size, most = math.hypot(*a), math.inf if target.lean_max_rad is None else 9.8 * math.tan(target.lean_max_rad)
        a = a if size <= most else a * (most / size)
        down = float(kept.v_level[2])
        rate = target.descent_rate_m_s
        if rate is not None and rate > 0.0:
            down = float(deck.v_level[2]) + min(max(self._down_m_s * float(action[2]), -rate), rate)
        v_level = np.array([*(deck.v_level - relative.v_pad_level)[:2], down])
        memory = replace(memory, action=tuple(action.tolist()))
        return memory, Lean(a, np.array(memory.trim), v_level, kept.yaw_rate_rad_s)


def observation(
    memory: PolicyMemory, place: F64, relative: RelativeState, body: BodyMotion, deck: DeckMotion, now: MonoNs
) -> F32:
    """Return the observation (21,), in the order of `view_number` in sitl/core/decklander_sim.h.

    Args:
        place: the wanted place from the body, (3,) m in `level`.
    """
    yaw = relative.yaw_rad or 0.0
    s, c = math.sin(yaw), math.cos(yaw)
    # The deck's normal along and across the body's heading, from its tilt along and across the arrow.
    along, across = math.sin(deck.pitch_rad), -math.sin(deck.roll_rad)
    tilt = (-(c * across - s * along), c * along + s * across)
    numbers = (
        *place, *relative.v_pad_level, *body.lean_m_s2, *memory.trim, deck.v_level[2], deck.a_level[2], *tilt, s, c,
        *memory.action, min(5.0, relative.age_s(now)),
    )  # fmt: skip
    return np.array(numbers, np.float32)
