"""The judgement on simulated flights: what counts as true sight, as a blind descent, as unsafe, and as the right outcome."""

from typing import Literal

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import FlightOutcome
from companion.guidance.arbiter import BY_HAND, LANDING_FOR_PERSON
from companion.settings.guidance import GuidanceOptions, PidOptions
from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import Rotation
from estimator.contracts.time import MonoNs, after
from sitl.flight.safety import (
    RECEIVERS_M,
    AtEnd,
    BlindDescent,
    Grade,
    MotionWatch,
    SightWatch,
    UnreachedContacts,
    called_for_m,
    dangers,
    grade,
    on_pad_m,
    outside_commit,
    unreached_descent_max_m,
)
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.truth import Touchdown, Truth

START = MonoNs(0)
SAFE = BlindDescent(0.2, 0.2, 1.4)


def truth(
    at_s: float,
    height_m: float,
    deck_up_m: float = 0.0,
    phase: VehiclePhase = VehiclePhase.FLYING,
    *,
    deck_falls_m_s: float = 0.0,
) -> Truth:
    level = Rotation.identity()
    deck, body = np.array([0.0, 0.0, -deck_up_m]), np.array([0.0, 0.0, -deck_up_m - height_m])
    v_deck = np.array([0.0, 0.0, deck_falls_m_s])
    return Truth(after(START, at_s), body, np.zeros(3), level, deck, v_deck, level, phase, None)


def contact(surface: Literal["pad", "deck", "water"], lateral_m: float = 0.1, phase: str | None = "commit") -> Touchdown:
    return Touchdown(START, surface, np.zeros(3), lateral_m, 0.0, 0.4, 0.0, VehiclePhase.LANDING, True, phase)


def watched(frames: list[tuple[float, Verdict, bool, float]], heights: list[tuple[float, float]]) -> SightWatch:
    watch = SightWatch(START)
    for at_s, verdict, true_view, error_s in frames:
        watch.frame(after(START, at_s), verdict, true_view=true_view, stamp_error_s=error_s)
    for at_s, height_m in heights:
        watch.step(truth(at_s, height_m))
    return watch


DOWN = [(0.5 * n, 3.0 - 0.25 * n) for n in range(11)]
"""Descent from 3 m to 0.5 m in 5 s."""


def test_a_descent_in_true_sight_is_none_and_on_dead_frames_it_is_one() -> None:
    seen = SightWatch(START)
    for at_s, height_m in DOWN:
        seen.frame(after(START, at_s), Verdict.FUSED, true_view=True, stamp_error_s=0.0)
        seen.step(truth(at_s, height_m))
    assert seen.worst.descent_m == 0.0
    blind = watched([], DOWN).worst
    assert blind.descent_m == pytest.approx(3.0 - 0.25 * 3 - 0.5), "counted from one second without sight on"
    assert blind.lowest_m == 0.5
    assert blind.blind_s == 5.0


@pytest.mark.parametrize(
    ("verdict", "true_view", "error_s"),
    [(Verdict.FUSED, False, 0.0), (Verdict.GATED, True, 0.0), (Verdict.NO_PAD, True, 0.0), (Verdict.FUSED, True, -2.0)],
)
def test_frames_that_show_nothing_true_or_are_refused_are_no_sight(verdict: Verdict, true_view: bool, error_s: float) -> None:
    watch = watched([(4.0, verdict, true_view, error_s)], DOWN)
    assert watch.worst.descent_m > 1.0
    assert watch.since_sight == {verdict: 1}
    assert watched([(4.0, Verdict.FUSED, True, 0.3)], DOWN).worst.descent_m == 0.0


def test_a_descent_while_nothing_reaches_the_vehicle_is_kept_apart() -> None:
    """An AR.Drone flies on with its last command for two seconds; no order of the service could end that."""
    watch, back = SightWatch(START), SightWatch(START)
    for at_s, height_m in DOWN:
        watch.step(truth(at_s, height_m), reached=at_s < 2.5)
    assert watch.worst.descent_m == pytest.approx(0.25), "from one second without sight until nothing reached it"
    assert watch.unreached_m == pytest.approx(1.25)
    for at_s, height_m in DOWN:
        back.step(truth(at_s, height_m), reached=not 2.0 <= at_s < 4.0)
    assert back.unreached_m == pytest.approx(0.75)
    assert back.worst.descent_m == pytest.approx(3.0 - 0.25 * 3 - 0.5 - 1.0), "what it did alone is not charged"
    assert dangers(SAFE, [], None, 1.7, 1.7) == ()
    assert dangers(SAFE, [], None, 1.71, 1.7) == ("came down 1.71 m while nothing reached it",)


