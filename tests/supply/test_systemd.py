"""The unit file as systemd itself judges it."""

import configparser
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from companion.settings.secret_files import CREDENTIAL

ROOT = Path(__file__).parents[2]
UNIT = ROOT / "configs/systemd/decklander.service"
MOST_EXPOSED = 2.0

needs_analyze = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze here")


def lines(key: str) -> list[str]:
    return re.findall(rf"^{key}=(.*)$", UNIT.read_text(), re.MULTILINE)


@needs_analyze
def test_it_is_exposed_little() -> None:
    output = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", str(UNIT)], capture_output=True, text=True, check=True
    )
    found = re.search(r"Overall exposure level for decklander.service: ([0-9.]+)", output.stdout)
    assert found is not None, output.stdout
    assert float(found[1]) <= MOST_EXPOSED


@needs_analyze
def test_systemd_finds_nothing_wrong_and_would_find_something(tmp_path: Path) -> None:
    """The command is looked for on this machine, where it need not be installed: one that is here stands in for it."""
    text = UNIT.read_text().replace("/opt/decklander/current/bin/decklander", sys.executable)
    good, bad = tmp_path / "decklander.service", tmp_path / "wrong.service"
    good.write_text(text)
    bad.write_text(text.replace("WatchdogSec=5", "WatchdogSec=soon").replace("UMask", "UMaks"))
    output = subprocess.run(["systemd-analyze", "verify", str(good)], capture_output=True, text=True, check=False)
    assert [line for line in output.stderr.splitlines() if "decklander.service" in line] == []
    wrong = subprocess.run(["systemd-analyze", "verify", str(bad)], capture_output=True, text=True, check=False)
    assert "Failed to parse sec value" in wrong.stderr
    assert "UMaks" in wrong.stderr


def test_it_has_what_the_service_relies_on() -> None:
    assert lines("Type") == ["notify"]
    assert lines("RestartPreventExitStatus") == ["2"], "the exit code of bad settings"
    assert lines("DynamicUser") == ["yes"]
    assert lines("StateDirectory") == lines("RuntimeDirectory") == ["decklander"]
    assert {"char-video4linux rw", "char-ttyAMA rw"} <= set(lines("DeviceAllow"))
    assert float(lines("WatchdogSec")[0]) >= 2.0, "a slow frame must not look like a stuck pipeline"


def test_no_key_is_given_twice_where_only_the_last_counts() -> None:
    """Systemd takes the last of most keys without a word."""
    many = {"LoadCredential", "DeviceAllow", "SystemCallFilter", "Environment"}
    keys = [line.split("=")[0] for line in UNIT.read_text().splitlines() if "=" in line and not line.startswith("#")]
    assert [key for key in set(keys) - many if keys.count(key) > 1] == []
    reader = configparser.ConfigParser(strict=False, interpolation=None)
    reader.read(UNIT)
    assert reader.sections() == ["Unit", "Service", "Install"]


def test_the_rigs_name_only_credentials_that_the_unit_loads() -> None:
    loaded = {line.split(":")[0] for line in lines("LoadCredential")}
    for rig in (ROOT / "configs").glob("*.toml"):
        assert set(re.findall(rf'"{CREDENTIAL}([^"]+)"', rig.read_text())) <= loaded, rig.name
