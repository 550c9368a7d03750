"""The native core against the numpy oracle where it decides: with values just inside and just outside each of its bounds."""

import math
import struct
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import Rotation, rpy_matrix, wrap_pi
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Range, VesselReport
from estimator.core.abi import DL_WITH_COVARIANCE, EXCESSES_MAX
from estimator.ekf.packed_belief import PackedBelief
from estimator.ekf.packed_event import PackedEvent, packed_event
from estimator.ekf.so3 import about_down
from estimator.ekf.state import (
    ATT_ERR,
    ATTITUDE,
    BARO_OFFSET,
    CAMERA_DELAY,
    CAMERA_MOUNT,
    PAD_YAW,
    POS_REL,
    TURN_RATE,
    VEL,
    VEL_SCALE,
    VELOCITY,
    VESSEL_EAST,
    VESSEL_NORTH,
    VESSEL_VEL,
    WAVES,
    Belief,
    InnovationExcesses,
)  # fmt: skip
from tests.estimator.ekf import flown
from tests.estimator.ekf.flown import fuse_sighting
from tests.estimator.ekf.hand import (
    LEVEL,
    MS,
    TILTED,
    TOOLS,
    T,
    belief,
    correlated,
    diagonal,
    imu,
    learned,
    params,
    sighting,
    stamp,
    state,
    under,
    whole,
)  # fmt: skip
from tests.estimator.ekf.oracle import so3
from tests.estimator.ekf.oracle.deck_jolt import RATIO_MAX
from tests.estimator.ekf.oracle.propagate import propagated_with_covariance
from tests.estimator.ekf.oracle.samples import process_sample
from tests.estimator.ekf.oracle.sighting import levelling
from tests.estimator.ekf.test_core import same
from tests.estimator.ekf.test_core_sightings import agrees

# Sightings that keep missing the deck


def missed(ages_ns: tuple[int, ...], ratios: tuple[float, ...], off_sigmas: float = 0.0) -> Belief:
    """Return the belief after a sighting that followed others of these ages and ratios, off down by this many sigmas."""
    P = diagonal(d=0.01)
    P[WAVES[2, 0], WAVES[2, 0]] = 0.003
    values = tuple((*(0.0101 * (r - RATIO_MAX) for r in (0.1 * ratio, 0.3, ratio)), 0.0, 0.0, 0.0) for ratio in ratios)
    b = belief(x=under(), P=P, excesses=InnovationExcesses(tuple(T - age for age in ages_ns), values))
    after, _ = agrees(b, sighting((0.0, 0.0, 2.0 + off_sigmas * math.sqrt(0.0101))), TOOLS)
    return after


@pytest.mark.parametrize(("age_ns", "kept"), [(350_000_000, 2), (350_000_001, 1)])
def test_a_sighting_counts_for_a_third_of_a_second_to_the_nanosecond(age_ns: int, kept: int) -> None:
    assert len(missed((age_ns,), (1.0,)).excesses.t) == kept


@pytest.mark.parametrize(
    ("ages_ns", "widens"),
    [
        ((120_000_000, 60_000_000), True),
        ((119_999_999, 60_000_000), False),
        ((120_000_000,), False),
        ((200_000_000, 150_000_000, 100_000_000, 50_000_000), True),
    ],
)
def test_three_sightings_over_a_span_widen_the_deck(ages_ns: tuple[int, ...], widens: bool) -> None:
    after = missed(ages_ns, (9.0,) * len(ages_ns), 3.0)
    assert (not after.excesses.t) is widens


@pytest.mark.parametrize(("ratio", "widens"), [(2.49, False), (2.5, False), (2.51, True), (4.9, True)])
def test_the_median_ratio_that_widens_the_deck(ratio: float, widens: bool) -> None:
    after = missed((200 * MS, 100 * MS), (ratio, ratio), 0.0)
    assert (not after.excesses.t) is widens


@pytest.mark.parametrize(("sigmas", "counted"), [(6.9, True), (7.1, False), (9.5, False)])
def test_a_sighting_seven_sigmas_off_is_of_something_else(sigmas: float, counted: bool) -> None:
    assert len(missed((60 * MS,), (1.0,), sigmas).excesses.t) == 1 + counted