def test_what_an_unreached_vehicle_may_come_down_follows_from_its_own_timeout_and_the_fastest_way_down() -> None:
    cone, thesis = GuidanceOptions(), GuidanceOptions(mission="thesis")
    assert unreached_descent_max_m(cone, 2.0) == pytest.approx(2.0 * cone.cone.descent_rate_m_s + 0.3)
    assert unreached_descent_max_m(cone, 1.0) == pytest.approx(cone.cone.descent_rate_m_s + 0.3)
    assert unreached_descent_max_m(thesis, 2.0) == pytest.approx(2.0 * thesis.thesis.speed_m_s + 0.3)
    slow = GuidanceOptions(controller="pid", pid=PidOptions(descent_rate_max_m_s=0.2))
    assert unreached_descent_max_m(slow, 2.0) == pytest.approx(0.7)


def test_a_last_command_that_followed_a_falling_deck_takes_an_unreached_vehicle_so_much_lower() -> None:
    watch = SightWatch(START)
    for at_s, reached, falls_m_s in (
        (0.0, True, 0.4),
        (0.1, False, 0.05),
        (0.5, False, 0.1),
        (0.7, False, 0.4),
        (0.8, True, 0.4),
        (0.9, False, -0.2),
    ):
        watch.step(truth(at_s, 2.0, deck_falls_m_s=falls_m_s), reached=reached)
    assert watch.deck_fell_m_s == pytest.approx(0.1)
    assert unreached_descent_max_m(GuidanceOptions(), 2.0, 0.1) == pytest.approx(
        2.0 * (GuidanceOptions().cone.descent_rate_m_s + 0.1) + 0.3
    )


def test_a_heaving_deck_under_a_hovering_vehicle_is_no_descent() -> None:
    watch = SightWatch(START)
    for n in range(40):
        up = 1.0 * np.sin(0.3 * n)
        watch.step(truth(0.5 * n, 2.0 - up, deck_up_m=up))
    assert watch.worst.descent_m == pytest.approx(0.0, abs=1e-9)


def test_a_contact_that_no_order_could_prevent_is_distinguished() -> None:
    """WHAT: the link is lost from 1 s to 4 s; contacts before, then, in the landing begun then, and long after."""

    def touched(at_s: float, phase: VehiclePhase = VehiclePhase.FLYING, surface: Literal["deck", "water"] = "deck") -> Touchdown:
        return Touchdown(after(START, at_s), surface, np.zeros(3), 0.5, 0.0, 0.4, 0.0, phase, True, "hold blind")

    def unreached(*contacts: Touchdown, landing: tuple[float, float] = (0.0, 0.0)) -> list[MonoNs]:
        watch = UnreachedContacts()
        for n in range(200):
            t = 0.05 * n
            phase = VehiclePhase.LANDING if landing[0] < t < landing[1] else VehiclePhase.FLYING
            now = replace(truth(t, 1.0), phase=phase, contacts=tuple(c for c in contacts if c.at <= after(START, t)))
            watch.step(now, reached=not 1.0 <= t < 4.0)
        return watch.at

    before, then, climbing, late = (touched(t) for t in (0.5, 2.0, 4.5, 6.0))
    assert unreached(before, then, climbing, late) == [then.at, climbing.at]
    down = touched(6.0, VehiclePhase.LANDING)
    assert unreached(down, landing=(3.9, 6.02)) == [down.at], "in the landing that it began without us"
    assert unreached(down, landing=(5.5, 6.02)) == [], "that landing somebody ordered"
    strays = [then, touched(2.5, surface="water")]
    assert dangers(SAFE, strays, None, unreached=[c.at for c in strays]) == (
        "in the water, 0.50 m from the pad's centre, outside commit (hold blind)",
    )
    assert len(dangers(SAFE, strays, None)) == 2, "where the scenario does not allow it"
    put = grade(FlightOutcome.LANDED_BY_OTHERS, None, (), "either", AtEnd(put_down=True))
    assert put == (Grade.REFUSED_RIGHTLY, "landed by itself while nothing reached it")


