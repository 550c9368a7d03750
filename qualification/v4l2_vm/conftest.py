"""One boot for all tests on real kernel devices."""

import os

import pytest

from qualification.v4l2_vm import machine
from qualification.v4l2_vm.capture import Seen

LACKING = machine.missing()
NEEDS_A_MACHINE = [
    # Where everything is installed on purpose, its absence is a failure and not a reason to skip.
    pytest.mark.skipif(LACKING is not None and "CI" not in os.environ, reason=str(LACKING)),
    pytest.mark.timeout(900),
]


@pytest.fixture(scope="session")
def seen() -> dict[str, Seen]:
    assert LACKING is None, LACKING
    reports = {report["name"]: report for report in machine.run(600.0)}
    assert {name: report["error"] for name, report in reports.items() if "error" in report} == {}
    assert all(report.get("descriptors_left", 0) == 0 for report in reports.values())
    return reports