@pytest.mark.parametrize(
    ("before", "age_ms", "way", "usual", "steers"),
    [
        (4.0, 33, (0.0, 0.0), 1.0, True),
        (3.0, 33, (0.0, 0.0), 1.0, False),
        (4.0, 161, (0.0, 0.0), 1.0, False),
        (-4.0, 33, (-1.0, 0.0), 1.0, True),  # she goes south, and the deck comes north: she brakes
        (2.2, 33, (0.0, 0.0), 0.2, True),
        (2.0, 33, (0.0, 0.0), 0.2, False),  # one alone shows nothing, however far off it is
        (-4.0, 33, (0.0, 0.0), 0.2, False),
    ],
)
def test_two_sightings_that_show_a_manoeuvre_to_one_side_loosen_the_ships_velocity(
    before: float, age_ms: int, way: tuple[float, float], usual: float, steers: bool
) -> None:
    """The unit is the deviation that sightings have had so far."""
    P = diagonal(d=1e-4)
    P[VESSEL_VEL, VESSEL_VEL] = 1e-4 * np.eye(2)
    x = under()
    x[VESSEL_VEL] = way
    excesses = InnovationExcesses((T - age_ms * MS,), ((-1.0, -1.0, -1.0, before, 0.0, 0.0),))
    b = belief(x=x, P=P, excesses=excesses, nis_claimed=usual)
    after, _ = agrees(b, sighting((0.05, 0.0, 2.0)), TOOLS)
    assert after.steered == (T if steers else -1)
    assert bool(after.P[VESSEL_NORTH, VESSEL_NORTH] > 1e-2) is steers
    assert bool(abs(after.x[VESSEL_NORTH] - way[0]) > 0.1) is steers
    assert after.P[VESSEL_EAST, VESSEL_EAST] < 1e-3, "the other axis shows nothing"


@pytest.mark.parametrize(
    ("off", "turned_rad", "steered_ms", "shows"),
    [
        ((0.15, 0.0, 0.06), 0.0, None, False),  # of another height, it is wrong
        ((0.15, 0.0, 0.03), 0.0, None, True),
        ((0.15, 0.0, 0.06), 0.0, 300, True),  # a turn that was shown goes on
        ((0.15, 0.0, 0.09), 0.0, 300, False),
        ((0.02, 0.0, 0.01), 0.2, None, False),  # few features err in heading
    ],
)
def test_a_hard_manoeuvre_shows_though_it_leaves_more_than_a_chi_square(
    off: tuple[float, float, float], turned_rad: float, steered_ms: int | None, shows: bool
) -> None:
    P = diagonal(d=1e-5, head=1e-5)
    P[VESSEL_VEL, VESSEL_VEL] = 1e-5 * np.eye(2)
    steered = -1 if steered_ms is None else T - steered_ms * MS
    b = belief(x=under(), P=P, excesses=InnovationExcesses((T - 33 * MS,), ((-1.0, -1.0, -1.0, 4.0, 0.0, 0.0),)), steered=steered)
    place = (off[0], off[1], 2.0 + off[2])
    pose = whole(place, rpy_matrix(0.0, 0.0, turned_rad), np.diag([1e-5] * 3 + [1e-4] * 3))
    after, _ = agrees(b, sighting(place, -turned_rad, var=1e-5, yaw_var=1e-4, pose6=pose), TOOLS)
    assert (after.steered == T) is shows


