"""Train the learned verification: `python -m benches.train_verifier FOLDER --out FILE.onnx [--epochs N] [--seed S]`.

FOLDER holds what `python -m benches.verifier_examples` rendered; every eighth chunk of it is held out. The network is a small
convolutional one that says by how much more likely a patch shows the pad than not (log-odds). Each step turns and mirrors frame
and drawing together, exchanges their channels, adds noise and covers a part, and the pad stays the same pad. Needs the
distributions of `requirements/benches.txt`, on a CPU; the same examples, seed and machine give the same file.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from estimator.vision.learned.second_opinion import CHANNELS, SIDE, Patch, inputs  # noqa: E402

Weights = dict[str, Any]
_LAYERS = ((CHANNELS, 16, 3, 2), (16, 32, 3, 2), (32, 32, 3, 1), (32, 48, 3, 2), (48, 48, 3, 1))
"""Channels in and out, side and stride of each convolution."""
_HIDDEN = 32
_BATCH = 128
_RATE, _DECAY = 2e-3, 1e-4
_STEP = 1.0 / 31.0
"""Step of the stored inputs: four standard deviations fit into a signed byte."""
_SEARCHED_WEIGHT = 2.0
"""Weight of an example that a search proposed over one made from the true pose."""
_HELD_OUT = 8


def load(folder: Path) -> tuple[NDArray[np.int8], NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], dict[str, Any]]:
    """Return bytes (n, 8, SIDE, SIDE) and pixel sizes (n,) of the inputs, labels (n,), which are held out (n,), and the rest."""
    parts, pixel, right, held = [], [], [], []
    rest: dict[str, list[Any]] = {"kind": [], "confidence": [], "target": []}
    for path in sorted(folder.glob("chunk_*.npz")):
        data = np.load(path)
        seen = np.unpackbits(data["seen"], axis=1).astype(bool).reshape(-1, SIDE, SIDE)
        for i in range(len(seen)):
            of = inputs(Patch(data["frame"][i], seen[i], data["drawn"][i], float(data["pixel"][i])))
            parts.append(np.rint(of[[0, 1, 2, 3, 4, 5, 9, 10]] / _STEP).astype(np.int8))
            pixel.append(of[11, 0, 0])
        right.append(data["right"])
        held.append(np.full(len(seen), int(path.stem.rpartition("_")[2]) % _HELD_OUT == 0))
        for name, values in rest.items():
            values.append(data[name])
    flat = {name: np.concatenate(values) for name, values in rest.items()}
    return np.array(parts), np.array(pixel), np.concatenate(right).astype(np.float32), np.concatenate(held), flat


def whole(stored: Any, pixel: Any) -> Any:
    """Return the network's input (n, CHANNELS, SIDE, SIDE) from its stored part."""
    x = stored.astype(jnp.float32) * _STEP
    size = jnp.broadcast_to(pixel[:, None, None, None], (len(pixel), 1, SIDE, SIDE))
    return jnp.concatenate([x[:, :6], x[:, 0:3] * x[:, 3:6], x[:, 6:], size], axis=1)


def varied(key: Any, x: Any) -> Any:
    """Return inputs that show the same in another way."""
    flip, turn, swap, noise, cover = jax.random.split(key, 5)
    x = jax.lax.cond(jax.random.bernoulli(flip), lambda a: a[:, :, ::-1], lambda a: a, x)
    x = jax.lax.cond(jax.random.bernoulli(turn), lambda a: a.transpose(0, 1, 3, 2), lambda a: a, x)
    order = jax.random.permutation(swap, 3)
    frame, drawn = x[:, :3][:, order], x[:, 3:6][:, order]
    spread = 0.25 * jax.random.uniform(noise, (len(x), 1, 1, 1)) ** 2
    frame = frame + spread * jax.random.normal(noise, frame.shape)
    # A straight cover over a part of every fifth patch.
    a, b, c, often = jax.random.uniform(cover, (4, len(x), 1, 1), minval=-1.0)
    along = jnp.linspace(-1.0, 1.0, SIDE)
    far = (a * along[None, :, None] + b * along[None, None, :]) / jnp.hypot(a, b)
    seen = x[:, 9] * jnp.where((far > 0.3 + 0.4 * jnp.abs(c)) & (often > 0.6), 0.0, 1.0)
    frame = frame * seen[:, None]
    return jnp.concatenate([frame, drawn, frame * drawn, seen[:, None], x[:, 10:]], axis=1)


def start(seed: int) -> Weights:
    """Return random weights."""
    rng, weights = np.random.default_rng([seed, 0x3E7]), {}
    for k, (inside, out, side, _) in enumerate(_LAYERS):
        weights[f"w{k}"] = rng.normal(0.0, np.sqrt(2.0 / (inside * side * side)), (out, inside, side, side))
        weights[f"b{k}"] = np.zeros(out)
    last = _LAYERS[-1][1]
    weights["hidden"] = rng.normal(0.0, np.sqrt(1.0 / last), (_HIDDEN, 2 * last))
    weights["hidden_bias"] = np.zeros(_HIDDEN)
    weights["out"] = rng.normal(0.0, np.sqrt(1.0 / _HIDDEN), (1, _HIDDEN))
    weights["out_bias"] = np.zeros(1)
    return {name: jnp.asarray(value, jnp.float32) for name, value in weights.items()}


def log_odds(weights: Weights, x: Any) -> Any:
    """Return the network's answers (n,)."""
    for k, (_, _, side, stride) in enumerate(_LAYERS):
        pad = side // 2
        x = jax.lax.conv_general_dilated(x, weights[f"w{k}"], (stride, stride), ((pad, pad), (pad, pad)))
        x = jax.nn.relu(x + weights[f"b{k}"][None, :, None, None])
    x = jnp.concatenate([x.mean(axis=(2, 3)), x.max(axis=(2, 3))], axis=1)
    x = jax.nn.relu(x @ weights["hidden"].T + weights["hidden_bias"])
    return (x @ weights["out"].T + weights["out_bias"])[:, 0]


