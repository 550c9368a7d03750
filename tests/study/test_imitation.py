"""Training by imitation: the teacher lands, its gradient is right, and a student of few rounds flies through the port."""

import contextlib
import math
import zipfile
from pathlib import Path

import numpy as np
import pytest

from companion.cli import main as cli
from companion.guidance.law.policy import ARRAYS, Policy, forward, normal, read_policy, shipped_policy
from companion.settings.load import load as settings
from companion.settings.load import response_model
from estimator.contracts.errors import BadInput
from sitl.scenario.scenario import load
from sitl.scenario.settings import settings_for
from sitl.study.gym.imitation import Imitation, ImitationOptions, Teacher, _backward, _network, fly_policy, tally
from sitl.study.gym.training import TrainingOptions, TrainingWorlds

SCENARIO = load("weather_3")
RESPONSE = response_model(settings_for(SCENARIO, None))


def test_the_teacher_lands_every_episode() -> None:
    worlds = TrainingWorlds(SCENARIO, 24, TrainingOptions(start_low=(-1.0, -1.0, 1.0, -3.0), start_high=(1.0, 1.0, 2.0, 3.0)))
    worlds.begin(range(24))
    teacher, ends, touchdowns = Teacher(worlds, RESPONSE), [], []
    for _ in range(500):
        actions, trim = teacher.actions(), worlds.truth["trim"].copy()
        worlds.step(actions)
        teacher.flown(actions, trim)
        ends.append(worlds.ends.copy())
        touchdowns.append(worlds.touchdowns.copy())
    flown = tally(ends, touchdowns)
    assert flown.episodes >= 24
    assert flown.landed > 0.97
    assert flown.distance_m < 0.06


def test_a_training_that_is_stopped_keeps_its_newest_policy(tmp_path: Path, monkeypatch, capsys) -> None:
    def stopped(self, *given, whole=Imitation.rounds):
        yield next(whole(self, *given))
        raise KeyboardInterrupt

    monkeypatch.setattr(Imitation, "rounds", stopped)
    assert cli.main(["train", "weather_3", "--out", str(tmp_path / "mine.npz")]) == 130
    assert "stopped after 1 rounds: their policy is kept" in capsys.readouterr().err
    assert len(read_policy(tmp_path / "mine.npz", "--out").record["curve"]) == 1


def test_the_gradient_is_that_of_finite_differences() -> None:
    rng = np.random.default_rng(0)
    net = {name: value.astype(float) for name, value in _network(rng, 8).items()}
    net["w2"] += rng.standard_normal(net["w2"].shape)
    x, pull = rng.standard_normal((5, 21)), rng.standard_normal((5, 4))
    made = _backward(net, x, forward(net, x), pull)  # type: ignore[arg-type]
    for name in set(ARRAYS) - {"mean", "scale"}:
        place = tuple(rng.integers(size) for size in net[name].shape)
        sums = []
        for step in (1e-6, -1e-6):
            net[name][place] += step
            sums.append(float((forward(net, x)[-1] * pull).sum()))  # type: ignore[arg-type]
            net[name][place] -= step
        assert made[name][place] == pytest.approx((sums[0] - sums[1]) / 2e-6, rel=1e-5, abs=1e-8)


def test_the_same_seed_trains_the_same_policy_and_it_survives_its_file(tmp_path: Path) -> None:
    short = ImitationOptions(steps=140, batches=10, batch=128, width=16)
    trained = []
    for _ in range(2):
        student, rounds = Imitation([TrainingWorlds(SCENARIO, 8)], RESPONSE, 5, options=short), iter((0.0, 0.5, 1.0))
        assert len(list(student.rounds(5000, lambda: next(rounds)))) == 2  # noqa: B023
        trained.append(student.policy({"scenario": "weather_3"}))
    assert all((trained[0].weights[name] == trained[1].weights[name]).all() for name in ARRAYS)
    trained[0].write(tmp_path / "mine.npz")
    again = read_policy(tmp_path / "mine.npz", "--from")
    seen = np.random.default_rng(1).standard_normal((3, 21)).astype(np.float32)
    assert (again.act(seen) == trained[0].act(seen)).all()
    assert again.record["scenario"] == "weather_3"


def test_the_shipped_policy_lands_in_the_training_worlds() -> None:
    policy = read_policy(shipped_policy("quad_1_5kg"), "guidance.policy_file")
    assert Path(shipped_policy("quad_1_5kg")).stat().st_size < 200_000
    flown = fly_policy(policy, TrainingWorlds(SCENARIO, 24), 77_000)
    assert flown.landed > 0.9
    assert flown.distance_m < 0.09


def _announcing(shape: str) -> bytes:
    """Return an array of one number that announces a shape."""
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}}}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(4)


@pytest.mark.parametrize(
    ("content", "packing", "said"),
    [
        (bytes(30_000_000), zipfile.ZIP_DEFLATED, "unpack to 30000000 bytes, and at most"),
        (bytes(3_000_000), zipfile.ZIP_BZIP2, "neither stored nor deflated"),
        (_announcing("(1000000000000,)"), zipfile.ZIP_STORED, "reshape"),
        (b"", zipfile.ZIP_STORED, "magic"),
    ],
    ids=["a thousand times its size", "bzip2", "announces terabytes", "empty"],
)
def test_a_policy_is_read_with_a_bound_on_what_it_unpacks_to(tmp_path, content, packing, said):
    """WHY: a megabyte of packed zeros is a gigabyte, and the service that reads it dies in flight."""
    path = tmp_path / "mine.npz"
    with zipfile.ZipFile(path, "w", packing) as archive, archive.open("w0.npy", "w", force_zip64=True) as file:
        file.write(content)
    with pytest.raises(BadInput, match=said):
        read_policy(path, "guidance.policy_file")


def test_a_policy_that_was_damaged_anywhere_is_read_or_refused(tmp_path: Path) -> None:
    whole, rng = bytearray(Path(shipped_policy("quad_1_5kg")).read_bytes()), np.random.default_rng(1)
    for _ in range(200):
        torn = whole.copy()
        for at in rng.integers(0, len(whole), 3).tolist():
            torn[at] ^= 1 << int(rng.integers(8))
        (tmp_path / "mine.npz").write_bytes(torn[: int(rng.integers(len(whole) // 2, len(whole) + 1))])
        with contextlib.suppress(BadInput):
            read_policy(tmp_path / "mine.npz", "guidance.policy_file")


def test_a_file_that_is_no_policy_is_refused_in_one_line(tmp_path: Path) -> None:
    other = tmp_path / "other.npz"
    np.savez(other, w0=np.zeros((3, 3)))
    for path in (other, tmp_path / "none.npz", tmp_path):
        with pytest.raises(BadInput) as refused:
            read_policy(path, "guidance.policy_file")
        assert "\n" not in str(refused.value)
    weights = _network(np.random.default_rng(0), 8)
    with pytest.raises(ValueError, match="lacks"):
        Policy(weights, {})
    weights["w1"][0, 0] = math.nan
    with pytest.raises(ValueError, match="finite"):
        Policy(weights, {"acceleration_m_s2": 3.0, "place_m": 2.0})
    with pytest.raises(BadInput, match="no policy ships"):
        shipped_policy("nonesuch")
    assert settings("sim").guidance.policy_file == ""
    assert (normal(_network(np.random.default_rng(0), 8), np.full((1, 21), 1e9, np.float32)) == 10.0).all()