@pytest.mark.parametrize(
    ("seen_ms", "of", "shown_ms", "adrift"),
    [
        (301, "swung", 301, True),
        (299, "swung", 299, False),
        (400, "swung", 1399, True),
        (1999, "swung", 2100, True),
        (2001, "swung", 2100, False),
        (400, "swung", 1401, False),
        (400, "steered", 499, True),
        (400, "steered", 501, False),
    ],
)
def test_a_pad_swung_out_of_sight_settles_to_the_ships_speed_before(seen_ms: int, of: str, shown_ms: int, adrift: bool) -> None:
    """The truth is the first-order process about the speed before, which the body's error over the ground shifts alike."""
    for common_m_s in (0.0, 1.3):
        x, P, later = under(), diagonal(d=1e-4), T + 100 * MS
        x[VEL] = common_m_s, 0.0, 0.0
        x[VESSEL_VEL], x[TURN_RATE] = (common_m_s + 3.0, -2.0), 1.5
        P[VESSEL_VEL, VESSEL_VEL] = 1e-4 * np.eye(2)
        b = belief(
            x=x, P=P, sighted=T - seen_ms * MS, vessel_before=np.array([1.0, 0.5]), ins_v=np.zeros(3),
        )._replace(**{of: T - shown_ms * MS})  # fmt: skip
        ours = PackedBelief.of(b).propagated(later, TOOLS, DL_WITH_COVARIANCE).belief
        same(ours, propagated_with_covariance(b, later, TOOLS))
        turned = b._replace(swung=-1, steered=-1)
        free = PackedBelief.of(turned).propagated(later, TOOLS, DL_WITH_COVARIANCE).belief
        stays = math.exp(-0.1 / 0.3) if adrift else 1.0
        settled = np.array([common_m_s + 1.0, 0.5])
        assert ours.x[VESSEL_VEL] == pytest.approx(settled + stays * (free.x[VESSEL_VEL] - settled))
        assert ours.x[TURN_RATE] == pytest.approx(1.5 * stays)
        assert bool(ours.P[VESSEL_NORTH, VESSEL_NORTH] > 0.2) is adrift


@pytest.mark.parametrize(
    ("before", "now", "shown_ms", "swings"),
    [
        ((1.0, 0.0), (0.0, 0.0), 100, False),  # she stops
        ((1.0, 0.0), (1.0, 0.6), 100, True),
        ((1.0, 0.0), (1.0, 0.4), 100, False),
        ((1.0, 0.0), (1.0, 0.6), 501, False),
        ((0.2, 0.0), (0.8, 0.0), 100, True),  # she lies still, so that nothing is along her way
    ],
)
def test_a_pad_that_moves_across_the_ships_way_is_swung(before, now, shown_ms, swings):
    x, P = under(), diagonal(d=1e-4)
    x[VESSEL_VEL] = now
    b = belief(x=x, P=P, steered=T - shown_ms * MS, vessel_before=np.array(before), ins_v=np.zeros(3))
    after, _ = agrees(b, sighting((0.0, 0.0, 2.0)), TOOLS)
    assert after.swung == (T if swings else -1)


def test_as_many_sightings_are_kept_as_there_is_room_for() -> None:
    for used in (EXCESSES_MAX - 1, EXCESSES_MAX):
        after = missed(tuple((used - k) * 5 * MS for k in range(used)), tuple(0.01 * k for k in range(used)))
        assert len(after.excesses.t) == EXCESSES_MAX, "the oldest makes room"


# When the camera's delay is corrected, and the sea looked at


def test_the_delay_is_corrected_while_the_rate_of_the_place_is_known_along_all_axes_together() -> None:
    for var, learns in (
        ((0.10, 0.005, 0.012), True), ((0.10, 0.012, 0.012), False), ((0.005, 0.10, 0.012), True), ((0.012, 0.012, 0.10), False),
        ((0.06, 0.06, 0.001), True), ((0.13, 0.05, 0.03), False),
    ):  # fmt: skip
        x, P = under(), diagonal(d=0.01, delay=1e-3)
        x[VEL] = 1.0, -0.5, 0.3
        P[VEL, VEL] = np.diag(var)
        after, _ = agrees(belief(x=x, P=P), sighting((0.05, 0.02, 2.03)), TOOLS)
        assert bool(abs(after.x[CAMERA_DELAY]) > 1e-4) is learns, var


def test_the_vessel_s_velocity_is_part_of_the_rate_of_the_place() -> None:
    """The derivative is one over level axes and a camera that looks straight down."""
    x, P = under(), diagonal(d=0.01, delay=1e-3)
    x[VEL] = 1.0, -0.5, 0.3
    P[VESSEL_VEL, VESSEL_VEL] = np.eye(2) * 0.1
    after, _ = agrees(belief(x=x, P=P), sighting((0.05, 0.02, 2.03)), TOOLS)
    assert abs(after.x[CAMERA_DELAY]) < 1e-4


