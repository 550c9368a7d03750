"""Dockerfiles, compose.yaml, alerts and the unit file agree with each other, with the code and with systemd itself."""

import grp
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from companion.base.health import Health
from companion.base.mission import ENDED, State
from companion.parts.mavlink.bridge.options import BridgeOptions
from companion.parts.metrics.endpoint import families
from companion.parts.mqtt.options import MqttSettings
from companion.settings.files import CREDENTIAL
from companion.settings.links import HttpSettings, on_loopback
from companion.settings.load import load
from drivers.ardrone.options import ArDroneOptions
from drivers.clock import SystemClock
from estimator.contracts.estimates import Source, Verdict
from qualification.packaging.image import stages

ROOT = Path(__file__).parents[2]
COMPOSE = ROOT / "configs/compose"
DOCKERFILES = [ROOT / "Dockerfile", *sorted(COMPOSE.glob("*.Dockerfile"))]

needs_compose = pytest.mark.skipif(shutil.which("docker-compose") is None, reason="there is no docker-compose here")


def composed(*words: str) -> str:
    done = subprocess.run(
        ["docker-compose", "-f", "compose.yaml", *words], cwd=ROOT, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@needs_compose
def test_compose_is_valid_and_starts_the_autopilot_only_when_requested() -> None:
    always = set(composed("config", "--services").split())
    assert {"broker", "sim", "daemon", "prometheus", "grafana"} <= always
    text = composed("config")
    for file in re.findall(r"(\S+?):/\S+:ro", text):
        assert not file.startswith("/") or Path(file).exists(), file


@pytest.mark.parametrize("dockerfile", DOCKERFILES, ids=lambda path: path.name)
def test_what_is_copied_exists_and_reaches_the_build(dockerfile: Path) -> None:
    let_in = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = [
        word
        for stage in stages(dockerfile.read_text())
        for step in stage.steps
        if step.word == "COPY" and not step.text.startswith("--from")
        for word in step.text.split()[:-1]
    ]
    assert copied or stages(dockerfile.read_text())[0].base == "decklander"
    for word in copied:
        assert (ROOT / word).exists() or word == "PKG-INFO*", word
        assert Path(word.removesuffix("*")).parts[0] in let_in, word


def test_the_service_is_built_in_two_stages_and_runs_as_nobody_special() -> None:
    build, last = stages((ROOT / "Dockerfile").read_text())
    words = [step.word for step in last.steps]
    assert build.name == "build"
    assert [step.text for step in last.steps if step.word == "USER"] == ["decklander"]
    assert "HEALTHCHECK" in words
    assert words.index("USER") < words.index("ENTRYPOINT")
    assert not any("pip" in step.text or "venv" in step.text for step in last.steps if step.word == "RUN")


def test_the_labels_of_blueos_start_the_service_as_its_compose_file_does() -> None:
    """Its store reads authors, company, tags and permissions as JSON; its starter gives the last to the engine."""
    _, last = stages((ROOT / "Dockerfile").read_text())
    labels = dict(shlex.split(step.text)[0].split("=", 1) for step in last.steps if step.word == "LABEL")
    assert labels["type"] in ("device-integration", "example", "theme", "other", "tool")
    assert re.fullmatch(r"core >= \d+\.\d+", labels["requirements"])
    assert labels["version"] == "$VERSION"
    assert {"name", "email"} == set(json.loads(labels["authors"])[0]) <= set(json.loads(labels["company"]))
    assert all(re.fullmatch("[a-z0-9-]+", tag) for tag in json.loads(labels["tags"]))
    permissions = json.loads(labels["permissions"])
    host = permissions["HostConfig"]
    lines = re.findall(r"^    (\w+): (\S.*)$", (COMPOSE / "blueos.yaml").read_text(), re.MULTILINE)
    service = {key: json.loads(value) for key, value in lines}
    assert (service["command"], service["user"]) == (permissions["Cmd"], permissions["User"])
    assert (service["network_mode"], service["read_only"], service["init"]) == (
        host["NetworkMode"],
        host["ReadonlyRootfs"],
        host["Init"],
    )
    assert (service["cap_drop"], service["security_opt"]) == (host["CapDrop"], host["SecurityOpt"])
    assert (service["volumes"], service["device_cgroup_rules"]) == (host["Binds"], host["DeviceCgroupRules"])
    assert service["tmpfs"] == list(host["Tmpfs"])
    assert service["healthcheck"]["disable"] is (permissions["Healthcheck"] == {"Test": ["NONE"]})
    command, *words = permissions["Cmd"]
    (state,) = [step.text.partition("=")[2] for step in last.steps if step.text.startswith("STATE_DIRECTORY=")]
    assert (command, words) == ("run", ["--config", f"{state}/rig.toml"])
    rig = load(COMPOSE / "blueos.toml")
    assert state in [bind.split(":")[1] for bind in host["Binds"]]
    assert not [*rig.faults()]
    assert rig.http.page
    assert not on_loopback(rig.http.host)


def test_a_csi_camera_reaches_the_container_of_blueos_by_the_groups_of_devices_alone() -> None:
    (stage,) = stages((COMPOSE / "csi.Dockerfile").read_text())
    lines = re.findall(r"^    (\w+): (\[.*|\".*)$", (COMPOSE / "csi.yaml").read_text(), re.MULTILINE)
    service = {key: json.loads(value) for key, value in lines}
    assert [step.text for step in stage.steps if step.word == "USER"] == ["root", stage.base]
    assert service["user"] == "10001:10001", "every character device is open: as root the modes of the nodes bar nothing"
    assert f"--uid {service['user'].split(':')[0]} " in (ROOT / "Dockerfile").read_text()
    assert service["group_add"] == [str(grp.getgrnam(name).gr_gid) for name in ("dialout", "video")]
    assert service["volumes"] == ["/run/udev:/run/udev:ro"]
    assert "/dev:/dev" in (COMPOSE / "blueos.yaml").read_text()
    assert stages((ROOT / "Dockerfile").read_text())[-1].base == "debian:trixie-slim"
    assert any(" trixie main" in step.text for step in stage.steps), "picamera2 is for one Python, the image's"


def test_the_rig_of_compose_fits_its_services() -> None:
    rig = load(COMPOSE / "decklander.toml")
    text = (ROOT / "compose.yaml").read_text()
    services = set(re.findall(r"^  (\w+):$", text, re.MULTILINE))
    assert isinstance(rig.vehicle, ArDroneOptions)
    (bridge,) = rig.of(BridgeOptions).endpoints()
    assert f":{bridge.port}/udp" in text
    assert {rig.vehicle.host, rig.of(MqttSettings).host} <= services
    assert rig.http.port == HttpSettings().port
    assert f"daemon:{rig.http.port}" in (COMPOSE / "prometheus.yml").read_text()
    assert f"127.0.0.1:{rig.http.port}/health" in (ROOT / "Dockerfile").read_text()
    assert f"credentials_file: {rig.http.token_file}" in (COMPOSE / "prometheus.yml").read_text()
    assert rig.http.token_file in (COMPOSE / "broker.sh").read_text()
    assert rig.of(MqttSettings).drone == rig.of(MqttSettings).user, "the access list gives a user the subtree of its name"
    assert rig.of(MqttSettings).user in re.findall(r"for user in (.*); do", (COMPOSE / "broker.sh").read_text())[0].split()


def told() -> set[str]:
    """Return the names of all figures that the service tells."""
    everything = families(Health(SystemClock()).snapshot())
    return {family.name + ("_total" if family.type == "counter" else "") for family in everything}


def test_the_dashboard_requests_figures_that_the_service_reports() -> None:
    dashboard = json.loads((COMPOSE / "grafana/dashboards/decklander.json").read_text())
    asked = {name for panel in dashboard["panels"] for t in panel["targets"] for name in re.findall(r"decklander_\w+", t["expr"])}
    assert len(asked) >= 12
    assert asked <= told()
    ids = [panel["id"] for panel in dashboard["panels"]]
    assert len(set(ids)) == len(ids)
    source = (COMPOSE / "grafana/provisioning/datasources/prometheus.yml").read_text()
    assert all(f"uid: {panel['datasource']['uid']}" in source for panel in dashboard["panels"])


def test_alerts_ask_for_figures_and_states_that_there_are_and_the_docs_say_what_to_do() -> None:
    prometheus = (COMPOSE / "prometheus.yml").read_text()
    (mounted,) = re.findall(r"rule_files: \[(\S+)\]", prometheus)
    assert f"./configs/compose/alerts.yml:{mounted}:ro" in (ROOT / "compose.yaml").read_text()
    rules = re.split(r"\n +- alert: ", (COMPOSE / "alerts.yml").read_text())[1:]
    assert len(rules) == 10
    symptoms = (ROOT / "docs/symptoms.md").read_text()
    known = {
        "phase": {state.value for state in State},
        "to": {state.value for state in State},
        "outcome": {state.value for state in ENDED},
        "verdict": {verdict.value for verdict in Verdict},
        "path": {"ekf"},
        "source": set(get_args(Source)),
    }
    jobs = set(re.findall(r"job_name: (\w+)", prometheus))
    for rule in rules:
        alert, (expression,) = rule.split()[0], re.findall(r"expr: (.+)", rule)
        names = set(re.findall(r"decklander_\w+", expression))
        assert names <= told()
        assert names or "up{" in expression
        for label, values in re.findall(r'(\w+)[!=]~?"([^"]*)"', expression):
            assert set(values.split("|")) <= (jobs if label == "job" else known[label]), alert
        assert re.search(r"labels: \{severity: (critical|warning)\}", rule), alert
        assert re.search(r'summary: ".+"', rule), alert
        assert f"| {alert} |" in symptoms


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
    assert lines("Restart") == ["always"]
    assert lines("RestartPreventExitStatus") == ["2"], "the exit code of bad settings"
    assert lines("RuntimeDirectoryPreserve") == ["restart"]
    assert lines("StartLimitIntervalSec") == ["0"]
    assert lines("DynamicUser") == ["yes"]
    assert lines("StateDirectory") == lines("RuntimeDirectory") == ["decklander"]
    assert {"char-video4linux rw", "char-ttyAMA rw"} <= set(lines("DeviceAllow"))
    assert "AF_CAN" in lines("RestrictAddressFamilies")[0].split(), "vessel.bus = can://can0"
    assert float(lines("WatchdogSec")[0]) >= 2.0, "a slow frame must not look like a stuck pipeline"


def test_the_rigs_name_only_credentials_that_the_unit_loads() -> None:
    loaded = {line.split(":")[0] for line in lines("LoadCredential")}
    for rig in (ROOT / "configs").glob("*.toml"):
        assert set(re.findall(rf'"{CREDENTIAL}([^"]+)"', rig.read_text())) <= loaded, rig.name
