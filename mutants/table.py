"""What is mutated, and the tests that are near enough to it to notice."""

from __future__ import annotations

_EKF = ("tests/estimator/ekf", "tests/estimator/test_pipeline.py")
_GUIDANCE = ("tests/companion/test_planner.py", "tests/companion/test_pid.py", "tests/companion/test_pilot.py")

TARGETS: dict[str, tuple[str, ...]] = {
    "estimator/ekf/gate.py": _EKF,
    "estimator/ekf/fuse.py": _EKF,
    "estimator/ekf/seeing.py": _EKF,
    "estimator/ekf/filter.py": _EKF,
    "estimator/ekf/history.py": _EKF,
    "companion/guidance/planner.py": _GUIDANCE,
    "companion/guidance/pid.py": _GUIDANCE,
    "drivers/ardrone/helm.py": ("tests/drivers/test_helm.py",),
    "drivers/mavlink/helm.py": ("tests/drivers/mavlink/test_helm.py",),
}
"""Module to tests; only those whose lines meet the mutant's run, the quickest first."""