@pytest.mark.parametrize(("ago_ms", "looks"), [(170, False), (190, True), (400, True)])
def test_the_sea_is_looked_at_five_times_a_second(ago_ms: int, looks: bool) -> None:
    b = belief(TILTED, x=state(), P=correlated(), sea=learned(t=T - ago_ms * MS))
    after, _ = agrees(b, shown(b), TOOLS)
    assert (after.sea.t == T) is looks


@pytest.mark.parametrize("t", [0, 100 * MS])
def test_a_sea_looked_at_in_the_first_instant_was_looked_at(t: int) -> None:
    b = belief(t=t, x=under(), P=diagonal(d=0.01), sea=learned(t=0), heading_seen=0)
    after, _ = agrees(b, sighting((0.0, 0.0, 2.0), t=t), TOOLS)
    assert after.sea.t == 0


def shown(b: Belief, **fields: Any) -> Sighting:
    """Return a sighting a little beside where the belief has the pad; all of its orientation where `pose6` is given."""
    d = levelling(b.R, b.levelled_by) @ so3.exp(-b.x[CAMERA_MOUNT]) @ b.R.T @ b.x[POS_REL]
    return sighting(d + np.array([0.01, -0.02, 0.015]), **fields)


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_a_pad_on_its_edge_has_a_pitch_however_its_rotation_was_rounded(up: float) -> None:
    d = (0.0, 0.0, 2.0)
    P = diagonal(d=0.01)
    P[WAVES[4, 0], WAVES[4, 0]] = 9.0
    b = belief((1.0 + 1e-9) * LEVEL, x=under(), P=P, sea=learned(t=T - 1000 * MS))
    seen = sighting(d, 0.0, pose6=whole(d, rpy_matrix(0.0, up * math.pi / 2, 0.0)))
    after, outcome = fuse_sighting(b, seen, TOOLS)
    assert outcome.innovation is not None
    assert len(outcome.innovation) == 6
    assert after.sea.t == T
    assert np.all(np.isfinite(after.sea.x))


# Reset and forgotten


@pytest.mark.parametrize("yaw", [None, 0.5])
def test_a_reset_belief_keeps_nothing_of_the_other_pad_s_vessel(yaw: float | None) -> None:
    b = belief(TILTED, x=state(), P=0.1 * correlated(), sea=learned(heave_m_s=0.4))
    b = b._replace(sea=b.sea._replace(sigma=np.array([0.3, 0.4, 0.5, 0.02, 0.03]), zeta=np.linspace(0.05, 0.2, 5)))
    seen = shown(b, yaw=yaw)
    seen = replace(seen, d_body_pad_level=seen.d_body_pad_level + np.array([3.0, 1.0, 0.5]))
    first, verdict = agrees(b, seen, TOOLS)
    assert verdict is Verdict.GATED
    streak = first.rejections._replace(n=6, since=T - 700 * MS)
    for chosen in (TOOLS, params(sigma_turn_rate_rad_s=0.03)):
        after, verdict = agrees(b._replace(rejections=streak), seen, chosen)
        assert verdict is Verdict.FUSED
        assert after.agreed == 1


@pytest.mark.parametrize(("t_s", "forgotten"), [(0.4, False), (0.5, False), (0.6, True)])
def test_a_pad_seen_in_the_first_instant_is_forgotten_like_any_other(t_s: float, forgotten: bool) -> None:
    t = round(t_s * 1e9)
    b = belief(t=t, x=under(), P=diagonal(d=0.01), sighted=0, agreed=7, t_imu=t - 5 * MS, f=(0.0, 0.0, -9.8))
    after, _ = agrees(b, imu(t, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8)), params(forget_s=0.5))
    assert (after.sighted, after.agreed) == ((-1, 0) if forgotten else (0, 7))


# The vehicle's own samples


def in_the_first_second(ms: int, **fields: Any) -> Belief:
    return belief(t=ms * MS, x=under(), P=diagonal(d=0.01), **fields)


