"""The core processes random rows of events, answers and forecasts as the second implementation in numpy does."""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.contracts.estimates import COMPONENTS, FusionResult, Pose6, Sighting, Verdict, components_of, source_of
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselMotion, VesselReport
from estimator.core.library import CORE
from estimator.ekf import EkfOptions, Event, Filter
from estimator.ekf.params import ACCEL_BIAS, CAMERA_MOUNT, GYRO_BIAS, POS_REL, VEL_SCALE, FilterParams, N
from tests.estimator.ekf import oracle
from tests.estimator.ekf.core_state import (
    MS,
    TILTED,
    State,
    T,
    core_answer,
    correlated,
    drawn_x,
    heading,
    holding,
    known,
    newest,
    put,
    seen,
    state_of,
)
from tests.make import attitude, baro, imu, range_down, stamp_at, tuned, velocity, vessel
from tests.support.estimator_truth import Setting, TruthFlight, events

_OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {"velocity_is_over": "either", "deck_radius_m": 3.0, "min_confidence": 0.5},
    {
        "velocity_is_over": "pad", "aiding_period_s": 0.02, "hold_s": 0.02, "pad_yaw_in_vessel_rad": 1.2, "tick_s": 0.01,
        "pad_forward_m": -3.0, "pad_right_m": 1.0,
    },
    {
        "velocity_is_over": "ground", "forget_s": 0.5, "accel_step_m_s2": 1.0, "gyro_step_rad_s": 0.1, "reopen_count": 2,
        "reopen_s": 0.01, "heading_memory_s": 0.3,
    },
)  # fmt: skip
PARAMS = tuple(FilterParams(tuned(EkfOptions, leap_s=10.0, **changed)) for changed in _OPTIONS)
DOWN = np.array([0.0, 0.0, 1.0])
REST = -9.8 * DOWN
ORDER = Imu, Attitude, BodyVelocity, Range, Baro, VesselReport, VesselMotion, Sighting
"""The order in which events of one instant are processed."""
Row = Iterator[Event]
Draw = Callable[[np.random.Generator, SimpleNamespace], Row]
"""A row of events drawn by chance; each may depend on the core's state so far, `now.state`."""


# Agreement


def close(ours: Any, theirs: Any, what: str, tolerance: float = 1e-9) -> None:
    a, b = np.asarray(ours, float), np.asarray(theirs, float)
    if a.shape != b.shape or not (np.abs(a - b) <= tolerance * (1.0 + np.abs(b))).all():
        np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance, err_msg=what)


def same(ours: Any, theirs: Any, what: str) -> None:
    """Assert that two values agree: integers exactly, covariances to 1e-9 of the standard deviations, other numbers to 1e-9."""
    if ours is theirs:
        return
    if isinstance(ours, SimpleNamespace):
        assert vars(ours).keys() == vars(theirs).keys()
        for name, value in vars(ours).items():
            same(value, getattr(theirs, name), f"{what}.{name}")
    elif isinstance(ours, list | tuple):
        assert len(ours) == len(theirs), what
        for one, two in zip(ours, theirs, strict=True):
            same(one, two, what)
    elif np.ndim(theirs) > 1 and what.endswith((".P", "cov")):
        spread = np.sqrt(np.abs(np.diagonal(theirs, axis1=-2, axis2=-1))) + 1e-9
        scale = spread[..., :, None] * spread[..., None, :]
        close(ours / scale, theirs / scale, what, 1e-8 if "bank" in what else 1e-9)
    elif ours is None or isinstance(ours, int):
        assert ours == theirs, what
    else:
        close(ours, theirs, what)


def same_outcome(result: FusionResult, event: Event, expected: oracle.Outcome) -> None:
    assert result.verdict is expected.verdict
    assert (result.innovation is None) is (expected.innov is None)
    if result.innovation is None or expected.innov is None:
        return
    close(result.innovation, expected.innov, "innovation")
    assert (result.innovation_cov is None) is (expected.S is None)
    if expected.S is not None and result.innovation_cov is not None:
        close(result.innovation_cov / np.abs(expected.S).max(), expected.S / np.abs(expected.S).max(), "its covariance")
    close([result.nis, result.test_ratio], [expected.nis, expected.nis / expected.nis_max], "nis")
    source, axes = source_of(event), expected.axes
    names = tuple(COMPONENTS[source][i] for i in axes) if axes else components_of(source, expected.innov.size)
    assert result.components == names


