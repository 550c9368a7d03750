"""The modules to mutate, and the tests that are near enough to notice a change."""

from pathlib import Path

_ORACLE = "tests/estimator/ekf/test_oracle.py"
_BEGIN = "tests/estimator/ekf/test_begin.py"
_HISTORY = "tests/estimator/ekf/test_history.py"
_ALGEBRA = "tests/estimator/ekf/test_algebra.py"
_CORE_OF_FILTER = Path(__file__).parents[1] / "estimator/core/filter"
_PIPELINE = ("tests/estimator/test_pipeline.py", "tests/estimator/test_fusion_results.py")
_NUMBERS = "tests/estimator/ekf/test_members_and_noise.py"
_INTEGRITY = "tests/estimator/integrity"
_MISSION = (
    "tests/companion/test_mission_states.py",
    "tests/companion/test_mission_flights.py",
    "tests/companion/test_out_of_reach.py",
)
_AIM = ("tests/companion/test_steer.py", "tests/companion/test_limits.py")
_LAW = ("tests/companion/test_follow_deck.py", "tests/companion/test_controllers.py")
_WATCH = "tests/companion/test_response_watch.py"
_FLOWN = ("tests/companion/test_follow_deck.py",)
_STREAMER = "tests/drivers/test_command_streamer.py"
_VISION = "tests/estimator/vision"
_KEPT = f"{_VISION}/test_unchanged_frames.py"
_SEEN = (_KEPT, f"{_VISION}/test_verification.py")
_ROOMS = {
    "align": (f"{_VISION}/test_detect.py", *_SEEN, f"{_VISION}/test_hard_light.py"),
    "lamps": (_KEPT, f"{_VISION}/test_lamps.py"),
    "look": (*_SEEN, f"{_VISION}/test_thesis.py"),
    "register": (f"{_VISION}/test_registration.py", *_SEEN),
    "search": (
        _KEPT,
        f"{_VISION}/test_detect.py",
        f"{_VISION}/test_tracker.py",
        f"{_VISION}/test_other_pads.py",
    ),
}
"""Rooms of vision's C and their tests."""
_CORE_OF_VISION = Path(__file__).parents[1] / "estimator/core/vision"

