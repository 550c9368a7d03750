"""A policy: a small neural network from what guidance knows to what it commands, and its file.

`decklander train` makes one in the training worlds (`sitl.gym`), the controller `policy` flies it, and both by numpy alone.
"""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.settings.load import SHIPPED
from companion.settings.plain_file import refuse_special, unzipped
from estimator.contracts.errors import BadInput, unusable

F32 = NDArray[np.float32]

OBSERVED, ACTIONS = 21, 4
"""Numbers of an observation and of an action."""
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
_BYTES_MAX, _UNPACKED_MAX = 1_000_000, 4_000_000


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
        try:
            with path.open("wb") as file:
                np.savez_compressed(file, record=record, **arrays)
        except OSError as why:
            raise unusable(str(path), why) from why


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
        refuse_special(path, f"{what}: {path}", _BYTES_MAX)
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
