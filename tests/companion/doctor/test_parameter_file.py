"""The lists of parameters on the pages and in files are what the doctor's rules want of an autopilot with its defaults."""

import re
from pathlib import Path

import pytest

from companion.cli.main import main
from companion.tools.doctor.firmware_parameters import RENAMED
from companion.tools.doctor.parameter_file import wanted_by_default

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize(("stack", "page"), [("ArduPilot", "ardupilot"), ("PX4", "px4")])
def test_a_page_lists_what_the_rules_want(stack: str, page: str) -> None:
    text = (ROOT / f"docs/{page}.md").read_text().partition("--write")[2]
    block = re.search(r"\n\n((?: +[A-Z][A-Z0-9_]+ [-0-9.]+)(?:\s+[A-Z][A-Z0-9_]+ [-0-9.]+)*)\n", text)
    listed = {name: float(value) for name, value in re.findall(r"([A-Z][A-Z0-9_]+) ([-0-9.]+)", block[1])}
    assert listed == {name: value for name, (value, _) in wanted_by_default(stack).items() if value is not None}


@pytest.mark.parametrize("name", ["ardupilot.param", "px4.params"])
def test_a_written_file_is_right_by_the_doctor_and_is_never_written_over(name: str, tmp_path: Path, capsys) -> None:
    path = tmp_path / name
    assert main(["doctor", "--write", str(path)]) == 0
    assert main(["doctor", str(path)]) == 0
    assert re.search(r" (1|11) parameters read", capsys.readouterr().out), "the file is read back"
    kept = path.read_bytes()
    assert main(["doctor", "--write", str(path)]) == 2
    assert main(["doctor", "--write", str(tmp_path / "my.param")]) == 2
    assert (path.read_bytes(), [p.name for p in tmp_path.iterdir()]) == (kept, [name])


def test_bits_that_differ_by_release_are_left_to_the_vehicle(tmp_path: Path) -> None:
    path = tmp_path / "px4.params"
    assert main(["doctor", "--write", str(path)]) == 0
    assert [line for line in path.read_text().splitlines() if "EKF2_GPS_CHECK" in line and not line.startswith("#")] == []
    for release, value in (((1, 15, 0), 21), ((1, 16, 2), 1023 & ~0b111100000), ((1, 17, 0), 2047 & ~0b111100000)):
        assert wanted_by_default("PX4", release)["EKF2_GPS_CHECK"][0] == value
        assert release < (1, 16, 0) or f"1.{release[1]}: {value}" in path.read_text()


def test_a_later_release_gets_its_own_names_and_units() -> None:
    wanted = wanted_by_default("ArduPilot", (4, 7, 0))
    assert wanted["WP_ACC"][0] == 5.0
    assert not set(wanted) & {name for name, later in RENAMED.items() if later.since <= (4, 7, 0)}


def test_a_file_of_an_examined_vehicle_holds_what_was_found_and_misspelt_names_are_named(tmp_path: Path, capsys) -> None:
    given, out = tmp_path / "mine.param", tmp_path / "fix.param"
    given.write_text("PLND_ENABLED,1\nPLND_TYPE,1\nPLND_OPTIONS,1\nGUID_OPTIONS,48\nPLND_LAG,0.05\nLAND_SPEED,250\n")
    with given.open("a") as file:
        file.write("FENCE_ACTOIN,1\nWP_SPPD,10\nLAND_SPEEDS,40\nATC_RAT_RLL_I,1\nMINE,1\n")
    assert main(["doctor", str(given), "--write", str(out)]) == 1
    assert "takes it: FENCE_ACTOIN for FENCE_ACTION, WP_SPPD for WP_SPD [parameter-name]" in capsys.readouterr().out
    assert re.findall(r"^([A-Z_]+),(\S+)$", out.read_text(), re.MULTILINE) == [("GUID_OPTIONS", "16"), ("LAND_SPEED", "40")]


def test_a_file_of_4_7_is_judged_and_mended_under_its_own_names_and_what_is_not_used_is_named(tmp_path: Path, capsys) -> None:
    given, out = tmp_path / "mine.param", tmp_path / "fix.param"
    given.write_text("PSC_JERK_NE,5\nRTL_ALT_FINAL_M,0\nATC_ANGLE_MAX,30\nFS_THR_ENABLE,1\nFOO\nGUID_TIMEOUT 3 extra\nMINE,1\n")
    assert main(["doctor", str(given), "--write", str(out)]) == 1
    page = capsys.readouterr().out
    assert "  line 5: 'FOO': no parameter\n  line 6: 'GUID_TIMEOUT 3 extra': read is GUID_TIMEOUT 3\n" in page
    assert "misspelt, or known to no rule: MINE\n" in page
    assert re.findall(r"^([A-Z_]+),(\S+)$", out.read_text(), re.MULTILINE) == [("RTL_ALT_FINAL_M", "5"), ("PSC_JERK_NE", "20")]