def loss(weights: Weights, x: Any, right: Any, weight: Any) -> Any:
    z = log_odds(weights, x)
    each = jnp.maximum(z, 0.0) - z * (0.97 * right + 0.015) + jnp.log1p(jnp.exp(-jnp.abs(z)))
    return (each * weight).sum() / weight.sum()


@jax.jit  # type: ignore[untyped-decorator]
def step(weights: Weights, first: Weights, second: Weights, t: Any, rate: Any, key: Any, batch: Any) -> tuple[Any, ...]:
    """Return weights and moments after one step of Adam with decay (Loshchilov and Hutter 2019)."""
    stored, pixel, right, weight = batch
    x = varied(key, whole(stored, pixel))
    value, slope = jax.value_and_grad(loss)(weights, x, right, weight)
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, slope)
    second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, slope)

    def moved(w: Any, m: Any, v: Any) -> Any:
        return w - rate * (m / (1.0 - 0.9**t) / (jnp.sqrt(v / (1.0 - 0.999**t)) + 1e-8) + _DECAY * w)

    return jax.tree.map(moved, weights, first, second), first, second, value


def answers(weights: Weights, stored: NDArray[np.int8], pixel: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the network's answers (n,) to stored inputs."""
    ask = jax.jit(lambda s, p: log_odds(weights, whole(s, p)))
    parts = [ask(stored[i : i + 512], pixel[i : i + 512]) for i in range(0, len(stored), 512)]
    return np.concatenate([np.asarray(part, float) for part in parts])


def area(score: NDArray[np.float64], right: NDArray[np.float32]) -> float:
    """Return the area below the receiver operating characteristic."""
    rank = np.empty(len(score))
    rank[np.argsort(score)] = np.arange(1, len(score) + 1)
    n = float(right.sum())
    return float((rank[right > 0.5].sum() - n * (n + 1) / 2) / max(n * (len(right) - n), 1.0))


def model(weights: Weights) -> onnx.ModelProto:
    """Return the network as ONNX: `patch` (1, CHANNELS, SIDE, SIDE) to `log_odds` (1, 1)."""
    nodes, x = [], "patch"
    for k, (_, _, side, stride) in enumerate(_LAYERS):
        pads = [side // 2] * 4
        nodes.append(
            helper.make_node("Conv", [x, f"w{k}", f"b{k}"], [f"c{k}"], kernel_shape=[side] * 2, strides=[stride] * 2, pads=pads)
        )
        nodes.append(helper.make_node("Relu", [f"c{k}"], [f"r{k}"]))
        x = f"r{k}"
    nodes += [
        helper.make_node("GlobalAveragePool", [x], ["mean"]),
        helper.make_node("GlobalMaxPool", [x], ["most"]),
        helper.make_node("Concat", ["mean", "most"], ["both"], axis=1),
        helper.make_node("Flatten", ["both"], ["flat"], axis=1),
        helper.make_node("Gemm", ["flat", "hidden", "hidden_bias"], ["h"], transB=1),
        helper.make_node("Relu", ["h"], ["hr"]),
        helper.make_node("Gemm", ["hr", "out", "out_bias"], ["log_odds"], transB=1),
    ]
    given = [numpy_helper.from_array(np.asarray(value, np.float32), name) for name, value in weights.items()]
    graph = helper.make_graph(
        nodes,
        "second_opinion",
        [helper.make_tensor_value_info("patch", TensorProto.FLOAT, [1, CHANNELS, SIDE, SIDE])],
        [helper.make_tensor_value_info("log_odds", TensorProto.FLOAT, [1, 1])],
        given,
    )
    made = helper.make_model(graph, producer_name="decklander", opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(made)
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--epochs", type=int, default=14)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    stored, pixel, right, held, rest = load(args.folder)
    print(f"{len(stored)} examples, {int(right.sum())} right, {int(held.sum())} held out")
    weight = np.where(rest["kind"] == 0, _SEARCHED_WEIGHT, 1.0).astype(np.float32)
    train = np.flatnonzero(~held)
    weights = start(args.seed)
    first, second = (jax.tree.map(jnp.zeros_like, weights) for _ in range(2))
    rng, key, t = np.random.default_rng([args.seed, 0x5EED]), jax.random.PRNGKey(args.seed), 0
    steps = args.epochs * (len(train) // _BATCH)
    for epoch in range(args.epochs):
        began, losses = time.monotonic(), []
        for some in rng.permutation(train)[: len(train) // _BATCH * _BATCH].reshape(-1, _BATCH):
            t += 1
            rate = _RATE * min(1.0, t / 200.0) * 0.5 * (1.0 + np.cos(np.pi * t / steps))
            batch = stored[some], pixel[some], right[some], weight[some]
            weights, first, second, value = step(weights, first, second, float(t), rate, jax.random.fold_in(key, t), batch)
            losses.append(float(value))
        z = answers(weights, stored[held], pixel[held])
        of = right[held]
        by = [f"{area(z[k], of[k]):.4f}" for k in (rest["kind"][held] == 0, rest["kind"][held] > 0)]
        print(
            f"epoch {epoch}: loss {np.mean(losses):.4f}, held out: area {by[0]} searched, {by[1]} of the truth, "
            f"{np.mean((z > 0) == (of > 0.5)):.4f} on the right side; {time.monotonic() - began:.0f} s",
            flush=True,
        )
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_bytes(model(weights).SerializeToString())
    print(f"{args.out}: {args.out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
