import math
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from companion.base.mission import Event
from companion.guidance.controller import Knowledge, Target
from companion.guidance.landing import LandingGuidance
from companion.guidance.law.controllers import ControllerSetup, make_controller
from companion.guidance.law.follow_deck import FollowDeck
from companion.guidance.law.pid import PidController
from companion.guidance.law.policy import PolicyController
from companion.guidance.pilot import field_of_view, law_of, make_pilot
from companion.settings.guidance import GuidanceOptions, response_from_mapping
from companion.settings.load import camera_model, from_mapping, load, read_toml, response_model
from decklander.place import SHIPPED
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation, Transform
from estimator.contracts.motion import G_M_S2
from estimator.vision.camera.camera import Camera
from tests.make import body, deck, estimate, ns, status

SETTINGS = load("sim")
RESPONSE = response_model(SETTINGS)


@pytest.mark.parametrize(("name", "kind"), [("follow_deck", FollowDeck), ("pid", PidController)])
def test_the_setting_chooses_the_law(name: str, kind: type) -> None:
    guidance = GuidanceOptions(controller=name)
    assert isinstance(law_of(structs.replace(SETTINGS, guidance=guidance))(guidance), kind)


def over_the_pad() -> LandingGuidance:
    landing = make_pilot(SETTINGS).landing
    landing.on_samples([status(0.0, flying=True)])
    landing.order(Event.BEGIN)
    return landing


def pushed(landing: LandingGuidance, n: int) -> Command | None:
    """Return the command of a cycle over the pad that a steady wind pushes by 3 m/s^2 forward, held by as much lean."""
    t = 0.02 * n
    leaning = Rotation.from_rpy(0.0, math.atan(3.0 / G_M_S2), 0.0)
    return landing.command(Knowledge(ns(t), estimate(t, [0.0, 0.0, 2.0]), body(t, reported=leaning), deck(t)))


@pytest.mark.parametrize("key", ["tries.give_up_after_s", "pid.speed_max_m_s", "follow_deck.climb_max_m_s"])
def test_a_parameter_that_is_written_in_flight_makes_the_law_forget_nothing_of_the_wind(key: str) -> None:
    """WHY: any PARAM_SET took the trim from 3.8 m/s^2 to 0 for a cycle, low over the deck, and saturated the next command."""
    landing = over_the_pad()
    before = [pushed(landing, n) for n in range(200)][-1]
    section, name = key.split(".")
    table = getattr(SETTINGS.guidance, section)
    changed = structs.replace(table, **{name: 0.9 * getattr(table, name)})
    landing.retune(structs.replace(SETTINGS.guidance, **{section: changed}))
    after = pushed(landing, 200)
    assert before.trim_level[0] < -2.5
    assert after.trim_level == pytest.approx(before.trim_level, abs=0.05)
    assert after.a_level == pytest.approx(before.a_level, abs=0.2)


def test_another_law_begins_with_a_memory_of_its_own() -> None:
    landing = over_the_pad()
    assert isinstance([pushed(landing, n) for n in range(20)][-1], Lean)
    landing.retune(structs.replace(SETTINGS.guidance, controller="pid"))
    assert isinstance(pushed(landing, 20), Velocity)


def test_a_controller_that_is_not_installed_is_refused_with_those_that_are() -> None:
    with pytest.raises(BadInput, match=r"no controller 'bang_bang'; known are follow_deck,.* pid, policy"):
        make_controller(ControllerSetup(GuidanceOptions(controller="bang_bang"), RESPONSE))


def test_a_way_flown_at_the_targets_own_limits_leaves_nothing_in_the_integrals_of_the_pid() -> None:
    law = PidController(GuidanceOptions().pid)
    memory = law.start()
    target = Target(np.array([0.0, 0.0, 2.0]), speed_max_m_s=0.4, vertical_rate_max_m_s=0.2)
    for n in range(500):
        far = Knowledge(ns(0.02 * n), estimate(0.02 * n, [0.8, 0.0, 2.4]))
        memory, command = law.step(memory, far.at, far, target)
        assert isinstance(command, Velocity)
        assert command.v_level == pytest.approx([0.4, 0.0, 0.2], abs=1e-9)
    there = Knowledge(ns(10.0), estimate(10.0, [0.0, 0.0, 2.0]))
    _, command = law.step(memory, there.at, there, target)
    assert isinstance(command, Velocity)
    assert command.v_level == pytest.approx([0.0, 0.0, 0.0], abs=0.01)


def test_settings_that_name_no_response_are_refused() -> None:
    table = {"vehicle": {"kind": "ardrone"}, "camera": {"file": "sim"}, "pad": {"file": "thesis"}}
    settings = from_mapping({**table, "guidance": {"follow_deck": {"response": "ardrone3"}}}, "rig.toml")
    with pytest.raises(BadInput, match="did you mean 'ardrone2'"):
        response_model(settings)


def test_the_field_of_view_is_in_the_body_axes_whatever_way_the_camera_is_turned() -> None:
    def camera(turn_deg: float, tilt_deg: float = 0.0) -> Camera:
        R = Rotation.from_rpy(math.radians(tilt_deg), 0.0, math.radians(turn_deg))
        given = camera_model(SETTINGS)
        return replace(given, T_body_cam=Transform(R, given.T_body_cam.t))

    nose_up, sideways = field_of_view(camera(90.0)), field_of_view(camera(0.0))
    assert (nose_up.half_forward_rad, nose_up.half_right_rad) == (sideways.half_right_rad, sideways.half_forward_rad)
    assert math.degrees(nose_up.half_forward_rad) == pytest.approx(25.6, abs=0.1)
    assert field_of_view(camera(90.0, 60.0)) is None


@pytest.mark.parametrize("profile", ["raspberry_ardupilot", "raspberry_px4"])
def test_an_autopilot_is_flown_by_the_law_that_follows_the_deck_with_the_nose_on_the_arrow(profile: str) -> None:
    settings = load(profile)
    assert isinstance(law_of(settings)(settings.guidance), FollowDeck)
    assert (settings.guidance.mission, settings.guidance.tries.heading) == ("cone", "align")


# The controller `policy`


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