TARGETS: dict[str, tuple[str, ...]] = {
    **{f"estimator/core/filter/{file.name}": (_ORACLE,) for file in sorted(_CORE_OF_FILTER.glob("*.c"))},
    "estimator/core/filter/filter.c": (_HISTORY,),
    "estimator/core/filter/begin.c": (_BEGIN, _ORACLE),
    "estimator/core/base/kalman.c": (_ORACLE,),
    "estimator/core/base/symmetric.c": (_ALGEBRA,),
    **{f"estimator/core/law/{name}.c": _FLOWN for name in ("law", "axis", "climb", "deck")},
    "estimator/core/base/rotation.c": (_ALGEBRA, "tests/estimator/vision/test_pose.py", _ORACLE),
    "estimator/core/vision/sighting_level.c": (f"{_VISION}/test_pose.py",),
    "estimator/core/vision/camera.c": (*_SEEN, f"{_VISION}/test_registration.py"),
    "estimator/core/vision/frame_noise.c": (f"{_VISION}/test_hard_light.py", *_SEEN),
    **{
        f"estimator/core/vision/{room}/{file.name}": tests
        for room, tests in _ROOMS.items()
        for file in sorted((_CORE_OF_VISION / room).glob("*.c"))
    },
    "estimator/core/vision/register/coded.c": (f"{_VISION}/test_other_pads.py", *_SEEN),
    "estimator/ekf/filter.py": (
        _NUMBERS,
        _HISTORY,
        "tests/estimator/test_fusion_results.py",
        "tests/estimator/ekf/test_rough.py::test_a_belief_that_nothing_confirms_is_not_called_consistent",
    ),
    "estimator/ekf/event.py": (_NUMBERS, _ORACLE),
    "estimator/ekf/params.py": (_NUMBERS, _ORACLE),
    "estimator/pipeline.py": ("tests/estimator/test_public_api.py", *_PIPELINE),
    "estimator/integrity/guard.py": (f"{_INTEGRITY}/test_guard.py",),
    "estimator/integrity/crosschecks.py": (f"{_INTEGRITY}/test_crosschecks.py",),
    "estimator/integrity/sensors.py": (f"{_INTEGRITY}/test_sensors.py",),
    "estimator/integrity/tracks.py": (f"{_INTEGRITY}/test_tracks.py",),
    "companion/guidance/mission/machine.py": (
        "tests/companion/test_mission_table.py",
        "tests/companion/test_out_of_reach.py",
        *_MISSION,
    ),
    "companion/guidance/monitor.py": ("tests/companion/test_monitor.py",),
    "companion/guidance/mission/tipped.py": ("tests/companion/test_tipped.py",),
    "companion/guidance/landing.py": ("tests/companion/test_landing.py", "tests/companion/test_flight_memory.py"),
    "companion/guidance/mission/progress.py": _MISSION,
    "companion/guidance/mission/rules.py": _MISSION,
    "companion/guidance/mission/descend.py": (*_MISSION, *_AIM),
    "companion/guidance/mission/gate.py": (*_MISSION, *_AIM),
    "companion/guidance/mission/commit.py": (*_MISSION, *_AIM),
    "companion/guidance/mission/press.py": (*_MISSION, *_AIM),
    "companion/guidance/mission/hold_blind.py": (*_MISSION, *_AIM),
    "companion/guidance/mission/go_around.py": (*_MISSION, *_AIM),
    "companion/guidance/mission/another_pad.py": _MISSION,
    "companion/guidance/thesis.py": (*_MISSION, "tests/companion/test_thesis_mission.py"),
    "companion/guidance/mission/waiting.py": (*_MISSION, *_AIM),
    "companion/guidance/mission/phase.py": (*_AIM, *_MISSION),
    "companion/guidance/mission/limits.py": ("tests/companion/test_limits.py", *_MISSION),
    "companion/guidance/mission/charge.py": ("tests/companion/test_limits.py", *_MISSION),
    "companion/guidance/mission/held_up.py": ("tests/companion/test_contact.py", _MISSION[0], *_AIM),
    "companion/guidance/mission/contact.py": ("tests/companion/test_contact.py", _MISSION[0], *_AIM),
    "companion/guidance/mission/clearance.py": ("tests/companion/test_limits.py",),
    "companion/guidance/mission/search.py": ("tests/companion/test_out_of_reach.py",),
    "companion/guidance/mission/vessel_track.py": (
        "tests/companion/test_vessel_track.py",
        "tests/companion/test_out_of_reach.py",
    ),
    "companion/guidance/law/follow_deck.py": (
        f"{_WATCH}::test_other_gains_come_without_a_bump",
        f"{_WATCH}::test_every_response_that_may_be_flown_by_keeps_the_margin_of_60_ms[ardrone2]",
        *_LAW,
    ),
    "companion/guidance/law/margins.py": (_WATCH,),
    "companion/settings/guidance.py": ("tests/companion/test_response_fit.py",),
    "companion/guidance/law/gains.py": (
        "tests/companion/test_response_fit.py",
        "tests/companion/test_follow_deck.py",
        "tests/companion/test_identify.py::test_a_descent_reports_the_delay_of_any_vehicle_to_40_ms",
    ),
    "companion/guidance/law/response_fit.py": (
        "tests/companion/test_response_fit.py",
        "tests/companion/test_identify.py::test_lag_and_delay_of_the_climb_are_distinguished",
        "tests/companion/test_identify.py::test_a_descent_reports_the_delay_of_any_vehicle_to_40_ms",
    ),
    "companion/guidance/law/flown_course.py": (_WATCH, "tests/companion/test_response_fit.py"),
    "companion/guidance/law/response_watch.py": (_WATCH, "tests/companion/test_response_fit.py"),
    "companion/guidance/law/pid.py": ("tests/companion/test_mission_flights.py",),
    "sitl/flight/hands.py": ("tests/sitl/test_referee.py",),
    "sitl/flight/limits.py": ("tests/sitl/test_referee.py",),
    "sitl/flight/referee.py": ("tests/sitl/test_referee.py",),
    "drivers/ardrone/arbiter.py": ("tests/drivers/test_custody.py", _STREAMER),
    "drivers/ardrone/landing_watch.py": ("tests/drivers/test_custody.py", _STREAMER),
    "drivers/ardrone/velocity_loop.py": ("tests/drivers/test_custody.py", _STREAMER),
    "drivers/ardrone/custody.py": ("tests/drivers/test_custody.py", _STREAMER),
    "drivers/mavlink/setpoint_streamer.py": (
        "tests/drivers/mavlink/test_setpoints.py",
        "tests/drivers/mavlink/test_custody.py",
    ),
}
"""Module to tests, whole files or single ones; only those whose lines meet the mutant's run, the quickest first."""
