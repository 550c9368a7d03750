"""compose.yaml's broker, sim and daemon from built roots, in a network of their own, until everything that must be so is so."""

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from qualification.packaging.image import ROOT, Image, chroot

LANDED_S = 400.0
CONFIG = ROOT / "configs/compose/decklander.toml"
DASHBOARD = ROOT / "configs/compose/grafana/dashboards/decklander.json"


def fly(work: Path, service: Image, broker: Image, config: Path = CONFIG) -> None:
    """Run this module in a network namespace where compose's names are this machine.

    Raises:
        CalledProcessError: something was not so; what stands above.
    """
    (work / "hosts").write_text("127.0.0.1 localhost sim broker daemon\n")
    plan = [asdict(image) | {"root": str(image.root)} for image in (service, broker)]
    (work / "plan.json").write_text(json.dumps(plan))
    inside = f"ip link set lo up && exec {sys.executable} -m qualification.packaging.image_flight {work} {config.resolve()}"
    subprocess.run(["unshare", "--net", "sh", "-c", inside], cwd=ROOT, check=True)


def _until(what: str, condition: Callable[[], object], seconds: float, children: dict[str, subprocess.Popen[str]]) -> float:
    began = time.monotonic()
    while time.monotonic() - began < seconds:
        for name, child in children.items():
            if child.poll() is not None:
                raise SystemExit(f"{name} ended with {child.returncode} before: {what}")
        if condition():
            spent = time.monotonic() - began
            print(f"{spent:7.1f} s  until {what}", flush=True)
            return spent
        time.sleep(0.5)
    raise SystemExit(f"not within {seconds:.0f} s: {what}")


def main(work: Path, config: Path) -> None:
    plan = json.loads((work / "plan.json").read_text())
    service, broker = (Image(**of | {"root": Path(of["root"])}) for of in plan)
    folders = {name: work / f"volume-{name}" for name in ("broker", "keys", "scrape", "state")}
    for folder in folders.values():
        folder.mkdir()
        folder.chmod(0o700)
        subprocess.run(["chown", "10001:10001", str(folder)], check=True)
    hosts = f"{work}/hosts:/etc/hosts"

    def command(image: Image, words: list[str], binds: list[str]) -> list[str]:
        return chroot(image, words, binds=[hosts, *binds], environment=image.environment, user=image.user, read_only=True)

    def start(name: str, image: Image, words: list[str], binds: list[str]) -> None:
        log = (work / f"{name}.log").open("w")
        # The flight is in real time: what else this machine does must not hold it up.
        urgent = ["nice", "-n", "-10", *command(image, words, binds)]
        children[name] = subprocess.Popen(
            urgent, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, text=True, start_new_session=True
        )

    def ask(image: Image, words: list[str], binds: list[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(command(image, words, binds), capture_output=True, text=True, check=False)

    children: dict[str, subprocess.Popen[str]] = {}
    keys, state = f"{folders['keys']}:/keys", f"{folders['state']}:/var/lib/decklander:rw"
    scrape = f"{folders['scrape']}:/scrape"
    try:
        start("broker", broker, broker.entry, [f"{folders['broker']}:/var/lib/mosquitto:rw", f"{keys}:rw", f"{scrape}:rw"])
        sub = ["mosquitto_sub", "-h", "localhost", "-p", "8883", "--cafile", "/keys/ca.crt"]
        ground = ["-u", "ground", "-P", '"$(cat /keys/ground.password)"']
        alive = ["sh", "-c", " ".join([*sub, *ground, "-t", "decklander/v2/#", "-E", "-W", "2"])]
        _until("the broker answers in TLS", lambda: ask(broker, alive, [keys]).returncode == 0, 60, children)
        wrong = ["sh", "-c", " ".join([*sub, "-u", "ground", "-P", "guess", "-t", "'#'", "-E", "-W", "2"])]
        assert ask(broker, wrong, [keys]).returncode != 0, "the broker lets in whoever guesses"
        drone = ["python", "-m", "sitl.emulators.ardrone.serve", "demo", "--host", "0.0.0.0", "--seed", "1", "--repeat"]
        start("sim", service, drone, [])
        _until("the simulated drone listens", lambda: '"ready"' in (work / "sim.log").read_text(), 60, children)
        lent = [f"{config}:/etc/decklander/rig.toml", keys, scrape, state]
        start("daemon", service, [*service.entry, "run", "--config", "/etc/decklander/rig.toml"], lent)
        _until("the health check says yes", lambda: ask(service, service.health, []).returncode == 0, 60, children)
        print(f"image runs as: {ask(service, ['id'], []).stdout.strip()}", flush=True)
        assert ask(service, ["touch", "/usr/x"], []).returncode != 0, "the root can be written to"
        on_message = ["sh", "-c", " ".join([*sub, *ground, "-t", "decklander/v2/sea/state", "-C", "1", "-W", "20"])]
        received_at = ask(broker, on_message, [keys])
        assert "belief" in json.loads(received_at.stdout), received_at.stderr
        _until("it stands on the pad", lambda: '"on_pad":true' in (work / "sim.log").read_text(), LANDED_S, children)
        flying = '"flying":true'
        _until("the next flight has begun", lambda: flying in ask(broker, on_message, [keys]).stdout, 60, children)
        token = (folders["scrape"] / "metrics.token").read_text().strip()
        scraping = urllib.request.Request("http://127.0.0.1:8480/metrics", headers={"Authorization": f"Bearer {token}"})
        text = urllib.request.urlopen(scraping, timeout=5).read().decode()
        wanted = set(re.findall(r"decklander_\w+", DASHBOARD.read_text()))
        missing = sorted(name for name in wanted if not re.search(rf"^# TYPE {name} ", text, re.MULTILINE))
        assert missing == [], f"the dashboard asks for what is not told: {missing}"
        print(f"the dashboard's {len(wanted)} figures are all told; the simulated drone said:", flush=True)
        print(*(line for line in (work / "sim.log").read_text().splitlines() if "flight" in line), sep="\n", flush=True)
    finally:
        # unshare itself is deaf to SIGTERM, and a process that changed its user outlives it: the group is what ends.
        for number in (signal.SIGTERM, signal.SIGKILL):
            for child in children.values():
                with suppress(ProcessLookupError):
                    os.killpg(child.pid, number)
            time.sleep(1.0)
        for child in children.values():
            child.wait()
        for name in children:
            tail = (work / f"{name}.log").read_text().splitlines()[-4:]
            print(*(f"{name}: {line}" for line in tail), sep="\n", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