class Step(NamedTuple):
    """The core's processing of one event."""

    before: State | None
    event: Event
    result: FusionResult
    after: State | None


def drive(name: str, seed: int) -> tuple[Filter, list[Step], FilterParams]:
    """Draw a row of events and let the core process it."""
    rng, params, steps = np.random.default_rng([list(ROWS).index(name), seed]), PARAMS[seed % len(PARAMS)], list[Step]()
    b = None if name in ("from nothing", "flight") else drawn_state(rng, params)
    if name in ("looks", "manoeuvre", "stuck") and b is not None:
        b = b.copy(sighted=T - 20 * MS, heading_known=1, P=correlated(seed), rejections=oracle.no_streak())
    if name == "manoeuvre" and b is not None:
        # A deck that is known to be at rest on the waves, so that what moves it is the ship.
        b.P, b.bank = 1e-5 * np.diag(rng.uniform(0.2, 2.0, N)), oracle.bank_unknown()
        b.bank.log_weight = np.where(np.arange(b.bank.log_weight.shape[1]) == 0, 0.0, np.full_like(b.bank.log_weight, -20.0))
        oracle.summarise(b.bank)
        b.wave_w, b.wave_zeta, b.wave_sigma = b.bank.w_rad_s, b.bank.zeta, b.bank.sigma
    filter = Filter(params.options) if b is None else holding(b, params)
    now, last = SimpleNamespace(state=b), (0, 0)
    for event in ROWS[name][0](rng, now):
        if (place := (event.stamp.measured_at, ORDER.index(type(event)))) >= last:
            before, result, last = now.state, put(filter, event), place
            now.state = state_of(filter)
            steps.append(Step(before, event, result, now.state))
    return filter, steps, params


# Events and states by chance


def drawn_sample(rng: np.random.Generator, t: int, wild: float) -> Event:
    """Return a sample of the vehicle or a ship's report; the larger `wild`, the more of them no filter should believe."""
    size, at = 30.0 if rng.random() < wild else 1.0, stamp_at(t)
    match rng.integers(11):
        case 0 | 1 | 2:
            lost = rng.choice([0.0, 0.0, 0.0, 0.02, 0.1], 2)
            sample = imu(at, 0.1 * size * rng.normal(size=3), REST + 0.3 * size * rng.normal(size=3))
            return replace(sample, gyro_lost_s=float(lost[0]), accel_lost_s=float(lost[1]))
        case 3:
            return attitude(at, *(np.array([0.1, -0.15, 0.8]) + 0.02 * size * rng.normal(size=3)), var=rng.uniform(1e-5, 1e-3, 3))
        case 4 | 5:
            var = np.where(rng.random(3) < 0.3, 1e6, rng.uniform(1e-4, 1e-2, 3))
            return velocity(at, 0.2 * size * rng.normal(size=3), var=var)
        case 6 | 9:
            return range_down(at, abs(2.6 + 0.1 * size * rng.normal()), 0.05)
        case 7:
            return baro(at, 2.6 + 0.1 * size * rng.normal(), 0.1)
        case 8:
            (roll, pitch), down = 0.05 * size * rng.normal(size=2), float(0.3 * size * rng.normal())
            tilt, heave = rng.random(2) < 0.7
            return VesselMotion(at, "PSXN", roll if tilt else None, pitch if tilt else None, 0.01, down if heave else None, 0.1)
    v, course = (0.1 * size * rng.normal(size=3) if rng.random() < 0.7 else None), float(0.1 * size * rng.normal())
    turn = float(rng.choice([0.02, 0.3, 1.0]) * size * rng.normal()) if rng.random() < 0.6 else None
    return vessel(at, v, course if rng.random() < 0.7 else None, var=rng.uniform(1e-3, 1e-1, 3), turn_rad_s=turn)


def expected_place(b: State) -> tuple[F64, F64]:
    """Return the pad's place in level, (3,) m, and its rotation from pad to level, as a camera on time would see them."""
    to_level = oracle.levelling(b) @ oracle.exp(-b.x[CAMERA_MOUNT]) @ b.R.T
    return to_level @ b.x[POS_REL], to_level @ oracle.deck_attitude(b.x)[0]


