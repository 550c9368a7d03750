"""The controller `policy`: a small trained network leans the vehicle, and the law does the rest.

`decklander train` makes the network's file in training worlds (`sitl.study.gym`), the controller flies it, both by numpy alone.
The mission orders each descent, so heights, climbs and heading stay the law's, and so does all where the estimator path knows no
motion of body or deck. The network's lean is cut as the law's is: by the view, by the vehicle's tilt, and by the target.
"""

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

from companion.guidance.controller import FieldOfView, Knowledge, Target
from companion.guidance.law.controllers import ControllerSetup, make_follow_deck
from companion.guidance.law.follow_deck import FollowDeck, FollowDeckMemory
from companion.settings.files import unzipped
from companion.settings.load import whole
from decklander.place import SHIPPED
from drivers.files import Largest, refuse_special
from estimator.contracts.commands import Command, Lean
from estimator.contracts.errors import BadInput, file_errors, unusable
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2, BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs, seconds_between

F32 = NDArray[np.float32]

OBSERVED = 21
"""Numbers of an observation."""
ACTIONS = 4
"""Numbers of an action."""
PLACE, VELOCITY, LEAN, TRIM = slice(0, 2), slice(3, 5), slice(6, 8), slice(8, 10)
"""The horizontal parts of an observation, in the order of `view_number` in sitl/core/decklander_sim.h."""
ARRAYS = ("w0", "b0", "w1", "b1", "w2", "b2", "linear", "mean", "scale")
FOLDER = "policies"
TRIM_TIME_S = 0.5
"""Time constant of the trim: what the lean gives beyond the measured acceleration, by wind, drag and the attitude's error."""
STEP_S = 0.02
"""Seconds from one command to the next; a policy knows its last command and no time."""
_FAR = 10.0
"""A network sees no number farther from its mean than so many standard deviations."""
_FULL = ("acceleration_m_s2", "place_m")
_UNPACKED_MAX = 4_000_000  # largest size of a policy's file when unpacked, bytes
_OTHER = 0.3
"""A vehicle whose delay or frequency differs by this share from those of the training is another one."""
_AGE_MAX_S = 5.0  # age of the estimate that is observed at most
_VIEW_FROM_M = 0.6  # height from which on the pad is kept in view, as in the law (`keep_in_view` in estimator/core/law/law.c)
_LEAN_LEAST_M_S2 = 0.6  # lean that it always has, as in the law
_OUT_RAD = 0.1  # angle outside the view from which on the pad is lost anyway, as in the law
_ANGLE_MOST_RAD = 1.2  # largest angle of a lean that keeps it in view, as in the law


class Policy:
    """A network of two hidden layers (tanh) beside a linear part: from an observation to an action.

    Args:
        weights: float32 by the names of `ARRAYS`: layers `w0` to `b2`, `linear` (21, 4), observations' `mean` and `scale` (21,).
        record: how it was trained. It holds the acceleration of a full action, `acceleration_m_s2`, and how far beside the pad it
            was trained, `place_m`.

    Raises:
        ValueError: an array is missing, of another shape, or not finite, or the record lacks a value.
    """

    def __init__(self, weights: dict[str, F32], record: dict[str, Any]) -> None:
        if missing := set(ARRAYS) - set(weights):
            raise ValueError(f"it lacks {', '.join(sorted(missing))}")
        width = OBSERVED
        for layer in range(3):
            w, b = weights[f"w{layer}"], weights[f"b{layer}"]
            if w.ndim != 2 or w.shape[0] != width or b.shape != (w.shape[1],):
                raise ValueError(f"layer {layer} has the shapes {w.shape} and {b.shape} behind {width} numbers")
            width = w.shape[1]
        shapes = {"linear": (OBSERVED, ACTIONS), "mean": (OBSERVED,), "scale": (OBSERVED,)}
        if width != ACTIONS or any(weights[name].shape != shape for name, shape in shapes.items()):
            raise ValueError(f"it does not take {OBSERVED} numbers to {ACTIONS}")
        if not all(np.isfinite(weights[name]).all() for name in ARRAYS) or not (weights["scale"] > 0.0).all():
            raise ValueError("its numbers are not finite")
        if not all(isinstance(record.get(key), float) and 0.0 < record[key] < 100.0 for key in _FULL):
            raise ValueError(f"its record lacks {', '.join(_FULL)}")
        self.weights, self.record = weights, record

    def act(self, observed: F32) -> F32:
        """Return the actions (N, 4), -1 to 1, for observations (N, 21)."""
        return np.clip(forward(self.weights, normal(self.weights, observed))[-1], -1.0, 1.0)

    def write(self, path: Path) -> None:
        """Write it as an npz file.

        Raises:
            BadInput: the file cannot be written.
        """
        record = np.frombuffer(json.dumps(self.record).encode(), np.uint8)
        arrays: dict[str, Any] = {name: self.weights[name] for name in ARRAYS}
        with file_errors(str(path)), whole(path) as beside, beside.open("wb") as file:
            np.savez_compressed(file, record=record, **arrays)


