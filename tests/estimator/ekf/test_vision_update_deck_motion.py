"""What the bank of oscillators is shown of a sighting: where the pad was, how it stood, how well, and how often."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import F64, rpy_matrix
from estimator.ekf import deck_motion_bank
from estimator.ekf.params import FilterParams
from estimator.ekf.so3 import about_down, heading
from estimator.ekf.state import CAMERA_DELAY, CAMERA_MOUNT, VEL, Belief
from tests.estimator.ekf.hand import LEVEL, MS, TILTED, TOOLS, S, T, belief, diagonal, learned, sighting, under, whole
from tests.estimator.ekf.oracle import bank, so3, vision_update
from tests.estimator.ekf.oracle.vision_update import fuse_sighting


class Detection:
    """Stands where the sea's bank learns, and notes what it is shown."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.shown: list[tuple[int, F64, F64, deck_motion_bank.Carrying, float]] = []
        monkeypatch.setattr(bank, "observe", self._look)

    def _look(self, s: deck_motion_bank.DeckMotionBank, *shown: Any) -> deck_motion_bank.DeckMotionBank:
        self.shown.append(shown)
        return s._replace(t=shown[0])


def show(b: Belief, seen: Sighting, with_: FilterParams = TOOLS) -> Belief:
    row, _ = vision_update._compared(b, seen, with_)
    return vision_update._learned(b, seen, row, with_)


@pytest.mark.parametrize(("ago_ms", "looks"), [(170, 0), (179, 0), (181, 1), (200, 1)])
def test_the_sea_looks_five_times_a_second_at_most(monkeypatch: pytest.MonkeyPatch, ago_ms: int, looks: int) -> None:
    look = Detection(monkeypatch)
    b = belief(x=under(), P=diagonal(d=0.01), sea=learned(t=T - ago_ms * MS), ins_var_m2_s2=0.3)
    after, outcome = fuse_sighting(b, sighting((0.1, 0.0, 2.0)), TOOLS)
    assert outcome.verdict is Verdict.FUSED
    assert len(look.shown) == looks
    assert after.ins_var_m2_s2 == (0.0 if looks else 0.3)
    assert after.sea.t == (T if looks else T - ago_ms * MS)


def test_a_sea_never_looked_at_looks_and_one_looked_at_in_the_first_instant_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    look = Detection(monkeypatch)
    b = belief(t=0, x=under(), P=diagonal(d=0.01), sighted=0, sea=deck_motion_bank.unknown())
    show(b, sighting((0.1, 0.0, 2.0), t=0))
    assert len(look.shown) == 1
    show(b._replace(t=100 * MS, t_cov=100 * MS, sea=learned(t=0)), sighting((0.1, 0.0, 2.0), t=100 * MS))
    assert len(look.shown) == 1


def test_the_sea_is_shown_the_place_less_the_delay_s_part_and_how_far_away_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    look = Detection(monkeypatch)
    x = under(z=3.0)
    x[VEL], x[CAMERA_DELAY] = (1.0, -2.0, 0.5), 0.1
    propagated = np.array([10.0, 20.0, -30.0])
    show(belief(x=x, P=diagonal(d=0.01), sea=learned(t=T - S), ins_p=propagated), sighting((0.3, 0.4, 3.0)))
    ((t, y, var, by, reach_m),) = look.shown
    there = np.array([0.4, 0.2, 3.05])
    assert t == T
    np.testing.assert_allclose(y, [*(there + propagated), 0.0, 0.0], atol=1e-9)
    assert reach_m == pytest.approx(np.linalg.norm(there))
    np.testing.assert_allclose(var[:3], 1e-4, atol=1e-9)
    assert np.all(var[3:] >= 1e6), "how the deck stands was not seen"
    assert by is TOOLS.carrying


