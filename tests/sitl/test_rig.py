"""A person's own settings in a simulated world: what the world takes over from them, and what it replaces."""

import argparse
from pathlib import Path

import pytest
from msgspec.structs import replace

from companion.cli import flight_options
from companion.cli import main as cli
from companion.settings.load import load as load_settings
from companion.settings.overrides import leaves, plain, with_overrides
from estimator.contracts.errors import BadInput
from sitl.campaign.plan import make_plan, unpacked
from sitl.scenario.overrides import Overridable
from sitl.scenario.scenario import load
from sitl.scenario.settings import Rig, in_world, replaced_keys, rig_for, settings_for

OWN = """
vehicle = {kind = "mavlink", links = "serial:///dev/ttyAMA0:921600", system_id = 7, vessel_id = 8}
camera = {file = "usb_640x480", source = "gstreamer", device = "nvarguscamerasrc ! nvvidconv", latency_s = -0.01}
pad = {file = "printed"}
vision = {colours = "outdoor"}
guidance = {start = "signal", cone = {feet_below_m = 0.1}}
limits = {fence = "start", fence_radius_m = 30.0}
vessel = {nmea = "127.0.0.1:10110"}
"""
REPLACED = {
    "vehicle.links", "vehicle.system_id", "vehicle.vessel_id", "camera.source", "camera.device", "camera.latency_s",
    "guidance.cone.feet_below_m", "vessel.nmea",
}  # fmt: skip
OTHERS = [("vehicle.file", "hexa_7kg"), ("vessel.reports_place", True), ("vessel.reports_hz", 1.0)]
"""Keys of a scenario that the simulator's own settings follow."""


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "rig.toml"
    path.write_text(OWN)
    return str(path)


def rig_of(file: str) -> Rig:
    return rig_for(load("demo"), file, by_autopilot=True)


def test_a_world_takes_a_rig_s_camera_and_pad_and_replaces_only_what_it_names(file: str) -> None:
    rig = rig_of(file)
    assert set(rig.replaced) == REPLACED
    assert (Path(rig.scenario.camera.file).stem, Path(rig.scenario.pad.file).stem) == ("usb_640x480", "printed")
    own, now = (dict(leaves(plain(settings))) for settings in (load_settings(file), rig.settings))
    assert {key for key in own if own[key] != now[key]} == REPLACED
    assert in_world(rig.scenario, rig.settings) == rig.settings


def test_the_replaced_keys_are_named_in_one_line(file: str) -> None:
    args = argparse.Namespace(config=file, set=[])
    replaced = flight_options.chosen(args, load("demo"), by_autopilot=True).replaced
    line = flight_options.notice(args.config, replaced)
    assert line.startswith(f"decklander: {file}: replaced by the simulation: vehicle.links, ")
    assert (line.count("\n"), flight_options.notice(None, replaced)) == (1, "")


@pytest.mark.parametrize("by_autopilot", [True, False])
def test_settings_of_the_other_kind_of_vehicle_are_refused(by_autopilot: bool, file: str) -> None:
    with pytest.raises(BadInput, match=r"vehicle\.kind is"):
        rig_for(load("demo"), "ardrone1" if by_autopilot else file, by_autopilot=by_autopilot)


def test_an_ardrone_s_rig_begins_by_itself_in_a_world_of_its_generation() -> None:
    rig = rig_for(load("calm"), "ardrone1")
    assert (rig.scenario.vehicle.generation, Path(rig.scenario.camera.file).stem) == ("1.0", "ardrone1_bottom")
    assert rig.settings.guidance.start == "automatic"


def test_what_a_simulator_completed_is_not_judged_as_a_real_vehicle_and_what_a_person_changes_is(file: str) -> None:
    """WHY: with any `--set` a rig in a simulation, and a replay of its recording, were refused by rules for its real vehicle."""
    completed = rig_of(file).settings
    assert [*completed.faults()], "an autopilot has no frames of its own"
    assert with_overrides(completed, ["guidance.rate_hz=40"], "--set").guidance.rate_hz == 40.0
    with pytest.raises(BadInput, match=r"guidance\.start must be \"signal\""):
        with_overrides(completed, ["guidance.start=automatic"], "--set")


def test_another_vehicle_or_wind_in_the_world_leaves_a_rig_s_own_keys(file: str) -> None:
    rig = rig_of(file)
    given = Overridable(rig.scenario, rig.settings, own=True)
    scenario, settings = given.with_values(OTHERS, "--set")
    assert set(replaced_keys(rig.settings, settings)) == {"guidance.cone.feet_below_m", "expert.guidance.cone.feet_aside_m"}
    assert (scenario.vehicle.file, settings.guidance.rendezvous.enabled) == ("hexa_7kg", False)
    plan = replace(make_plan("demo", rig.scenario, rig.settings, "model"), own=True)
    again = unpacked(plan.base())[1].with_values(OTHERS, "--vary")
    assert again[1].guidance == settings.guidance


def test_the_simulator_s_own_settings_of_an_autopilot_follow_the_scenario() -> None:
    scenario = load("demo")
    given = Overridable(scenario, settings_for(scenario, None, by_autopilot=True))
    settings = given.with_values(OTHERS, "--set")[1]
    assert (settings.guidance.cone.feet_below_m, settings.guidance.rendezvous.enabled) == (0.25, True)


@pytest.mark.parametrize("more", [[], ["--set", "guidance.rate_hz=40", "--set", "wind.speed_m_s=1"]])
def test_a_rig_flies_beside_an_autopilot_in_virtual_time(more: list[str], file: str, capsys: pytest.CaptureFixture[str]) -> None:
    near = ["--set=start.height_m=1.5", "--set=start.pad_right_m=0.2", "--set=start.pad_forward_m=0.2"]
    words = ["simulate", "calm", "--autopilot", "px4", "--perception", "model", "--config", file, *near, *more]
    assert cli.main(words) == 0
    printed = capsys.readouterr()
    assert "replaced by the simulation: vehicle.links" in printed.err
    assert "on the pad" in printed.out
