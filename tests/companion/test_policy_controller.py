"""The controller `policy`: chosen by the setting, inside of the law's limits, and still without an estimate."""

import math

import numpy as np
import pytest
from msgspec import structs

from companion.guidance.controller import Knowledge, Target
from companion.guidance.controllers import ControllerSetup, make_controller
from companion.guidance.law.policy import PolicyController
from companion.settings.guidance import GuidanceOptions
from companion.settings.load import SHIPPED, load, read_toml, response_model
from companion.settings.response import response_from_mapping
from estimator.contracts.commands import Hover, Lean, Velocity
from estimator.contracts.errors import BadInput
from estimator.contracts.motion import G_M_S2
from tests.make import body, deck, estimate, ns

QUAD = response_from_mapping(read_toml(SHIPPED / "responses" / "quad_1_5kg.toml"), "quad_1_5kg")
OPTIONS = GuidanceOptions(controller="policy")
OPTIONS = structs.replace(OPTIONS, follow_deck=structs.replace(OPTIONS.follow_deck, response="quad_1_5kg"))


def knowledge(at_s: float, d: list[float]) -> Knowledge:
    return Knowledge(ns(at_s), estimate(at_s, d), body(at_s), deck(at_s))


def policy_commands(d: list[float], target: Target, cycles: int = 5) -> list[Lean]:
    law = make_controller(ControllerSetup(OPTIONS, QUAD))
    assert isinstance(law, PolicyController)
    memory, out = law.start(), []
    for n in range(cycles):
        memory, command = law.step(memory, ns(0.02 * n), knowledge(0.02 * n, d), target)
        assert isinstance(command, Lean)
        out.append(command)
    return out


@pytest.mark.parametrize(
    ("d", "axis", "sign"), [([0.5, 0, 1], 0, 1), ([-0.5, 0, 1], 0, -1), ([0, 0.5, 1], 1, 1), ([0, -0.5, 1], 1, -1)]
)
def test_it_leans_towards_the_pad(d: list[float], axis: int, sign: int) -> None:
    command = policy_commands(d, Target(np.array([0.0, 0.0, 1.0])))[0]
    assert sign * command.a_level[axis] > 0.3
    assert abs(command.a_level[1 - axis]) < abs(command.a_level[axis])


@pytest.mark.parametrize("far_m", [0.3, 3.0, 300.0])
def test_no_lean_is_larger_than_vehicle_and_target_allow(far_m: float) -> None:
    for allowed_deg, lean_max_rad in ((QUAD.tilt.max_deg, None), (3.0, math.radians(3.0)), (0.0, 0.0)):
        for command in policy_commands([far_m, -far_m, 2.0], Target(np.array([0.0, 0.0, 2.0]), lean_max_rad=lean_max_rad)):
            size = math.hypot(*(command.a_level + command.trim_level))
            assert size <= G_M_S2 * math.tan(math.radians(allowed_deg)) + 1e-9


@pytest.mark.parametrize("rate_m_s", [0.4, -0.5, None])
def test_heights_and_heading_are_the_law_s(rate_m_s: float | None) -> None:
    target = Target(np.array([0.0, 0.0, 0.8]), descent_rate_m_s=rate_m_s, yaw_rad=0.3)
    law = make_controller(ControllerSetup(structs.replace(OPTIONS, controller="follow_deck"), QUAD))
    memory = law.start()
    for n, command in enumerate(policy_commands([0.2, 0.1, 1.0], target)):
        memory, own = law.step(memory, ns(0.02 * n), knowledge(0.02 * n, [0.2, 0.1, 1.0]), target)
        assert isinstance(own, Lean)
        assert (command.v_level[2], command.yaw_rate_rad_s) == (own.v_level[2], own.yaw_rate_rad_s)


def test_without_target_or_estimate_it_hovers_and_without_the_deck_the_law_flies() -> None:
    law = make_controller(ControllerSetup(OPTIONS, QUAD))
    known, target = knowledge(0.0, [0.5, 0.0, 2.0]), Target(np.array([0.0, 0.0, 2.0]))
    blind = structs.replace(known, relative=None)
    assert isinstance(law.step(law.start(), ns(0.0), blind, target)[1], Hover)
    assert isinstance(law.step(law.start(), ns(0.0), known, None)[1], Hover)
    assert isinstance(law.step(law.start(), ns(0.0), structs.replace(known, deck=None), target)[1], Lean)
    assert isinstance(law.step(law.start(), ns(0.0), structs.replace(known, deck=None, body=None), target)[1], Velocity)
    assert law.ahead(law.start(), known, 0.3) is None


def test_another_vehicle_period_or_kind_of_command_is_refused() -> None:
    slow = structs.replace(QUAD, tilt=structs.replace(QUAD.tilt, delay_s=0.25))
    for setup, said in (
        (ControllerSetup(OPTIONS, slow), "another vehicle"),
        (ControllerSetup(structs.replace(OPTIONS, rate_hz=100.0), QUAD), "rate_hz = 50"),
        (ControllerSetup(OPTIONS, QUAD, over_ground=True), "takes velocities"),
        (ControllerSetup(GuidanceOptions(controller="policy"), response_model(load("sim"))), "no policy ships"),
    ):
        with pytest.raises(BadInput, match=said):
            make_controller(setup)