def drawn_sighting(rng: np.random.Generator, t: int, b: State) -> Sighting:
    """Return a sighting of about where the pad is expected, beside it, or with its heading turned round."""
    d, M = expected_place(b)
    d = d + rng.choice([0.005, 0.3, 3.0], p=[0.6, 0.2, 0.2]) * rng.normal(size=3)
    R = M @ oracle.about_down(rng.choice([0.0, math.pi, 2.0], p=[0.6, 0.3, 0.1])) @ oracle.exp(0.02 * rng.normal(size=3))
    spread = rng.normal(size=(6, 6)) * 0.3 + np.eye(6)
    cov6 = spread @ np.diag(rng.choice([1e-4, 1e-3]) * rng.uniform(0.5, 2.0, 6)) @ spread.T
    s = seen(
        d, None if rng.random() < 0.2 else -heading(R), t=t, ambiguous=bool(rng.random() < 0.3), sigma_s=rng.choice([0.0, 0.01]),
        confidence=float(rng.choice([1.0, 0.3, 0.01], p=[0.8, 0.15, 0.05])),
        pose6=Pose6(d, Rotation(R), cov6) if rng.random() < 0.4 else None,
    )  # fmt: skip
    return s if s.yaw_rad is None else replace(s, cov=cov6[:4, :4])


def drawn_state(rng: np.random.Generator, params: FilterParams) -> State:
    """Return a state with a history of any kind, about a pad some 2 m below."""

    def ago(*ms: int) -> int:
        """Return an instant that long before `T`, or -1 for none."""
        return int(rng.choice([-1, *(T - one * MS for one in ms)]))

    n, R, size, x = int(rng.integers(0, 7)), TILTED, float(rng.uniform(0.1, 5.0)), drawn_x(int(rng.integers(2**31)), 0.3)
    x[VEL_SCALE] = rng.choice([x[VEL_SCALE], 0.201, 2.999], p=[0.7, 0.15, 0.15])
    numbers = rng.uniform(-2.5, 6.5, (n, 3)) * 1e-3, rng.normal(0.0, 6.0, (n, 3))
    rejected, zeros = int(rng.integers(0, 6)), np.zeros((3, 3))
    streak = (rejected, T - 800 * MS, T - 60 * MS, rng.normal(size=3), 1e-4) if rejected else (0, 0, 0, np.zeros(3), 0.0)
    b = known(
        params, x=x, P=correlated(int(rng.integers(2**31)), size),
        agreed=int(rng.integers(0, 8)), sighted=T - 20 * MS if rng.random() < 0.8 else -1,
        over_pad=float(rng.uniform(-5.0, 5.0)), t_imu=ago(5),
        w=0.03 * rng.normal(size=3), w_smooth=0.03 * rng.normal(size=3), f=REST + 0.2 * rng.normal(size=3),
        excesses=[(T - (n - k) * 60 * MS, np.concatenate([numbers[0][k], numbers[1][k]])) for k in range(n)],
        rejections=SimpleNamespace(
            **dict(zip(("n", "since", "last", "offset_ned", "var_m2", "by_baseline"), (*streak, 0), strict=True))
        ),
        heading_known=int(rng.random() < 0.8), heading_held_s=float(rng.uniform(-0.1, 0.4)), heading_seen=ago(100),
        nis_mean=float(rng.uniform(0.5, 3.0)), nis_claimed=float(rng.uniform(0.1, 1.2)),
        steered=ago(170, 600), swung=ago(300, 1600), turn_since=ago(300, 1700), turn_last=ago(100, 1200),
        turn_heading=ago(400, 1200), turn_left_out=ago(-2000, 2000), turn_deviate=float(rng.normal(0.0, 6.0)),
        vessel_before=rng.normal(size=2), ins_p=rng.normal(size=3),
        ins_v=rng.normal(size=3), ins_var_m2_s2=float(rng.choice([0.0, 0.05])),
        levelled_by=R @ oracle.exp(0.02 * rng.normal(size=3)),
        cov_levelled_by=np.diag(rng.choice([0.0, 1e-5, 1e-3, 0.1]) * rng.uniform(0.5, 2.0, 3)),
    )  # fmt: skip
    if rng.random() < 0.1:
        b.is_levelled, b.levelled_by = 0, zeros
    for k in range(int(rng.integers(0, 4))):
        y, var = rng.normal(size=5) * [0.3, 0.3, 0.5, 0.05, 0.05], np.where(rng.random(5) < 0.2, 1e6, 1e-4)
        b.bank = oracle.observe(b.bank, T - (1000 - 210 * k) * MS, y, var, params)
        b.wave_w, b.wave_zeta, b.wave_sigma = b.bank.w_rad_s, b.bank.zeta, b.bank.sigma
    return b


