"""The modules to mutate, and the tests that are near enough to notice a change."""

from __future__ import annotations

_GATE = ("tests/estimator/ekf/test_gate_bounds.py", "tests/estimator/ekf/test_gate.py")
_CORE = ("tests/estimator/ekf/test_core.py", "tests/estimator/ekf/test_algebra.py")
_SIGHTINGS = ("tests/estimator/ekf/test_core_sightings.py", "tests/estimator/ekf/test_vision_update_bounds.py")
_ANSWERS = ("tests/estimator/ekf/test_answer.py", "tests/estimator/ekf/test_filter_bounds.py")
_FORECASTS = ("tests/estimator/ekf/test_forecast.py", "tests/estimator/ekf/test_filter_bounds.py")
_INTEGRITY = ("tests/estimator/integrity",)

TARGETS: dict[str, tuple[str, ...]] = {
    "estimator/core/answer.c": _ANSWERS,
    "estimator/core/jacobian.c": _ANSWERS,
    "estimator/core/forecast.c": _FORECASTS,
    "estimator/core/bank_ahead.c": _FORECASTS,
    "estimator/core/filter.c": _CORE,
    "estimator/core/aiding.c": _CORE,
    "estimator/core/aiding_velocity.c": _CORE,
    "estimator/core/gathering.c": _CORE,
    "estimator/core/propagate.c": _CORE,
    "estimator/core/kalman.c": _CORE,
    "estimator/core/oscillator.c": _CORE,
    "estimator/core/bank.c": _SIGHTINGS,
    "estimator/core/bank_weights.c": _SIGHTINGS,
    "estimator/core/skill.c": _SIGHTINGS,
    "estimator/core/sighting.c": _SIGHTINGS,
    "estimator/core/symmetric.c": _SIGHTINGS,
    "estimator/core/vision.c": _SIGHTINGS,
    "estimator/core/gate.c": _SIGHTINGS,
    "estimator/core/deck_jolt.c": _SIGHTINGS,
    "estimator/core/vessel.c": _SIGHTINGS,
    "estimator/core/correction.c": _CORE,
    "estimator/ekf/gate.py": _GATE,
    "estimator/ekf/process_event.py": (
        "tests/estimator/ekf/test_process_event_bounds.py",
        "tests/estimator/ekf/test_noise_and_inflation.py",
    ),
    "estimator/ekf/filter.py": ("tests/estimator/ekf/test_filter_bounds.py",),
    "estimator/ekf/history.py": ("tests/estimator/ekf/test_history_bounds.py",),
    "estimator/integrity/guard.py": _INTEGRITY,
    "estimator/integrity/clock.py": _INTEGRITY,
    "estimator/integrity/frames.py": _INTEGRITY,
    "estimator/integrity/heading.py": _INTEGRITY,
    "estimator/integrity/heights.py": _INTEGRITY,
    "estimator/integrity/sensors.py": _INTEGRITY,
    "estimator/integrity/tracks.py": _INTEGRITY,
    "estimator/integrity/view.py": _INTEGRITY,
    "companion/guidance/mission.py": ("tests/companion/test_mission_table.py",),
    "companion/guidance/watch.py": ("tests/companion/test_mission_flights.py",),
    "companion/guidance/limits.py": ("tests/companion/test_mission_flights.py",),
    "companion/guidance/attempt.py": ("tests/companion/test_mission_flights.py",),
    "companion/guidance/clearance.py": ("tests/companion/test_clearance.py",),
    "companion/guidance/pid.py": ("tests/companion/test_pid_bounds.py", "tests/companion/test_pid.py"),
    "drivers/ardrone/arbiter.py": ("tests/drivers/test_arbiter_bounds.py", "tests/drivers/test_arbiter.py"),
    "drivers/ardrone/landing_watch.py": (
        "tests/drivers/test_landing_watch_bounds.py",
        "tests/drivers/test_arbiter_bounds.py",
        "tests/drivers/test_command_streamer_bounds.py",
        "tests/drivers/test_arbiter.py",
        "tests/drivers/test_command_streamer.py",
    ),
    "drivers/ardrone/command_streamer.py": (
        "tests/drivers/test_command_streamer_bounds.py",
        "tests/drivers/test_command_streamer.py",
    ),
    "drivers/mavlink/setpoint_streamer.py": (
        "tests/drivers/mavlink/test_setpoint_streamer_bounds.py",
        "tests/drivers/mavlink/test_setpoint_streamer.py",
    ),
}
"""Module to tests; only those whose lines meet the mutant's run, the quickest first."""
