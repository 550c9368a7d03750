"""The V4L2 driver on the kernel's `vivid` camera and through `uvcvideo`, which most cameras use: scenes of one booted machine."""

import os

import pytest

from qualification.v4l2_vm import machine
from qualification.v4l2_vm.guest import SCENES

LACKING = machine.missing()
pytestmark = [
    # Where everything is installed on purpose, its absence is a failure and not a reason to skip.
    pytest.mark.skipif(LACKING is not None and "CI" not in os.environ, reason=str(LACKING)),
    pytest.mark.timeout(900),
]


@pytest.fixture(scope="module")
def errors() -> dict[str, str]:
    """Return the error of each scene that the guest played, empty for none."""
    assert LACKING is None, LACKING
    return {report["name"]: report.get("error", "") for report in machine.run(600.0)}


@pytest.mark.parametrize("scene", [scene.__name__ for scene in SCENES])
def test_the_driver_holds_on_a_kernel_device(scene: str, errors: dict[str, str]) -> None:
    assert errors[scene] == ""
