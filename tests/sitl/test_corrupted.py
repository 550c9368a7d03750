"""Corrupted signals by what a flight's parts get of them, and faults drawn by a seed as files that fly the same."""

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import asdict, replace

from estimator.contracts.errors import BadInput
from estimator.contracts.time import MonoNs, after
from sitl.faults.corrupted import FACTS, Corrupted, Corruptions
from sitl.faults.fault import FaultTimer
from sitl.scenario.scenario import from_mapping, load
from sitl.scenario.with_fault import with_random_faults
from sitl.world.world import Stick, World
from tests.sitl.test_faults import CALM

Values = tuple[float, ...]
TRUE: list[Values] = [(float(n), 10.0 + n, 100.0 + n) for n in range(6)]
"""Six samples, a second apart; the fault is active from the second one to the fourth."""


def corrupted_values(**fault: Any) -> list[Values]:
    corrupted = Corrupted(at_s=1.0, for_s=3.0, **{"signal": "sighting", **fault})
    timer = FaultTimer((corrupted,), 7)
    corruptions, out = Corruptions(timer, 7), []
    for n, values in enumerate(TRUE):
        timer.update(float(n), 1.0, None)
        out.append(corruptions.of(corrupted.signal, values, after(MonoNs(0), float(n))))
    return out


@pytest.mark.parametrize(
    ("fault", "wanted"),
    [
        ({"error": "frozen"}, [TRUE[1]] * 3),
        ({"error": "frozen", "axis": "y"}, [(1.0, 11.0, 101.0), (2.0, 11.0, 102.0), (3.0, 11.0, 103.0)]),
        ({"error": "scaled", "size": 2.0, "axis": "z"}, [(n, 10 + n, 200 + 2 * n) for n in (1.0, 2.0, 3.0)]),
        ({"error": "biased", "size": -0.5}, [(n - 0.5, n + 9.5, n + 99.5) for n in (1.0, 2.0, 3.0)]),
        ({"error": "drifting", "size": 4.0, "axis": "x"}, [(n + 4.0 * (n - 1.0), 10 + n, 100 + n) for n in (1.0, 2.0, 3.0)]),
        ({"error": "late", "size": 2.0}, [TRUE[0], TRUE[0], TRUE[1]]),
        ({"error": "doubled"}, [TRUE[1], TRUE[1], TRUE[3]]),
        ({"error": "swapped", "axis": "z"}, [(10 + n, n, 100 + n) for n in (1.0, 2.0, 3.0)]),
        ({"error": "swapped"}, [(10 + n, 100 + n, n) for n in (1.0, 2.0, 3.0)]),
        ({"error": "sign", "axis": "x"}, [(-n, 10 + n, 100 + n) for n in (1.0, 2.0, 3.0)]),
    ],
)
def test_each_error_does_what_it_says_while_it_lasts_and_nothing_before_or_after(fault, wanted):
    samples = corrupted_values(**fault)
    assert samples[1:4] == [pytest.approx(values) for values in wanted]
    assert samples[0] is TRUE[0]
    assert samples[4:] == TRUE[4:], "frozen and doubled values are forgotten"


def test_a_spike_hits_one_sample_in_twenty_by_its_size_to_either_side() -> None:
    timer = FaultTimer((Corrupted(signal="gyro", error="spiking", size=90.0, axis="y", at_s=0.0),), 3)
    timer.update(0.0, 1.0, None)
    corruptions = Corruptions(timer, 3)
    y = np.array([corruptions.of("gyro", (0.0, 0.0, 0.0), MonoNs(5_000_000 * n))[1] for n in range(2000)])
    assert set(np.round(y, 6)) == {0.0, round(math.pi / 2, 6), -round(math.pi / 2, 6)}
    assert 60 < np.count_nonzero(y > 0.0) + np.count_nonzero(y < 0.0) < 140
    assert 20 < np.count_nonzero(y > 0.0) < 80


def corrupted(faults: tuple[Corrupted, ...], seconds: float, stick: Stick | None = None) -> World:
    w = World(replace(CALM, faults=faults), 1)
    if stick is not None:
        w.stick(stick)
    w.advance(after(w.started, seconds))
    return w