@pytest.mark.parametrize("event", [Baro(stamp(20 * MS), 2.0, 0.1), Range(stamp(20 * MS), 2.0, 0.05)])
def test_a_height_over_a_pad_seen_in_the_first_instant_counts(event: Baro | Range) -> None:
    _, verdict = agrees(in_the_first_second(20, sighted=0), event, params(deck_radius_m=3.0))
    assert verdict is Verdict.FUSED


@pytest.mark.parametrize("lean_deg", [40.0, 60.0, 70.0])
def test_a_beam_that_meets_the_deck_ahead_of_a_tilting_body_is_a_range(lean_deg: float) -> None:
    lean = math.radians(lean_deg)
    b = belief(rpy_matrix(0.0, lean, 0.0), x=under(2.0 * math.tan(lean)), P=diagonal(d=1e-4))
    _, verdict = agrees(b, Range(stamp(T), 2.0 / math.cos(lean), 0.05), params(deck_radius_m=0.5))
    assert verdict is Verdict.FUSED


@pytest.mark.parametrize("later_ms", [0, 5, 19, 21, 60])
def test_an_imu_sample_of_the_first_instant_holds_as_long_as_any_other(later_ms: int) -> None:
    chosen = params(hold_s=0.02)
    b = in_the_first_second(5, t_imu=0, w=(0.3, -0.2, 0.5), f=(0.5, 1.0, -9.0))._replace(P=correlated())
    t = (5 + later_ms) * MS
    ours = PackedBelief.of(b).propagated(t, chosen, DL_WITH_COVARIANCE).belief
    same(ours, propagated_with_covariance(b, t, chosen))
    assert ours.x[VEL][0] == pytest.approx(0.0005 * min(later_ms, 15), rel=0.05), "no force is known after its time"


def test_no_time_changes_nothing_to_the_bit() -> None:
    b = belief(TILTED, x=state(), P=correlated(), jolt_var_m2_s2=0.3)
    after = PackedBelief.of(b).propagated(T, TOOLS, DL_WITH_COVARIANCE).belief
    assert after.P.tobytes() == b.P.tobytes()
    assert after.jolt_var_m2_s2 == b.jolt_var_m2_s2


@pytest.mark.parametrize(("ms", "widens"), [(1000, False), (1001, True)])
def test_a_sensor_refused_since_the_first_instant_is_accepted_after_a_second(ms: int, widens: bool) -> None:
    b = in_the_first_second(ms)
    aids = tuple([one._replace(refused=0) for one in b.aids])
    after, verdict = agrees(b._replace(aids=aids), Baro(stamp(ms * MS), 40.0, 0.1), TOOLS)
    assert verdict is Verdict.GATED
    assert bool(after.P[BARO_OFFSET, BARO_OFFSET] > 1.0) is widens


def test_a_kind_that_was_fused_is_not_fused_again_with_the_next_one() -> None:
    """One row in one call: between calls a snapshot forgets what was gathered and fused."""
    oracle, turn = belief(x=under(), P=correlated()), Rotation.from_rpy(0.01, -0.01, 0.0)
    row = [BodyVelocity(stamp(T + MS), np.zeros(3), np.eye(3)), Attitude(stamp(T + 6 * MS), turn, 1e-4 * np.eye(3))]
    together = PackedBelief.of(oracle).follow(TOOLS, [packed_event(event) for event in row])
    for event, made in zip(row, together, strict=True):
        oracle, _ = process_sample(oracle, event, TOOLS)
        same(made.belief, oracle)
    assert oracle.aids[VELOCITY].fused < oracle.aids[ATTITUDE].fused


# What a correction leaves, and a refusal


@pytest.mark.parametrize("later_ms", [0, 50])
def test_a_refusal_leaves_the_covariance_as_it_was_propagated(later_ms: int) -> None:
    b, t = belief(TILTED, x=state(), P=correlated()), T + later_ms * MS
    for event in (
        sighting((40.0, 0.0, 2.0), 0.5, t=t),
        VesselReport(stamp(t), np.array([40.0, 0.0, 0.0]), 1e-4 * np.eye(3), 0.5, 0.01),
    ):
        _, verdict = agrees(b, event, TOOLS)
        assert verdict is Verdict.GATED