# Rows


def mixed(rng: np.random.Generator, now: SimpleNamespace) -> Row:
    """Samples and sightings of all kinds, of which none, some or all are implausible."""
    t, wild, gap_ms = T, rng.choice([0.0, 0.2, 1.0]), rng.choice([1.0, 5.0, 60.0])
    for _ in range(20):
        t += int(rng.exponential(gap_ms * 1e6) * (rng.random() < 0.9))
        yield drawn_sighting(rng, t, now.state) if rng.random() < 0.2 else drawn_sample(rng, t, wild)


def from_nothing(rng: np.random.Generator, now: SimpleNamespace) -> Row:
    """A cold start: what shows which way is down begins, and an attitude that comes later turns the world to its north."""
    t, gap_ns = int(rng.choice([0, T])), rng.choice([8e6, 4e7])
    if rng.random() < 0.5:
        yield imu(stamp_at(t), f=REST)
        yield seen(rng.normal(size=3) + 4.0 * DOWN, 0.3, t=t)
    for k in range(25):
        t += int(rng.exponential(gap_ns))
        event = seen(rng.normal(size=3) + 4.0 * DOWN, rng.uniform(-3.0, 3.0), t=t) if k % 8 == 0 else drawn_sample(rng, t, 0.1)
        if k > 2 or not isinstance(event, Attitude):
            yield replace(event, f_body=event.f_body * rng.choice([0.4, 1.0])) if isinstance(event, Imu) and k < 5 else event


def looks(rng: np.random.Generator, now: SimpleNamespace) -> Row:
    """A deck that moves on waves, sighted some five times a second: the bank learns and its forecasts are compared."""
    t, w, pose = T, rng.uniform(0.5, 2.0, 5), rng.random() < 0.5
    swing = rng.choice([0.0, 1.0]) * np.array([0.3, 0.2, 0.6, 0.1, 0.05])
    d, M = expected_place(now.state)
    for _ in range(26):
        t += int(rng.choice([0, 180, 200, 350, 3000], p=[0.05, 0.3, 0.4, 0.2, 0.05])) * MS
        wave = swing * np.sin(w * (t - T) * 1e-9) + 0.003 * rng.normal(size=5)
        R = M @ oracle.exp(np.array([*wave[3:], 0.0]))
        whole = Pose6(d + wave[:3], Rotation(R), np.diag([1e-4] * 3 + [1e-3] * 3)) if pose else None
        yield seen(d + wave[:3], -heading(R), t=t, pose6=whole)


def manoeuvre(rng: np.random.Generator, now: SimpleNamespace) -> Row:
    """A ship that brakes or turns hard, and then goes out of sight."""
    t, (d, M), turn = T, expected_place(now.state), float(rng.uniform(0.0, 0.8))
    side = rng.uniform(2.0, 8.0) * np.append(rng.normal(size=2), 0.0)
    for k in range(10):
        t, s, b = t + 50 * MS, 0.05 * k, now.state
        yield imu(stamp_at(t), b.x[GYRO_BIAS], b.R.T @ [0.0, 0.0, -9.80665] + b.x[ACCEL_BIAS])
        yield seen(d + 0.5 * s * s * side, -heading(M) + turn * s, t=t, var=2e-5, yaw_var=1e-4)
    for _ in range(15):
        t += int(rng.exponential(40e6))
        yield drawn_sample(rng, t, 0.1)


def moved_pad(rng: np.random.Generator, now: SimpleNamespace) -> Row:
    """Sightings of a pad that is somewhere else than expected, and stays there or drifts."""
    t, drift, yaw = T, rng.choice([0.0, 0.15, 2.0]) * rng.normal(size=3), rng.uniform(-3.0, 3.0)
    for k in range(10):
        t += int(rng.choice([100, 120, 120, 2500], p=[0.3, 0.3, 0.3, 0.1])) * MS
        yield seen(expected_place(now.state)[0] + 6.0 + k * drift, yaw, t=t)


def turned_round(rng: np.random.Generator, now: SimpleNamespace) -> Row:
    """Sightings whose heading is half a turn off, now and then one that is not."""
    for k in range(12):
        d, M = expected_place(now.state)
        R = M @ oracle.about_down(math.pi if rng.random() < 0.8 else 0.0)
        whole = Pose6(d, Rotation(R), np.diag([1e-4] * 3 + [1e-3] * 3)) if rng.random() < 0.3 else None
        yield seen(d + 0.003 * rng.normal(size=3), -heading(R), t=T + 90 * k * MS, pose6=whole)