@pytest.mark.parametrize(
    ("signal", "field", "place"),
    [
        ("accelerometer", "f_body", 1),
        ("gyro", "w_body", 1),
        ("attitude", "rpy_rad", 1),
        ("heading", "rpy_rad", 2),
        ("velocity", "v_level_m_s", 1),
        ("range", "ultrasound_m", None),
        ("barometer", "pressure_pa", None),
    ],
)
def test_a_bias_reaches_one_axis_of_one_sensor_alone(signal: Any, field: str, place: int | None) -> None:
    axis = "y" if FACTS[signal].axes > 1 else "all"
    wrong = corrupted((Corrupted(signal=signal, error="biased", size=2.0, axis=axis, at_s=0.1),), 0.5).readings()
    true = corrupted((), 0.5).readings()
    differs = {name: value for name, value in asdict(wrong).items() if value != getattr(true, name)}
    assert list(differs) == [field]
    values = np.atleast_1d(differs[field]) - np.atleast_1d(getattr(true, field))
    expected = np.zeros(len(values))
    expected[place or 0] = 2.0 * FACTS[signal].si
    assert values == pytest.approx(expected)


def test_stamps_frames_and_commands_are_wrong_as_well() -> None:
    late = corrupted((Corrupted(signal="sample_stamps", error="biased", size=-0.25, at_s=0.1),), 0.5).readings()
    assert late.at == corrupted((), 0.5).readings().at - 250_000_000
    frame = corrupted((Corrupted(signal="frame_stamps", error="drifting", size=0.5, at_s=0.1),), 0.5)
    assert frame.render().stamp_error_s == pytest.approx(0.2, abs=0.01)
    frozen = corrupted((Corrupted(signal="frames", error="frozen", at_s=0.1),), 0.05)
    before = frozen.render()
    frozen.advance(after(frozen.started, 0.2))
    after_it = frozen.render()
    assert not after_it.true_view
    assert np.array_equal(before.px, after_it.px)
    climb = Stick(gaz=0.5, progressive=True)
    up, down = corrupted((), 1.0, climb), corrupted((Corrupted(signal="commands", error="sign", axis="z", at_s=0.0),), 1.0, climb)
    assert up.truth().v_body_ned[2] < -0.1 < 0.1 < down.truth().v_body_ned[2]


@pytest.mark.parametrize(
    ("fault", "said_of_it"),
    [
        ({"signal": "range", "error": "swapped"}, "range cannot be swapped"),
        ({"signal": "velocity", "error": "frozen", "axis": "z"}, "velocity has no axis z"),
        ({"signal": "gyro", "error": "biased"}, "changes nothing"),
        ({"signal": "gyro", "error": "scaled", "size": 1.0}, "changes nothing"),
        ({"signal": "gyro", "error": "late", "size": -0.1}, "a delay of more than 0 s"),
        ({"signal": "gyro", "error": "sign", "size": 2.0}, "size does not go with sign"),
        ({"signal": "gnss", "error": "frozen"}, "vehicle.gnss_hz must be more than 0"),
        ({"signal": "ship_heading", "error": "sign"}, "vessel.reports_hz must be more than 0"),
    ],
)
def test_a_fault_that_cannot_be_is_refused_with_its_path(fault: dict[str, Any], said_of_it: str) -> None:
    with pytest.raises(BadInput, match=said_of_it) as why:
        from_mapping({"title": "x", "faults": [{"kind": "corrupted", "at_s": 1.0, **fault}]}, "file")
    assert "faults[0]" in str(why.value)


def test_corrupted_sightings_need_drawn_ones() -> None:
    from sitl.perception.levels import perceive

    fault = Corrupted(signal="sighting", error="sign", at_s=1.0)
    with pytest.raises(BadInput, match="perception model"):
        perceive("pixels", None).refuse((fault,))
    with pytest.raises(BadInput, match="perception truth"):
        with_random_faults(load("calm"), 1, "truth")
    perceive("model", None).refuse((fault,))
