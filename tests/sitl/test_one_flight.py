"""One flight is a function of scenario, seed, settings and perception."""

import re

import pytest

from companion.base.mission import FlightOutcome, State
from companion.cli import main as cli
from companion.settings.load import load as load_settings
from estimator.contracts.errors import BadInput
from sitl.campaign.summary import CampaignTally, in_words
from sitl.flight.grade import Grade
from sitl.flight.one_flight import TRUTH_EACH, FlyOptions, perception_level, settings_for
from sitl.scenario.scenario import load
from sitl.scenario.with_fault import faulty
from sitl.world.truth import Truth
from tests.fly import land, near, new_flight


def test_the_same_arguments_give_the_same_ending() -> None:
    scenario = near(duration_limit_s=1.0)
    truth: list[Truth] = []
    first = land(scenario, 3, level="pixels", options=FlyOptions(on_truth=truth.append)).as_json()
    again = land(scenario, 3, level="pixels", options=FlyOptions(render_beside=True)).as_json()
    assert first.pop("cpu_s") > 0
    again.pop("cpu_s")
    assert first == again
    assert first["outcome"] == "time ran out"
    reported = [sample.at for sample in truth]
    assert reported == sorted(reported)
    assert len(reported) >= 200 // TRUTH_EACH, "one each 20 ms, and one at each exposure"
    assert reported[-1] == 1_000_000_000, "the last one at the end"
    assert land(scenario, 4, level="pixels").as_json()["seed"] == 4


def test_the_settings_take_the_scenarios_camera_and_pad_unless_a_file_is_given() -> None:
    scenario = near(duration_limit_s=1.0, pad={"file": "printed"}, camera={"file": "photos"})
    settings = settings_for(scenario, None)
    assert (settings.pad.file, settings.camera.file) == ("printed", "photos")
    assert settings_for(scenario, "sim") == load_settings("sim")
    assert load_settings("ardrone2").guidance.start == "signal"
    assert settings_for(scenario, "ardrone2").guidance.start == "automatic", "nobody orders the landing"


def test_an_unknown_level_of_perception_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(BadInput, match="known are pixels"):
        perception_level("thoughts")
    assert cli.main(["simulate", "calm", "--perception", "thoughts"]) == 2
    output = capsys.readouterr().err
    assert "--perception: there is no level 'thoughts'; known are pixels" in output
    assert output.count("\n") == 1


def test_what_is_flown_on_without_a_link_is_reported_and_is_no_blind_descent() -> None:
    """The drone holds its last command for two seconds, in a descent that no order could end."""
    lost = {"kind": "link_lost", "below_height_m": 1.7, "for_s": 2.5}
    scenario = near(faults=[lost], expect="either", because="it hovers by itself", duration_limit_s=9.0)
    ending = land(scenario, 3)
    assert ending.judged is not None
    assert ending.judged.unsafe == ()
    assert "while nothing reached it" in ending.judged.because


def test_a_question_to_the_operator_that_is_open_when_time_ends_is_a_refusal() -> None:
    scenario = near(duration_limit_s=1.0, expect="either", because="somebody is asked")
    settings = settings_for(scenario, None)
    flight = new_flight(scenario, 3, settings=settings)
    flight.world.guidance_phase = "descend"
    assert flight.result().grade is Grade.FAILED
    flight.world.guidance_phase = State.ANOTHER_PAD.value
    assert flight.result().grade is Grade.REFUSED_RIGHTLY


def test_a_flight_whose_guidance_still_tries_goes_on_in_overtime_and_no_other() -> None:
    """WHY: a soak cut flights in their third try and called them failed."""
    scenario = near(duration_limit_s=2.0)
    times = (FlyOptions(overtime_s=longer_s) for longer_s in (0.0, 30.0))
    cut, whole = (land(scenario, 3, options=options) for options in times)
    assert (cut.outcome, cut.duration_s) == (None, 2.0)
    assert whole.outcome is FlightOutcome.LANDED
    held = [{"kind": "operator", "order": "hold", "at_s": 1.0}]
    paused = near(duration_limit_s=2.0, faults=held, expect="hold", because="a person holds it")
    assert land(paused, 3, options=FlyOptions(overtime_s=30.0)).duration_s == 2.0


def test_a_link_lost_in_the_descent_ends_on_the_pad_and_what_touched_meanwhile_is_reported() -> None:
    """WHY: it landed by itself up to 1.8 m beside the pad, while guidance took itself to be two metres up."""
    scenario = faulty(load("demo"), 5069, possible=lambda _: True, name="link_lost_4_s")
    ending = land(scenario, 5069)
    assert ending.judged is not None
    assert ending.outcome is FlightOutcome.LANDED
    assert ending.judged.unsafe == ()
    assert ending.judged.contacts_outside_commit == 1, "two seconds with the last command end on the deck; it is counted"
    assert re.search("touched the (deck|pad)", ending.judged.because)


def test_a_sea_that_rises_faster_than_the_drone_climbs_does_not_reach_it_at_the_gate() -> None:
    scenario = load("sea_state_5")
    ending = land(scenario, 204)
    assert ending.judged is not None
    assert ending.judged.contacts_outside_commit == 0
    assert ending.outcome in (FlightOutcome.LANDED, FlightOutcome.REFUSED), "a deck that outruns the climb is refused"


def test_a_campaign_counts_the_flights_in_which_a_sensor_was_named() -> None:
    stuck = {"kind": "accelerometer", "at_s": 1.0, "frozen": True}
    flights = [land(near(duration_limit_s=2.0, faults=faults), 3, level="model").as_json() for faults in ([], [stuck])]
    assert flights[0]["named"] == []
    (named,) = flights[1]["named"]
    assert named["text"] == "the accelerometer repeats its readings; flying without it"
    assert 1.0 < named["at_s"] < 1.3
    counted = CampaignTally()
    for flight in flights:
        counted.take({**flight, "hash": ""})
    summary = counted.summary("near", "model", 1.0)
    assert (summary["flights_naming_a_sensor"], summary["named_sensors"]) == (1, {"accelerometer": 1})
    assert "flights in which a sensor was named: 1 (accelerometer in 1)" in in_words(summary)
