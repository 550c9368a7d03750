"""Identity of a campaign: the files behind its files, and settings that follow the scenario."""

from pathlib import Path

import pytest

from companion.settings.load import SHIPPED
from estimator.contracts.errors import BadInput
from sitl.campaign.overrides import Overridable
from sitl.campaign.plan import digest_of, make_plan
from sitl.flight.one_flight import settings_for
from sitl.scenario.scenario import load

ROWS = "time_s,surge_m,sway_m,heave_down_m,roll_deg,pitch_deg,yaw_deg\n"


def recorded(folder: Path, heave_m: float) -> Path:
    """Return a scenario on a vessel that moves as recorded."""
    rows = "".join(f"{0.5 * n},0,0,{heave_m if n == 7 else 0},0,0,0\n" for n in range(200))
    (folder / "motion.csv").write_text(ROWS + rows)
    (folder / "boat.toml").write_text(
        'title = "boat"\nsource = "a test"\nlength_m = 8\nbeam_m = 3\ndraught_m = 0.4\nfreeboard_m = 0.6\n'
        '[recording]\nfile = "motion.csv"\n'
    )
    path = folder / "recorded.toml"
    path.write_text('title = "x"\nduration_limit_s = 40\n[vessel]\nfile = "boat.toml"\nmoored = false\n')
    return path


def test_a_changed_recording_behind_the_vessels_file_is_another_campaign(tmp_path: Path) -> None:
    plans = []
    for heave_m in (0.1, 0.1, 0.2):
        scenario = load(recorded(tmp_path, heave_m))
        plans.append(make_plan("recorded", scenario, settings_for(scenario, None), "truth"))
    assert "scenario: vessel: recording" in plans[0].files
    assert digest_of(plans[0]) == digest_of(plans[1])
    assert digest_of(plans[0]) != digest_of(plans[2])
    assert {key for key in plans[0].files if plans[0].files[key] != plans[2].files[key]} == {"scenario: vessel: recording"}


def test_the_settings_follow_the_scenarios_camera_and_pad() -> None:
    scenario = load("calm")
    given = Overridable(scenario, settings_for(scenario, None))

    def files(*texts: str) -> tuple[str, str, str]:
        own, settings = given.with_values([given.parse(text, "--set") for text in texts], "--set")
        return tuple(Path(file).stem for file in (own.camera.file, settings.camera.file, settings.pad.file))  # type: ignore[return-value]

    assert files() == ("sim", "sim", "thesis")
    assert files("camera.file=usb_640x480") == ("usb_640x480", "usb_640x480", "thesis")
    assert files("pad.file=printed") == ("sim", "sim", "printed")
    assert files("camera.file=usb_640x480", "settings.camera.file=sim") == ("usb_640x480", "sim", "thesis")
    assert files("settings.camera.file=usb_640x480") == ("sim", "usb_640x480", "thesis")
    assert files("settings.camera.file=usb_640x480", "vehicle.file=hexa_7kg") == ("sim", "usb_640x480", "thesis")
    with pytest.raises(BadInput, match=r"nothing\.toml"):
        make_plan("x", *given.with_values([("camera.file", "nothing.toml")], "--set"), "truth")
    assert (SHIPPED / "cameras" / "usb_640x480.toml").is_file()


@pytest.mark.parametrize("of_a_file", [False, True])
def test_settings_that_follow_the_scenario_follow_its_other_vehicle_and_ship(of_a_file: bool) -> None:
    scenario = load("calm")
    own = settings_for(scenario, str(SHIPPED / "ardrone1.toml") if of_a_file else None)
    wanted = [
        ("vehicle.file", "hexa_7kg"),
        ("vessel.reports_place", True),
        ("vessel.reports_hz", 1.0),
        ("guidance.cone.gate_height_m", 0.4),
    ]
    _, settings = Overridable(scenario, own).with_values(wanted, "--set")
    cone, follow = settings.guidance.cone, settings.guidance.follow_deck
    assert cone.gate_height_m == 0.4
    assert (cone.feet_below_m, follow.response, settings.guidance.rendezvous.enabled) == (
        (own.guidance.cone.feet_below_m, own.guidance.follow_deck.response, False) if of_a_file else (0.25, "hexa_7kg", True)
    )
