"""Output of `decklander simulate` on a flight, for people and for machines."""

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import FlightOutcome
from companion.cli import main as cli
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs
from sitl.flight.ending import Ending, FlightGrade, Grade
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.truth import Touchdown
from tests.fly import NEAR

STRIKE = Touchdown(
    MonoNs(9_500_000_000), "deck", np.zeros(3), 0.48, 0.5, 0.56, 0.05, VehiclePhase.FLYING, guidance_phase="descend"
)
LANDING = Touchdown(MonoNs(15_000_000_000), "pad", np.zeros(3), 0.081, 0.5, 0.41, 0.02, guidance_phase="land")
STRUCK = "touched the deck 0.48 m from the pad's centre"
JUDGED = FlightGrade(Grade.FAILED, STRUCK, (STRUCK,), None, 1, 0.31, 0, (("frames_frozen", 6.2),), "refuse", 30.0)
ENDING = Ending(
    "rough", 3, FlightOutcome.LANDED, (STRIKE, LANDING), 15.2, Counter({Verdict.FUSED: 400}), MonoNs(500_000_000), JUDGED
)


def test_every_contact_and_what_was_unsafe_is_reported() -> None:
    reported = ENDING.as_json()
    assert json.loads(json.dumps(reported)) == reported
    assert [(c["at_s"], c["surface"], c["phase"], c["motors"]) for c in reported["contacts"]] == [
        (9.0, "deck", "descend", True),
        (14.5, "pad", "land", True),
    ]
    assert reported["touchdown"]["lateral_m"] == 0.081
    assert (reported["landed_on_pad"], reported["in_water"], reported["contacts_outside_commit"]) == (True, False, 1)
    assert (reported["refused"], reported["grade"]) == (None, "failed")
    assert reported["faults"] == [{"kind": "frames_frozen", "at_s": 6.2}]
    assert ENDING.in_words().splitlines() == [
        "landed after 14.5 s, on the pad: 8.1 cm from its centre, descending at 0.41 m/s, sliding at 0.02 m/s",
        "before that, at 9.0 s, on deck, off the pad: 48.0 cm from its centre, descending at 0.56 m/s, sliding at 0.05 m/s "
        "(guidance: descend)",
        "fault: frames_frozen from 6.2 s on",
        "UNSAFE: touched the deck 0.48 m from the pad's centre",
    ]
    assert dict(ENDING.facts())["contact at 9.0 s"].startswith("on deck, off the pad: 48.0 cm")


def test_a_landing_after_a_strike_is_not_good_and_a_right_refusal_is() -> None:
    assert ENDING.on_pad
    assert not ENDING.good
    refused = FlightGrade(Grade.REFUSED_RIGHTLY, "gave up", (), "gave up; frames: 600 no_pad", 0, None, 0, (), "refuse", 30.0)
    ending = replace(ENDING, outcome=FlightOutcome.GAVE_UP, contacts=(), judged=refused)
    assert ending.good
    assert "refused: gave up; frames: 600 no_pad" in ending.in_words()
    assert replace(ENDING, judged=None).good, "without a judgement the pad alone decides"


def test_a_flight_by_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    near = tmp_path / "near.toml"
    text = NEAR.replace("duration_limit_s = 40.0", 'duration_limit_s = 1.0\nexpect = "refuse"')
    near.write_text(text + '[[faults]]\nkind = "lens_covered"\nat_s = 0.0\n')
    assert cli.main(["simulate", str(near), "--seed", "2", "--json"]) == 1
    reported = json.loads(capsys.readouterr().out)
    assert reported["because"] == "time ran out: it neither landed nor gave up"
    assert (reported["outcome"], reported["expect"]) == ("time ran out", "refuse")
    assert (reported["contacts"], reported["touchdown"]) == ([], None)
    assert reported["faults"] == [{"kind": "lens_covered", "at_s": 0.0}]
    assert reported["cpu_s"] > 0.0
    assert set(reported["frames"]) <= {"no_pad", "no_attitude"}


@pytest.mark.parametrize(
    ("key", "code", "said"),
    [
        ("guidance.follow_deck.response=nonesuch", 2, "guidance.follow_deck.response: there is no file 'nonesuch'"),
        (
            "vehicle.model=1.0",
            2,
            'vehicle.model is "1.0", and the scenario flies an AR.Drone 2.0: set vehicle.model = "2.0", or the scenario\'s '
            'vehicle.generation = "1.0" with camera.file = "ardrone1_bottom"',
        ),
        (
            "vehicle.further_configuration=control:outdoor=maybe",
            1,
            "the simulated drone refused the configuration key control:outdoor: bad_value",
        ),
    ],
)
def test_a_flight_that_is_refused_leaves_no_recording(tmp_path, capsys, key, code, said):
    path, older = tmp_path / "new.mcap", tmp_path / "older.mcap"
    older.write_bytes(b"as it was")
    for out, force in ((path, []), (older, ["--force"])):
        keys = "--set", "estimator.path=ekf", "--set", key
        assert cli.main(["simulate", "calm", "--perception", "truth", *keys, "--record", str(out), *force]) == code
        assert said in (err := capsys.readouterr().err)
        assert code == 2 or "estimator.path: without effect in a flight by --perception truth" in err
    assert not path.exists()
    assert older.read_bytes() == b"as it was"


def test_a_landing_on_fiducials(capsys: pytest.CaptureFixture[str]) -> None:
    """The frames are rendered from where the large fiducial is read to where only the small one and single cells are in view."""
    start = ["start.height_m=1.2", "start.pad_forward_m=0.1", "start.pad_right_m=0.1", "guidance.thesis.speed_m_s=0.3"]
    assert cli.main(["simulate", "calm", "--pad=apriltag_nest", "--seed=1", "--json", *(f"--set={key}" for key in start)]) == 0
    out, err = capsys.readouterr()
    assert 'guidance.thesis.speed_m_s: without effect, as guidance.mission is not "thesis"' in err
    reported = json.loads(out)
    assert reported["touchdown"]["lateral_m"] < 0.06
    assert abs(reported["touchdown"]["yaw_deg"]) < 3.0
    assert reported["frames"]["fused"] > 5 * reported["frames"].get("no_pad", 0)