def test_dangers_name_contacts_beside_the_pad_descents_without_sight_and_a_dead_service() -> None:
    assert dangers(SAFE, [contact("pad")], None) == ()
    output = dangers(BlindDescent(1.3, 0.2, 5.2), [contact("deck", 0.48), contact("water", 2.5)], "KeyError: 'x' (pilot.py:3)")
    assert output == (
        "the service died in flight: KeyError: 'x' (pilot.py:3)",
        "came down 1.30 m, to 0.20 m over the deck, without true sight of the pad for 5.2 s",
        "touched the deck 0.48 m from the pad's centre",
        "in the water, 2.50 m from the pad's centre",
    )


def test_contacts_outside_commit_are_those_with_motors_that_neither_guidance_nor_a_person_intends() -> None:
    still = Touchdown(START, "pad", np.zeros(3), 0.1, 0.0, 0.4, 0.0, VehiclePhase.EMERGENCY, False, "descend")
    strays = [contact("pad", phase="descend"), contact("pad", phase=None)]
    meant = [contact("pad"), contact("pad", phase=LANDING_FOR_PERSON), contact("pad", phase=BY_HAND), still]
    assert outside_commit([*strays, *meant]) == 2
    assert dangers(SAFE, meant, None) == ()
    assert dangers(SAFE, [*strays, *meant], None) == (
        "touched the pad 0.10 m from the pad's centre, outside commit (descend)",
        "touched the pad 0.10 m from the pad's centre, outside commit (no service)",
    )
    assert dangers(SAFE, strays, None, phases_known=False) == (), "a drone of its own process does not know what guidance is at"
    worth, because = grade(FlightOutcome.LANDED, 0.1, dangers(SAFE, [strays[0], contact("pad")], None), "land")
    assert (worth, because) == (Grade.FAILED, "touched the pad 0.10 m from the pad's centre, outside commit (descend)")


@pytest.mark.parametrize(
    ("outcome", "contacts", "expect", "worth"),
    [
        (FlightOutcome.LANDED, ["pad"], "land", Grade.ON_PAD),
        (FlightOutcome.LANDED, ["pad"], "refuse", Grade.ON_PAD),
        (FlightOutcome.LANDED, ["deck"], "either", Grade.FAILED),
        (FlightOutcome.LANDED, [], "either", Grade.FAILED),
        (FlightOutcome.GAVE_UP, [], "refuse", Grade.REFUSED_RIGHTLY),
        (FlightOutcome.GAVE_UP, [], "either", Grade.REFUSED_RIGHTLY),
        (FlightOutcome.GAVE_UP, [], "land", Grade.FAILED),
        (FlightOutcome.GAVE_UP, ["water"], "refuse", Grade.FAILED),
        (FlightOutcome.EMERGENCY, [], "refuse", Grade.FAILED),
        (FlightOutcome.LANDED_BY_OTHERS, ["pad"], "either", Grade.FAILED),
        (None, [], "refuse", Grade.FAILED),
    ],
)
def test_a_flight_is_worth_what_its_scenario_expects(outcome, contacts, expect, worth):
    touched = [contact(surface) for surface in contacts]
    given, because = grade(outcome, on_pad_m(touched), dangers(SAFE, touched, None), expect)
    assert given is worth
    assert because


def test_without_a_service_hovering_on_is_right() -> None:
    assert grade(None, None, (), "refuse", AtEnd(left_alone=True))[0] is Grade.REFUSED_RIGHTLY
    assert grade(None, None, ("in the water",), "refuse", AtEnd(left_alone=True))[0] is Grade.FAILED


def test_who_waits_for_the_operators_word_when_time_ends_has_refused() -> None:
    assert grade(None, None, (), "either", AtEnd(asks=True)) == (Grade.REFUSED_RIGHTLY, "hovered and waited for the operator")
    assert grade(None, None, (), "land", AtEnd(asks=True))[0] is Grade.FAILED
    assert grade(None, None, ("in the water",), "refuse", AtEnd(asks=True))[0] is Grade.FAILED
    assert grade(FlightOutcome.LANDED_BY_OTHERS, None, (), "either", AtEnd(asks=True))[0] is Grade.FAILED


def moved(
    samples: list[tuple[float, float, VehiclePhase]], phase: str | None = "descend", *, reached: bool = True
) -> MotionWatch:
    watch = MotionWatch(7.0, 0.1)
    for at_s, height_m, of in samples:
        watch.step(replace(truth(at_s, height_m, phase=of), contacts=(contact("pad"),)), phase, reached=reached)
    return watch