def normal(weights: dict[str, F32], observed: F32) -> F32:
    """Return the observations (N, 21) as the network sees them: by their mean and scale, and cut off where they are far away."""
    x: F32 = np.clip((observed - weights["mean"]) / weights["scale"], -_FAR, _FAR).astype(np.float32)
    return x


def forward(weights: dict[str, F32], x: F32) -> tuple[F32, F32, F32]:
    """Return both hidden layers (N, width) and the output (N, 4), not cut off yet."""
    first = np.tanh(x @ weights["w0"] + weights["b0"])
    second = np.tanh(first @ weights["w1"] + weights["b1"])
    return first, second, second @ weights["w2"] + weights["b2"] + x @ weights["linear"]


def shipped_policy(response: str) -> str:
    """Return the file of the policy that ships for vehicles of a shipped response.

    Raises:
        BadInput: there is none.
    """
    path = SHIPPED / FOLDER / f"{response}.npz"
    if not response.isidentifier() or not path.is_file():
        raise BadInput(
            f'guidance.controller = "policy": no policy ships for the response {response!r}; decklander train makes one, '
            "and guidance.policy_file names it"
        )
    return str(path)


def read_policy(file: str | Path, what: str) -> Policy:
    """Return the policy of a file.

    Args:
        what: the setting or option that names it, for errors.

    Raises:
        BadInput: there is no such file, or it holds no policy. One line.
    """
    path = Path(file)
    try:
        refuse_special(path, Largest.NETWORK, f"{what}: {path}")
        arrays = {name.removesuffix(".npy"): _array(data) for name, data in unzipped(path, _UNPACKED_MAX).items()}
        record = json.loads(arrays.pop("record").tobytes())
        return Policy({name: np.asarray(array, np.float32) for name, array in arrays.items()}, record)
    except OSError as why:
        raise unusable(f"{what}: {path}", why) from why
    except (ValueError, KeyError, TypeError, AttributeError) as why:
        raise BadInput(f"{what}: {path}: not a policy ({why}); decklander train writes one") from why


def _array(data: bytes) -> NDArray[Any]:
    """Return the array of a file as numpy writes it; it takes no memory beside `data`, whatever shape it announces.

    Raises:
        ValueError: it is none, or does not hold what it announces.
    """
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version not in _HEADERS:
        raise ValueError(f"an array of version {version}")
    shape, by_columns, dtype = _HEADERS[version](stream)
    if dtype.hasobject:
        raise ValueError("an array of objects")
    return np.frombuffer(data, dtype, offset=stream.tell()).reshape(shape, order="F" if by_columns else "C")


_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def kept_share(seconds: float) -> float:
    """Return the share of the trim that is kept over so many seconds."""
    return math.exp(-min(1.0, max(0.0, seconds)) / TRIM_TIME_S)


class PolicyMemory(Struct, frozen=True, eq=False):
    """The controller's memory."""

    law: FollowDeckMemory
    trim: tuple[float, float] = (0.0, 0.0)
    """The trim, m/s^2 forward and right."""
    action: tuple[float, ...] = (0.0,) * ACTIONS
    at: MonoNs | None = None


