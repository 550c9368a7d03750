"""A landing's lease, each of its ends at its edge."""

from __future__ import annotations

import numpy as np
import pytest

from companion.guidance.lease import NO_LANDING, Lease, renewed
from companion.guidance.plan import Plan, WayPoint
from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import MonoNs
from tests.companion.plans import planned

PLAN = planned(approach_height_m=3.0, final_height_m=0.5)
FINAL = PLAN.way_points[-1]


def at(seconds: float) -> MonoNs:
    return MonoNs(round(seconds * 1e9))


def belief(height_m: float, aside_m: float = 0.0) -> RelativeState:
    d = np.array([aside_m, 0.0, height_m])
    return RelativeState(at(0), "ekf", d, np.zeros(3), 0.0, np.eye(7) * 1e-4, at(0), True)


def ends(now_s: float, estimate: RelativeState | None, fit: RelativeState | None, *, height_m: float = 1.0) -> str | None:
    return renewed(Lease(at(0), 1.0, at(0), height_m), PLAN, at(now_s), estimate, fit)[1]


def test_it_ends_by_time() -> None:
    low = belief(0.1)
    assert ends(PLAN.guidance.land_timeout_s - 0.01, low, low) is None
    assert NO_LANDING in str(ends(PLAN.guidance.land_timeout_s + 0.01, low, low))


def test_it_ends_by_height() -> None:
    assert ends(0.1, belief(1.39), belief(1.39)) is None
    assert "rose" in str(ends(0.1, belief(1.41), belief(1.41)))
    assert ends(0.1, belief(-0.59), None, height_m=0.1) is None
    assert "past the deck" in str(ends(0.1, belief(-0.61), None, height_m=0.1))


def test_it_ends_where_the_pad_is_not_below() -> None:
    limit_m = FINAL.reached_m + 0.3 + float(abs(FINAL.d_body_pad_level[0]))
    assert ends(0.1, belief(0.5, limit_m - 0.01), belief(0.5, limit_m - 0.01)) is None
    assert "drifted" in str(ends(0.1, belief(0.5, limit_m + 0.01), belief(0.5, limit_m + 0.01)))


def test_it_ends_without_sight_above_the_blind_height_alone() -> None:
    blind_m = float(FINAL.d_body_pad_level[2]) + FINAL.reached_height_m + 0.1
    late_s = PLAN.guidance.stale_after_s + 0.01
    assert ends(PLAN.guidance.stale_after_s - 0.01, None, None, height_m=blind_m + 0.01) is None
    assert "was lost" in str(ends(late_s, None, None, height_m=blind_m + 0.01))
    assert ends(late_s, None, None, height_m=blind_m - 0.01) is None


def test_sight_renews_it() -> None:
    lease, why = renewed(Lease(at(0), 1.0, at(0), 1.0), PLAN, at(2.0), belief(0.7), belief(0.7))
    assert why is None
    assert (lease.seen, lease.height_m, lease.since) == (at(2.0), 0.7, at(0))


def test_what_lies_on_an_edge_goes_on() -> None:
    assert ends(PLAN.guidance.land_timeout_s, belief(0.1), belief(0.1)) is None
    assert ends(0.1, belief(-0.6), None, height_m=0.1) is None
    assert ends(0.1, belief(1.4), belief(1.4)) is None
    blind_m = float(FINAL.d_body_pad_level[2]) + FINAL.reached_height_m + 0.1
    assert ends(PLAN.guidance.stale_after_s, None, None, height_m=blind_m + 0.1) is None
    assert ends(PLAN.guidance.stale_after_s + 1.0, None, None, height_m=blind_m) is None
    limit_m = FINAL.reached_m + 0.3
    assert ends(0.1, belief(0.5, limit_m), belief(0.5, limit_m)) is None


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_camera_at_the_nose_has_the_pad_that_far_ahead_or_behind_over_the_last_way_point(sign: float) -> None:
    ahead = WayPoint(np.array([sign * 0.2, 0.0, 0.5]), reached_m=0.12, reached_height_m=0.12, dwell_s=0.2)
    plan, lease = Plan((ahead,)), Lease(at(0), 1.0, at(0), 1.0)
    for aside_m, drifted in ((0.6, False), (0.63, True)):
        seen = belief(0.5, sign * aside_m)
        assert (renewed(lease, plan, at(0.1), seen, seen)[1] is not None) is drifted