FLIES, LANDED = VehiclePhase.FLYING, VehiclePhase.LANDED


def test_a_climb_that_nobody_calls_for_is_unsafe_unless_a_person_or_nobody_commands() -> None:
    high = [(0.0, 5.0, FLIES), (1.0, 10.2, FLIES)]
    assert dangers(SAFE, (), None, motion=moved(high)) == ("flew 10.2 m high, where 7.0 m are the most that is called for",)
    assert dangers(SAFE, (), None, motion=moved([(0.0, 9.9, FLIES)])) == ()
    assert dangers(SAFE, (), None, motion=moved(high, BY_HAND)) == ()
    assert dangers(SAFE, (), None, motion=moved(high, None)) == ()
    assert dangers(SAFE, (), None, motion=moved(high, reached=False)) == ()


def moved_to(at_s: float, height_m: float, down_m: float) -> Truth:
    at = np.array([0.0, 0.0, down_m])
    return replace(truth(at_s, height_m), p_body_ned=at, p_pad_ned=np.array([0.0, 0.0, down_m + height_m]))


def test_a_deck_that_falls_away_below_makes_nobody_climb() -> None:
    watch = MotionWatch(7.0, 0.1)
    for at_s, height_m, down_m in ((0.0, 7.0, -9.0), (1.0, 10.9, -9.0), (2.0, 10.2, -11.9)):
        watch.step(moved_to(at_s, height_m, down_m), "search", reached=True)
    assert watch.unsafe == ()
    watch.step(moved_to(3.0, 10.2, -12.3), "search", reached=True)
    assert len(watch.unsafe) == 1


def test_a_vehicle_over_a_trough_is_as_high_as_it_is_over_the_crests() -> None:
    # Seed 8102 of weather_6: the deck goes from 1.3 m up to 6.6 m, and the vehicle with it; then the deck falls.
    watch = MotionWatch(7.0, 0.1)
    for at_s, deck_m, altitude_m in ((0.0, 1.3, 8.3), (6.0, 6.6, 12.2), (12.0, -1.3, 12.2)):
        watch.step(moved_to(at_s, altitude_m - deck_m, -altitude_m), "refused", reached=True)
    assert watch.highest_m == pytest.approx(7.0)
    assert watch.unsafe == ()
    watch.step(moved_to(18.0, 15.0, -16.7), "refused", reached=True)
    assert len(watch.unsafe) == 1


def test_standing_on_the_deck_with_turning_motors_is_unsafe_after_three_seconds() -> None:
    stands = [(0.5 * n, 0.12, FLIES) for n in range(8)]
    assert dangers(SAFE, (), None, motion=moved(stands, "press")) == ("stood on the deck for 3.5 s with turning motors",)
    assert dangers(SAFE, (), None, motion=moved(stands[:7], "press")) == ()
    hops = [(at_s, 0.5 if at_s == 2.0 else height_m, of) for at_s, height_m, of in stands]
    assert dangers(SAFE, (), None, motion=moved(hops, "press")) == ()
    assert dangers(SAFE, (), None, motion=moved([(at_s, h, LANDED) for at_s, h, _ in stands], "press")) == ()


def test_a_contact_that_slides_is_unsafe_on_the_pad_as_well() -> None:
    slides = replace(contact("pad"), lateral_speed_m_s=0.51)
    assert dangers(SAFE, (slides,), None) == ("touched the pad at 0.51 m/s along it",)
    assert dangers(SAFE, (replace(slides, lateral_speed_m_s=0.5),), None) == ()
    assert dangers(SAFE, (replace(slides, motors=False),), None) == ()
    assert dangers(SAFE, (replace(slides, guidance_phase=LANDING_FOR_PERSON),), None) == ()
    assert dangers(SAFE, (slides,), None, unreached=(slides.at,)) == ()


def test_the_highest_height_is_that_of_start_mission_and_go_around() -> None:
    options = GuidanceOptions()
    assert called_for_m(options, 7.0) == 7.0
    assert called_for_m(options, 0.0) == max(
        options.tries.safe_height_m, options.rendezvous.height_m * options.rendezvous.enabled
    )
    to_ship = replace(options, rendezvous=replace(options.rendezvous, enabled=True, height_m=12.0))
    assert called_for_m(to_ship, 3.0) == 12.0 + RECEIVERS_M