class PolicyController:
    """The controller.

    Args:
        policy: the network.
        law: keeps heights and heading.
        view: the camera's field of view; None for no limit by it.
        over_ground: whether the vehicle takes velocities over the ground.

    Raises:
        ValueError: the vehicle takes velocities and no tilt, it answers otherwise than the one of the training, or the guidance
            period is not the one of the training.
    """

    name = "policy"

    def __init__(self, policy: Policy, law: FollowDeck, view: FieldOfView | None = None, *, over_ground: bool = False) -> None:
        if over_ground:
            raise ValueError("a policy commands tilt, and this vehicle takes velocities")
        if abs(law.period_s - STEP_S) > 1e-3:
            raise ValueError(f"a policy needs guidance.rate_hz = {1.0 / STEP_S:g}")
        tilt, trained = law.response.tilt, policy.record.get("response", {})
        for key, flown in (("delay_s", tilt.delay_s), ("frequency_rad_s", tilt.frequency_rad_s)):
            if abs(flown - float(trained.get(key, flown))) > _OTHER * flown + 0.01:
                raise ValueError(f"the policy was trained for another vehicle: {key} = {trained[key]:g}, and here {flown:g}")
        self._policy, self._law, self._view = policy, law, view
        self._full_m_s2, self._place_m = policy.record["acceleration_m_s2"], policy.record["place_m"]

    @property
    def climb_max_m_s(self) -> float:
        """The fastest climb that it asks for, m/s."""
        return self._law.climb_max_m_s

    def start(self) -> PolicyMemory:
        """Return the memory before the first cycle."""
        return PolicyMemory(self._law.start())

    def ahead(self, memory: PolicyMemory, knowledge: Knowledge, seconds: float) -> None:
        """Return None: a network does not say where it leads."""

    def step(
        self, memory: PolicyMemory, now: MonoNs, knowledge: Knowledge, target: Target | None
    ) -> tuple[PolicyMemory, Command]:
        """Run one guidance cycle; `Hover` without a target or an estimate."""
        relative, body, deck = knowledge.relative, knowledge.body, knowledge.deck
        law, kept = self._law.step(memory.law, now, knowledge, target)
        memory = structs.replace(memory, law=law)
        if body is not None:
            keep = 0.0 if memory.at is None else kept_share(seconds_between(memory.at, now))
            beyond = (lean - a for lean, a in zip(body.lean_m_s2, body.a_level.tolist(), strict=False))
            trim = [keep * old + (1.0 - keep) * new for old, new in zip(memory.trim, beyond, strict=True)]
            memory = structs.replace(memory, trim=(trim[0], trim[1]), at=now)
        if target is None or relative is None or body is None or deck is None or not isinstance(kept, Lean):
            return memory, kept
        place = relative.d_body_pad_level - np.array([*target.d_body_pad_level[:2], 0.0])
        # It flies from farther away than it was trained for as from the edge of what it knows.
        place[:2] *= min(1.0, self._place_m / max(1e-9, math.hypot(*place[:2])))
        action = self._policy.act(observation(memory, place, relative, body, deck, now)[None])[0].astype(float)
        trim_level = np.array(memory.trim)
        lean = self._in_view(relative.d_body_pad_level, trim_level, self._full_m_s2 * action[:2] + trim_level)
        tilt_max_rad = math.radians(self._law.tilt_max_deg(knowledge))
        if target.lean_max_rad is not None:
            tilt_max_rad = min(tilt_max_rad, target.lean_max_rad)
        lean = _shortened(lean, trim_level, G_M_S2 * math.tan(tilt_max_rad))
        memory = structs.replace(memory, action=tuple(action.tolist()))
        return memory, Lean(lean - trim_level, trim_level, kept.v_level, kept.yaw_rate_rad_s)

    def _in_view(self, d: F64, trim: F64, lean: F64) -> F64:
        """Return the lean with which the pad's centre stays in the picture."""
        if self._view is None or d[2] < _VIEW_FROM_M:
            return lean
        out = lean.copy()
        for i, (offset_m, half_rad) in enumerate(
            ((self._view.forward_m, self._view.half_forward_rad), (self._view.right_m, self._view.half_right_rad))
        ):
            bearing = math.atan2(float(d[i]) - offset_m, float(d[2]))
            if abs(bearing) > half_rad + _OUT_RAD:
                continue
            most = G_M_S2 * math.tan(max(0.0, min(_ANGLE_MOST_RAD, half_rad - bearing)))
            least = -G_M_S2 * math.tan(max(0.0, min(_ANGLE_MOST_RAD, half_rad + bearing)))
            out[i] = min(max(most, trim[i] + _LEAN_LEAST_M_S2), max(min(least, trim[i] - _LEAN_LEAST_M_S2), lean[i]))
        return out


def make_policy(setup: ControllerSetup) -> PolicyController:
    """Return the controller that the settings' network flies, or the shipped one of the vehicle's response."""
    o = setup.guidance
    shipped = "ardrone2" if o.follow_deck.response_by_vehicle else o.follow_deck.response
    policy = read_policy(o.policy_file or shipped_policy(shipped), "guidance.policy_file")
    view = setup.view if o.follow_deck.keep_in_view else None
    return PolicyController(policy, make_follow_deck(setup), view, over_ground=setup.over_ground)


def _shortened(lean: F64, trim: F64, most: float) -> F64:
    """Return the lean within the largest one; the trim against the wind comes first."""
    if math.hypot(*lean) <= most:
        return lean
    held = math.hypot(*trim)
    base = trim * (most / held if held > most else 1.0)
    more = lean - base
    a, b, c = float(more @ more), float(base @ more), max(0.0, most * most - float(base @ base))
    share = min(1.0, max(0.0, (math.sqrt(b * b + a * c) - b) / a)) if a > 0.0 else 0.0
    return np.asarray(base + share * more)


def observation(
    memory: PolicyMemory, place: F64, relative: RelativeState, body: BodyMotion, deck: DeckMotion, now: MonoNs
) -> F32:
    """Return the observation (21,), in the order of `view_number` in sitl/core/decklander_sim.h.

    Args:
        place: the pad, or another wanted place, from the body, (3,) m in `level`.
    """
    yaw = relative.yaw_rad or 0.0
    s, c = math.sin(yaw), math.cos(yaw)
    # The deck's normal along and across the body's heading, from its tilt along and across the arrow.
    along, across = math.sin(deck.pitch_rad), -math.sin(deck.roll_rad)
    tilt = (s * along - c * across, c * along + s * across)
    numbers = (
        *place, *relative.v_pad_level, *body.lean_m_s2, *memory.trim, deck.v_level[2], deck.a_level[2], *tilt, s, c,
        *memory.action, min(_AGE_MAX_S, relative.age_s(now)),
    )  # fmt: skip
    return np.array(numbers, np.float32)
