"""Landings with a camera on a gimbal that swings: on the stand-ins, with rendered frames that follow the gimbal."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from companion.base.mission import FlightOutcome
from companion.cli.main import main
from drivers.mavlink.dialect import mav
from drivers.mavlink.options import GimbalOptions
from estimator.contracts.estimates import Verdict
from sitl.emulators.autopilots.flight import AutopilotFlight, AutopilotProgram
from sitl.flight.one_flight import settings_for
from sitl.perception.levels import perceive
from sitl.scenario.scenario import load


def gimbal_flight(
    folder: Path, *, point_down: bool = True, limit_s: float = 90.0, perception: Any = "pixels", **gimbal: Any
) -> AutopilotFlight:
    scenario = load("gimbal")
    start = msgspec.structs.replace(scenario.start, height_m=2.5, pad_right_m=0.5, pad_forward_m=0.4)
    scenario = msgspec.structs.replace(
        scenario, gimbal=msgspec.structs.replace(scenario.gimbal, **gimbal), start=start, duration_limit_s=limit_s
    )
    settings = settings_for(scenario, None, by_autopilot=True)
    options = GimbalOptions(scenario.gimbal.device_id, point_down=point_down)
    settings = msgspec.structs.replace(settings, camera=msgspec.structs.replace(settings.camera, gimbal=options))
    program = AutopilotProgram("arducopter", None)
    return AutopilotFlight(scenario, 3, settings, program, folder, perception=perceive(perception))


@pytest.mark.timeout(600)
async def test_it_lands_by_a_swinging_camera_whose_yaw_is_from_north_and_which_somebody_pointed_ahead_on_the_way(tmp_path):
    landing = gimbal_flight(tmp_path, device_id=1, yaw="earth", leaves_at_s=8.0)
    end = await landing.fly()
    assert end.failure == ""
    assert end.outcome is FlightOutcome.LANDED
    assert end.landing is not None
    assert end.landing.on_pad
    assert end.landing.lateral_m < 0.15
    link = landing.stand_in.gimbal if landing.stand_in is not None else None
    assert link is not None
    assert link.commands[mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW] == 2, "at the start, and when it had left"
    assert link.control == (1, 191)


@pytest.mark.timeout(600)
async def test_it_does_not_descend_while_the_gimbal_reports_nothing(tmp_path: Path) -> None:
    landing = gimbal_flight(tmp_path, limit_s=6.0, silent_at_s=1.0)
    end = await landing.fly()
    assert end.landing is None
    assert end.outcome is not FlightOutcome.LANDED
    assert end.health.frames[Verdict.NO_GIMBAL] > 50
    assert end.health.frames[Verdict.FUSED] == 0
    assert landing.body is not None
    assert landing.body.p_pad_ned[2] - landing.body.state().p_ned[2] > 1.8, "of 2.5 m"


STAND_IN_OF_TRUTH = ["--autopilot", "px4", "--binary", "stand-in", "--perception", "truth"]


@pytest.mark.parametrize("argv", [[], ["--follow", "udpin://127.0.0.1:1"], STAND_IN_OF_TRUTH])
def test_only_the_stand_in_with_rendered_frames_has_a_gimbal(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "gimbal", *argv]) == 2
    assert "gimbal: " in capsys.readouterr().err