def test_a_row_ends_before_an_event_of_a_kind_that_is_none() -> None:
    known = packed_event(imu(T + MS, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8)))
    strange = PackedEvent(struct.pack("q", 99) + known.record[8:])
    together = PackedBelief.of(belief()).follow(TOOLS, [known, strange, known])
    assert len(together) == 1


@pytest.mark.parametrize(("off_m", "scale"), [(0.2, 3.0), (-0.2, 0.2)])
def test_a_velocity_sensor_s_scale_stays_within_what_one_can_be_wrong_by(off_m: float, scale: float) -> None:
    P = diagonal(d=0.01)
    P[VEL_SCALE, VEL_SCALE] = 100.0
    P[VEL_SCALE, POS_REL.start + 2] = P[POS_REL.start + 2, VEL_SCALE] = 0.9
    after, outcome = flown_outcome(belief(x=under(), P=P), sighting((0.0, 0.0, 2.0 + off_m)))
    assert outcome.verdict is Verdict.FUSED
    assert after.x[VEL_SCALE] == scale
    assert not after.x[ATT_ERR].any(), "the attitude has taken its error up"


# What a sighting says of the heading


@pytest.mark.parametrize("pose6", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_the_noise_of_a_sighting_is_symmetric_to_the_bit(seed: int, pose6: bool) -> None:
    A = np.random.default_rng(seed).normal(size=(6, 6))
    cov = 1e-4 * (A @ A.T)
    cov = 0.5 * (cov + cov.T)
    d = np.array([0.7, -0.4, 2.5])
    seen = sighting(d, 0.3, pose6=whole(d, rpy_matrix(0.02, 0.1, -0.5), cov) if pose6 else None)
    seen = replace(seen, cov=cov[:4, :4])
    found = flown.sighting(state(), TILTED, (0.2, -0.1, 0.3), seen, rpy_matrix(0.1, -0.1, 0.7), 1e-7 * cov[:3, :3], 0.1)
    assert found.R.tobytes() == found.R.T.copy().tobytes()


@pytest.mark.parametrize(("var", "counts"), [(1.99, True), (2.0, False), (3.9, False)])
def test_a_heading_is_none_beyond_a_variance(var: float, counts: bool) -> None:
    b = belief(TILTED, x=state(), P=correlated())
    _, outcome = flown_outcome(b, shown(b, yaw=-0.7, yaw_var=var))
    assert len(outcome.innovation) == (4 if counts else 3)


@pytest.mark.parametrize(("sigma", "used"), [(0.49, True), (0.5, True), (0.51, False), (0.99, False)])
def test_one_of_two_headings_is_chosen_by_a_heading_that_is_known(sigma: float, used: bool) -> None:
    b = belief(x=under(), P=diagonal(d=0.01, head=sigma**2))
    _, outcome = flown_outcome(b, sighting((0.0, 0.0, 2.0), 0.1, ambiguous=True))
    assert len(outcome.innovation) == (4 if used else 3)


@pytest.mark.parametrize("turned", [0.0, 1.5, 1.6, 3.1, -1.5, -1.6])
@pytest.mark.parametrize("pose6", [False, True])
def test_of_two_opposite_headings_the_nearer_one_is_meant(turned: float, pose6: bool) -> None:
    x = under()
    x[PAD_YAW] = 0.3
    b = belief(x=x, P=diagonal(d=0.01, head=0.2))
    d, R = (0.01, 0.02, 2.0), rpy_matrix(0.02, -0.01, 0.0) @ about_down(0.3 + turned)
    seen = sighting(d, wrap_pi(-0.3 - turned), ambiguous=True, pose6=whole(d, R) if pose6 else None)
    _, outcome = flown_outcome(b, seen)
    wrong = math.remainder(turned, math.pi)
    assert abs(outcome.innovation[-1]) == pytest.approx(abs(wrong), abs=0.05)


def flown_outcome(b: Belief, seen: Sighting) -> tuple[Belief, Any]:
    """Hold the core to the oracle; return the core's outcome."""
    agrees(b, seen, TOOLS)
    return fuse_sighting(b, seen, TOOLS)
