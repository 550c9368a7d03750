"""Differences of an autopilot's parameters from its firmware's defaults, by the names and units of each release."""

import pytest

from companion.tools.doctor.diagnose import diagnose
from companion.tools.doctor.firmware_parameters import RENAMED, defaults_of, differing
from companion.tools.doctor.snapshot import Snapshot
from tests.companion.doctor.test_rules import GOOD
from tests.companion.doctor.test_set_ups import set_up


@pytest.mark.parametrize(("stack", "firmware"), [("ArduPilot", (4, 5, 7)), ("ArduPilot", (4, 7, 1)), ("PX4", (1, 16, 2))])
def test_a_firmware_s_own_defaults_differ_in_nothing_and_each_of_them_is_looked_at(stack, firmware):
    defaults = defaults_of(stack, firmware)
    assert differing(defaults, defaults) == {}
    other = {name: value + 1.0 for name, value in defaults.items()}
    assert differing(other, defaults) == {name: (value + 1.0, value) for name, value in sorted(defaults.items())}


def test_later_releases_are_queried_by_their_names_and_judged_in_their_units() -> None:
    old, new = defaults_of("ArduPilot", (4, 5, 7)), defaults_of("ArduPilot", (4, 7, 0))
    assert (old["PSC_ACCZ_P"], new["PSC_D_ACC_P"], new["WP_SPD"]) == (0.5, 0.05, 10.0)
    assert not set(new) & {name for name, later in RENAMED.items() if later.name != name}
    assert differing({"PSC_D_ACC_P": 0.05000000074505806, "WP_SPD": 3.0}, new) == {"WP_SPD": (3.0, 10.0)}
    assert defaults_of("other", None) == {}


def test_what_no_landing_feels_is_left_out() -> None:
    changed = {"SERIAL1_BAUD": 57.0, "COM_FLIGHT_UUID": 9.0, "EKF2_IMU_CTRL": 3.0}
    assert list(differing(changed, dict.fromkeys(changed, 1.0))) == ["EKF2_IMU_CTRL"]


@pytest.mark.parametrize("stack", ["ArduPilot", "PX4"])
def test_the_tables_say_what_the_set_ups_of_the_programs_have(stack: str) -> None:
    """The good set-ups were read from the programs; what differs there is what the documentation of each stack requests."""
    snapshot: Snapshot = set_up(stack, "defaults")
    assert snapshot.autopilot is not None
    ardupilot = {"FS_THR_ENABLE", "GUID_OPTIONS", "PSC_ACCZ_FF", "PSC_JERK_XY", "PSC_JERK_Z", "WPNAV_ACCEL", "WPNAV_ACCEL_Z"}
    asked_for = {"ArduPilot": ardupilot, "PX4": {"COM_OBL_RC_ACT", "COM_RC_IN_MODE", "EKF2_GPS_CHECK"}}
    found = differing(snapshot.autopilot.parameters, defaults_of(stack, (4, 5, 7) if stack == "ArduPilot" else (1, 16, 2)))
    assert set(found) == asked_for[stack]
    assert diagnose(GOOD) == (), "what differs is no finding"
