"""The steps of a Raspberry Pi's card (configs/card) on a bare Debian 13, and its first two boots, without the image builder.

    python -m qualification.packaging.card --system debian13 --deb FILE [--work DIR] [--keep]

Needs what `qualification.packaging.boot` needs. The layer's packages that Debian has are installed, its hook runs as it is
written there, and systemd boots the root: the page answers with the token that the first boot made, the UART has no console,
and no account has a password. The packages of Raspberry Pi's own archive, its kernel and its boot loader are not tried: a
stand-in of picamera2 has the camera, and no UART is there.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from qualification.packaging import boot

CARD = boot.ROOT / "configs/card"
LAYER = (CARD / "layer/decklander.yaml").read_text()
OF_THE_PI = ("python3-picamera2", "rpicam-apps-lite")
_PAGE = (
    "/opt/decklander/current/bin/python -c 'import ssl, urllib.request as r; "
    'print(r.urlopen(r.Request("https://127.0.0.1:8480/{path}", headers={{"Host": "decklander.local:8480", "Authorization": '
    '"Bearer " + open("{token}").read().strip()}}), context=ssl._create_unverified_context()).status)\''
)
_TOKEN = "/etc/credstore/decklander.page"


def packages() -> list[str]:
    """Return the layer's packages."""
    return re.findall(r"^    - (\S+)$", LAYER.partition("packages:")[2].partition("customize-hooks:")[0], re.MULTILINE)


def prepare(root: Path, package: Path) -> None:
    """Let the layer's hook make a card of a root that has the boot files of Raspberry Pi OS."""
    firmware = root / "boot/firmware"
    firmware.mkdir(parents=True, exist_ok=True)
    (firmware / "cmdline.txt").write_text("console=serial0,115200 console=tty1 root=ROOTDEV rootwait\n")
    (firmware / "config.txt").write_text("[all]\ncamera_auto_detect=1\n")
    (root / "etc/hostname").write_text("decklander\n")
    (hook,) = re.findall(r"^    - (sh .*)$", LAYER, re.MULTILINE)
    given = {"IGconf_decklander_package": str(package), "IGconf_decklander_profile": "raspberry_ardupilot"}
    subprocess.run(["sh", "-c", hook, "hook", str(root)], cwd=CARD, env=os.environ | given, check=True)
    (library,) = (root / "opt/decklander").glob("[0-9]*/lib/python3.*/site-packages")
    shutil.copy(boot.ROOT / "tests/support/stand_in_pi/picamera2.py", library)
    # A busy machine is no failure.
    patient = root / "etc/systemd/system/decklander.service.d/patient.conf"
    patient.parent.mkdir(parents=True)
    patient.write_text("[Service]\nTimeoutStartSec=300\nWatchdogSec=120\n")


def act(guest: boot.Guest) -> None:
    """Do what a person does with a new card, and boot it again."""
    boot.until("the unit is active", lambda: guest.run("systemctl is-active decklander").stdout == "active\n", 120)
    guest.expect("cat /etc/issue.d/decklander.issue", 0, r"open https://\S+:8480/ and enter the token", _TOKEN)
    guest.expect(f"stat -c '%U %a' {_TOKEN} {_TOKEN}-key", 0, "root 600\nroot 600")
    guest.expect("openssl x509 -noout -subject -ext subjectAltName -in /etc/decklander/page.crt", 0, r"DNS:\S+\.local")
    guest.expect(_PAGE.format(path="", token="/dev/null"), 0, "200")
    guest.expect(_PAGE.format(path="metrics", token="/dev/null"), 1, "401")
    guest.expect(_PAGE.format(path="metrics", token=_TOKEN), 0, "200")
    guest.expect("decklander config check /etc/decklander/rig.toml", 0)
    guest.expect("cat /boot/firmware/cmdline.txt", 0, "^console=tty1 root=ROOTDEV rootwait")
    guest.expect("tail -1 /boot/firmware/config.txt", 0, "enable_uart=1")
    guest.expect("systemctl is-enabled serial-getty@ttyAMA0 serial-getty@serial0", 1, "masked")
    guest.expect("awk -F: '$2 !~ /^[!*]/' /etc/shadow | grep .", 1)
    token = guest.run(f"cat {_TOKEN}").stdout
    guest.stop()
    again = boot.Guest(guest.root)
    try:
        boot.until("the unit is active", lambda: again.run("systemctl is-active decklander").stdout == "active\n", 120)
        again.expect("systemctl show --property=ConditionResult decklander-first-boot", 0, "ConditionResult=no")
        again.expect(f"cat {_TOKEN} | wc -c", 0, str(len(token)))
        if again.run(f"cat {_TOKEN}").stdout != token:
            raise boot.Failed("the second boot made another token")
    finally:
        again.stop()


if __name__ == "__main__":
    of_debian = [name for name in packages() if name not in OF_THE_PI]
    print(f"{', '.join(of_debian)} from Debian; not tried: {', '.join(OF_THE_PI)}", flush=True)
    sys.exit(boot.main("The steps of a card.", ",".join((boot.PACKAGES, *of_debian)), prepare, act))