def test_the_sea_is_shown_north_east_down_and_the_noise_along_them(monkeypatch: pytest.MonkeyPatch) -> None:
    look = Detection(monkeypatch)
    R = about_down(0.6)
    x = under()
    x[CAMERA_MOUNT] = 0.05, -0.1, 0.2
    seen = replace(sighting((1.0, 0.0, 3.0)), cov=np.diag([0.01, 0.02, 0.03, 9.0]))
    show(belief(R, x=x, P=diagonal(d=0.01), sea=learned(t=T - S)), seen)
    ((_, y, var, _, _),) = look.shown
    back = R @ so3.exp(x[CAMERA_MOUNT])
    np.testing.assert_allclose(y[:3], back @ [1.0, 0.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(var[:3], np.diag(back @ np.diag([0.01, 0.02, 0.03]) @ back.T), atol=1e-12)


def test_the_sea_is_shown_roll_and_pitch_of_a_pad_seen_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    look = Detection(monkeypatch)
    R_level_pad = rpy_matrix(0.2, -0.3, 1.0)
    A = np.random.default_rng(5).normal(size=(6, 6))
    cov = 1e-4 * A @ A.T
    x = under()
    seen = sighting((0.0, 0.0, 2.0), -1.0, pose6=whole((0.0, 0.0, 2.0), R_level_pad, cov))
    show(belief(TILTED, x=x, P=diagonal(d=0.01), sea=learned(t=T - S)), seen)
    x[CAMERA_MOUNT] = 0.05, -0.1, 0.2
    show(belief(TILTED, x=x, P=diagonal(d=0.01), sea=learned(t=T - S)), seen)
    (_, y, var, _, _), (_, y_mounted, _, _, _) = look.shown
    np.testing.assert_allclose(y[3:], [0.2, -0.3], atol=1e-12)
    np.testing.assert_allclose(var[3:], np.diag(R_level_pad.T @ cov[3:, 3:] @ R_level_pad)[:2], atol=1e-12)
    mounted = TILTED @ so3.exp(x[CAMERA_MOUNT]) @ TILTED.T @ about_down(0.8) @ R_level_pad
    np.testing.assert_allclose(rpy_matrix(y_mounted[3], y_mounted[4], heading(mounted)), mounted, atol=1e-12)


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_a_pad_on_its_edge_has_a_pitch_however_its_rotation_was_rounded(monkeypatch: pytest.MonkeyPatch, up: float) -> None:
    look = Detection(monkeypatch)
    stretched = (1.0 + 1e-9) * LEVEL
    seen = sighting((0.0, 0.0, 2.0), 0.0, pose6=whole((0.0, 0.0, 2.0), rpy_matrix(0.0, up * math.pi / 2, 0.0)))
    show(belief(stretched, x=under(), P=diagonal(d=0.01), sea=learned(t=T - S)), seen)
    assert look.shown[0][1][4] == pytest.approx(up * math.pi / 2)


def test_a_velocity_that_became_doubtful_is_spread_over_the_time_since_the_last_look(monkeypatch: pytest.MonkeyPatch) -> None:
    look = Detection(monkeypatch)
    for t, var in ((T - 500 * MS, 0.02), (T - 500 * MS, 0.0), (-1, 0.02)):
        b = belief(x=under(), P=diagonal(d=0.01), sea=learned()._replace(t=t), ins_var_m2_s2=var)
        assert show(b, sighting((0.0, 0.0, 2.0))).ins_var_m2_s2 == 0.0
    (jolted, *others) = [shown[3] for shown in look.shown]
    known = TOOLS.carrying
    np.testing.assert_allclose(jolted.asd_accel**2 - known.asd_accel**2, [0.04, 0.04, 0.04, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(jolted.asd_drift, known.asd_drift)
    assert others == [known, known]
    b = belief(t=500 * MS, x=under(), P=diagonal(d=0.01), sea=learned(t=0), ins_var_m2_s2=0.02)
    show(b, sighting((0.0, 0.0, 2.0), t=500 * MS))
    assert look.shown[-1][3].asd_accel[0] > known.asd_accel[0]