def flight(rng: np.random.Generator, now: SimpleNamespace) -> Row:
    """A second and a half over a rough sea, from the first sample on."""
    setting = Setting(seed=int(rng.integers(9)), sea=4, duration_s=1.5, pose6=True, range_hz=20.0, imu_hz=100.0, outliers=0.05)
    yield from sorted(events(TruthFlight(setting)), key=lambda event: (event.stamp.measured_at, ORDER.index(type(event))))


def stuck(rng: np.random.Generator, now: SimpleNamespace) -> Row:
    """A sensor that contradicts for longer than a second, and so is accepted at the price of what it contradicts."""
    kind = rng.integers(4)
    for k in range(120):
        at = stamp_at(T + 20 * MS * k)
        if k % 2 == 0:
            yield imu(at, f=REST)
        elif kind == 0:
            yield attitude(at, 0.1, -0.15, 1.1, var=1e-6)
        elif kind == 1:
            yield velocity(at, np.array([9.0, -8.0, 0.0]) + 0.01 * rng.normal(size=3), var=[1e-4, 1e-4, 1e6])
        else:
            yield range_down(at, 9.0, 0.01) if kind == 2 else baro(at, -70.0, 0.01)


ROWS: dict[str, tuple[Draw, int]] = {
    "mixed": (mixed, 40), "from nothing": (from_nothing, 16), "looks": (looks, 8), "manoeuvre": (manoeuvre, 16),
    "moved pad": (moved_pad, 12), "turned round": (turned_round, 8), "stuck": (stuck, 8), "flight": (flight, 2),
}  # fmt: skip
"""The kinds of rows, and how many of each are drawn."""


@pytest.mark.parametrize(("name", "seed"), [(name, seed) for name, (_, n) in ROWS.items() for seed in range(n)])
def test_a_row_of_events(name: str, seed: int) -> None:
    """Outcomes and states agree after each event, and so do answers and forecasts at some instant after the last."""
    filter, steps, params = drive(name, seed)
    for before, event, result, after in steps:
        expected, outcome = oracle.process(before, event, params)
        same_outcome(result, event, outcome)
        same(after, expected, type(event).__name__)
    b = newest(filter)
    t = b.t + (0, 4, 30, 200, 700)[seed % 5] * MS
    ours, theirs = core_answer(filter, t), oracle.answer(b, t, params)
    for what, value in theirs.items():
        same(ours[what] if np.ndim(value) != 2 else ours[what].reshape(np.shape(value)), value, what)
    if theirs["has_deck"]:
        horizons_s = np.array([(1.0, 2.0, 3.0), (7.3,), (20.0, 1e-3), (3.0, 2.0, 0.0)][seed % 4])
        made, pointer = CORE.room("dl_deck_ahead", horizons_s.size)
        assert CORE.lib.dl_filter_forecast(filter._core, t, horizons_s.size, CORE.array("double", horizons_s), pointer)
        for one, wanted in zip(made, oracle.forecast(b, t, horizons_s, params), strict=True):
            for what, value in wanted.items():
                same(one[what].reshape(np.shape(value)), value, f"forecast {what}")


def test_the_rows_above_fuse_refuse_reset_inflate_and_find_manoeuvres() -> None:
    counts: Counter[str] = Counter()
    for name in ("mixed", "moved pad", "turned round", "stuck", "manoeuvre"):
        for before, event, result, after in (step for seed in range(10) for step in drive(name, seed)[1]):
            if before is None or after is None:
                continue
            counts[f"{type(event).__name__} {result.verdict.value}"] += 1
            counts["reset"] += result.verdict is Verdict.FUSED and before.agreed > 1 and after.agreed == 1
            counts["turned"] += before.heading_held_s > 0.0 and after.heading_held_s == 0.0
            counts["steered"] += after.steered > before.steered
            counts["swung"] += after.swung > before.swung
            ended = [k for k in range(4) if before.aids[k].refused >= 0 > after.aids[k].refused]
            counts["inflated"] += bool(ended) and result.verdict is Verdict.GATED
    kinds = [kind.__name__ for kind in ORDER[1:]]
    wanted = [f"{kind} {verdict}" for kind in kinds for verdict in ("fused", "gated")]
    missing = [
        one for one in (*wanted, "Sighting low_confidence", "reset", "turned", "steered", "swung", "inflated") if counts[one] < 2
    ]
    assert not missing
