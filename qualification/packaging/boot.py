"""The Debian package and the commands of installation on a booted Debian: systemd as the first process of a container.

    python -m qualification.packaging.boot --system debian13 --deb FILE [--work DIR] [--keep]

Needs root, debootstrap and a Debian mirror. systemd starts in namespaces of its own, in a bare root; there dpkg installs the
package, the service comes up under its unit, updates to a good and to a bad version, returns, refuses to be touched while a
simulated drone flies, and is removed. Each step prints what it took.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

from supply import deb

ROOT = Path(__file__).parents[2]
MIRROR = "http://deb.debian.org/debian"
SYSTEMS = [name for name in deb.SYSTEMS if name.startswith("debian")]
"""Systems whose mirror is in reach: Ubuntu's is not."""
PACKAGES = "systemd,systemd-sysv,udev,dbus,python3,python3-venv,iproute2"
_SPACES = ("--mount", "--pid", "--net", "--cgroup", "--uts", "--ipc")
BOOT_S, LONG_S = 120.0, 900.0
# Devices are made, not lent, and the kernel's settings are read only: what boots in there must not change this machine. The root
# is shared as a container manager makes it: systemd mounts a unit's credentials from a namespace of its own.
_BOOT = """set -e
r={root}
mount --make-rprivate / && mount --bind $r $r && mount --make-shared $r
mount -t proc proc $r/proc && mount -t sysfs -o ro sysfs $r/sys
mount --bind $r/proc/sys $r/proc/sys && mount -o remount,ro,bind $r/proc/sys
for f in dev run; do mount -t tmpfs -o mode=755 tmpfs $r/$f; done
while read n major minor; do mknod -m 666 $r/dev/$n c $major $minor; done << END
null 1 3
zero 1 5
full 1 7
random 1 8
urandom 1 9
tty 5 0
END
mkdir $r/dev/pts $r/dev/shm && mount -t devpts -o newinstance,ptmxmode=666 devpts $r/dev/pts && ln -s pts/ptmx $r/dev/ptmx
ln -s /proc/self/fd $r/dev/fd
mount -t cgroup2 cgroup2 $r/sys/fs/cgroup
ip link set lo up
cd $r && exec env -i container=decklander PATH=/usr/sbin:/usr/bin:/sbin:/bin chroot $r /sbin/init
"""


class Failed(Exception):
    """Something was not as it must be."""


class Guest:
    """A booted root."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._unshare = subprocess.Popen(
            ["unshare", *_SPACES, "--fork", "--kill-child", "sh", "-c", _BOOT.format(root=root)],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        children = Path(f"/proc/{self._unshare.pid}/task/{self._unshare.pid}/children")
        until("the first process is there", lambda: children.read_text().strip(), BOOT_S)
        self._init = children.read_text().split()[0]
        until(
            "systemd has booted",
            lambda: self.run("systemctl is-system-running").stdout.strip() in ("running", "degraded"),
            BOOT_S,
        )

    def run(self, command: str) -> subprocess.CompletedProcess[str]:
        clean = ["env", "-i", "PATH=/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "HOME=/tmp"]
        inside = ["chroot", str(self.root), *clean, "sh", "-c"]
        return subprocess.run(
            ["nsenter", "--target", self._init, *_SPACES, "--", *inside, command],
            stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=LONG_S,
        )  # fmt: skip

    def expect(self, command: str, code: int, *told: str) -> str:
        """Run a command, hold it to its exit code and to what it must say, and print both."""
        began = time.monotonic()
        done = self.run(command)
        output = done.stdout + done.stderr
        missing = [text for text in told if not re.search(text, output)]
        print(f"{time.monotonic() - began:7.1f} s  {command} -> {done.returncode}", flush=True)
        for line in output.strip().splitlines()[-3:]:
            print(f"           {line[:180]}", flush=True)
        if done.returncode != code or missing:
            raise Failed(f"{command}: ended with {done.returncode}, not {code}; not told: {missing}\n{output}")
        return output

    def stop(self) -> None:
        self._unshare.kill()
        self._unshare.wait()


def until(what: str, condition: Callable[[], object], seconds: float) -> None:
    began = time.monotonic()
    while not condition():
        if time.monotonic() - began > seconds:
            raise Failed(f"not within {seconds:.0f} s: {what}")
        time.sleep(0.5)
    print(f"{time.monotonic() - began:7.1f} s  until {what}", flush=True)


def another(package: Path, version: str, broken: str = "") -> str:
    """Make a package of another version, and return its name; `broken` goes in front of the code of `decklander run`."""
    made = f"{version}.deb"
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work, "package")
        subprocess.run(["dpkg-deb", "--raw-extract", str(package), str(folder)], check=True)
        (wheel,) = (folder / deb.CARRIED).glob("decklander-*.whl")
        with zipfile.ZipFile(wheel) as source, zipfile.ZipFile(Path(work, "made.whl"), "w") as target:
            for name in source.namelist():
                proven = b"    proven = Proven(settings)\n"
                changed = broken.encode() + proven if name == "companion/cli/run.py" else proven
                target.writestr(name, source.read(name).replace(proven, changed))
        Path(work, "made.whl").replace(wheel)
        control, script = folder / "DEBIAN/control", folder / "DEBIAN/postinst"
        control.write_text(re.sub(r"(?m)^Version: .*", f"Version: {version}", control.read_text()))
        script.write_text(re.sub(re.escape(current(script)), version, script.read_text()))
        subprocess.run(["dpkg-deb", "-Znone", "--build", str(folder), str(package.parent / made)], check=True)
    return made


def current(script: Path) -> str:
    """Return the name of the folder that a package's script makes the current one."""
    return re.findall(r"^turn (\S+)$", script.read_text(), re.MULTILINE)[0]


def fly(guest: Guest) -> None:
    """All that a person does with an installation, from nothing to nothing."""
    link = guest.root / f"{deb.PREFIX}/current".lstrip("/")
    guest.expect("dpkg -i /decklander.deb", 0, f"next: decklander start --out {deb.SETTINGS}")
    guest.expect("decklander --version", 0, "decklander [0-9]")
    # The very command that was printed, at a terminal; a person who knows nothing takes what is offered. There is no drone.
    asks = f"script --quiet --return --command 'decklander start --out {deb.SETTINGS}' /dev/null"
    guest.expect(f"yes '' | head -n 40 | {asks}", 1, "no navdata comes from", "start the service: +systemctl start decklander")
    guest.expect(f"decklander config check {deb.SETTINGS}", 0)
    shutil.copyfile(ROOT / "configs/sim.toml", guest.root / "etc/decklander/rig.toml")
    # A busy machine is no failure.
    patient = guest.root / "etc/systemd/system/decklander.service.d/patient.conf"
    patient.parent.mkdir(parents=True)
    patient.write_text("[Service]\nTimeoutStartSec=300\nWatchdogSec=120\n")
    guest.expect("systemctl daemon-reload && systemctl start decklander", 0)
    until("the unit is active", lambda: guest.run("systemctl is-active decklander").stdout == "active\n", 60)
    first = os.readlink(link)
    guest.expect("stat -c '%U %a' /var/lib/private/decklander && systemctl is-enabled decklander", 0, "decklander 700", "enabled")
    package = guest.root / "decklander.deb"
    good, bad = another(package, "9.1"), another(package, "9.2", "    raise SystemExit(1)\n")
    guest.expect(f"dpkg -i /{good}", 1, "the drone flies, or the service cannot say")
    guest.expect("systemctl stop decklander && dpkg -i /decklander.deb && systemctl start decklander", 0)
    sim = "systemd-run --quiet --collect --unit sim /opt/decklander/current/bin/python -m sitl.emulators.ardrone.serve demo"
    for command in (f"dpkg -i /{good}", "dpkg -r decklander"):
        guest.expect(f"systemctl stop decklander sim 2>/dev/null; {sim} --host 127.0.0.1 --seed 1", 0)
        guest.expect("systemctl start decklander", 0)
        until("the drone flies", lambda: '"flying":true' in guest.run("decklander fly status --json").stdout, 120)
        guest.expect(command, 1, "the drone flies")
    guest.expect("systemctl is-active decklander", 0)
    assert os.readlink(link) == first
    # It stays there: a service that has lost its drone cannot say that it stands.
    until("the drone stands", lambda: '"flying":false' in guest.run("decklander fly status --json").stdout, 300)
    guest.expect(f"dpkg -i /{bad}", 1, f"version 9.2 does not come up .* {re.escape(first)} is current again")
    guest.expect("systemctl stop sim decklander; echo '[recorder]\ncolors = 1' >> /etc/decklander/rig.toml", 0)
    guest.expect(f"dpkg -i /{good}", 1, "recorder.colors")
    guest.expect("sed -i '$d' /etc/decklander/rig.toml && sed -i '$d' /etc/decklander/rig.toml", 0)
    guest.expect("dpkg --configure decklander", 0)
    assert os.readlink(link) == "9.1"
    guest.expect("dpkg -r decklander", 0)
    guest.expect(f"test ! -e {deb.PREFIX} && test -e {deb.SETTINGS} && test -d /var/lib/private/decklander", 0)
    guest.expect("dpkg -P decklander", 0)
    guest.expect("ls -d /opt/decklander /etc/decklander /var/lib/decklander /var/lib/private/decklander 2>/dev/null", 2)


def main(
    what: str = "Installation on a booted Debian.",
    packages: str = PACKAGES,
    prepare: Callable[[Path, Path], None] = lambda root, package: None,
    act: Callable[[Guest], None] = fly,
) -> int:
    """Boot a bare root with some packages, and act on it.

    Args:
        prepare: changes the root before it is booted, given with the Debian package.
    """
    parser = argparse.ArgumentParser(description=what)
    parser.add_argument("--deb", type=Path, required=True)
    parser.add_argument("--system", choices=SYSTEMS, required=True, help="the system that the package is for")
    parser.add_argument("--work", type=Path, help="working folder; a base made there before is used again")
    parser.add_argument("--keep", action="store_true", help="leave it")
    asked = parser.parse_args()
    if os.geteuid() != 0 or shutil.which("debootstrap") is None:
        print("this needs root and debootstrap (apt install debootstrap)", file=sys.stderr)
        return 2
    work = asked.work or Path(tempfile.mkdtemp(prefix="decklander-boot-"))
    base, root = work / "base", work / "root"
    if not (base / "usr/bin/systemctl").exists():
        subprocess.run(
            ["debootstrap", "--variant=minbase", f"--include={packages}", deb.SYSTEMS[asked.system].codename, str(base), MIRROR],
            check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
    shutil.rmtree(root, ignore_errors=True)
    subprocess.run(["cp", "--archive", "--reflink=auto", str(base), str(root)], check=True)
    shutil.copyfile(asked.deb, root / "decklander.deb")
    prepare(root, asked.deb.resolve())
    guest = Guest(root)
    try:
        act(guest)
    except Failed as why:
        print(f"FAILED: {why}\n{guest.run('journalctl --unit decklander --no-pager --lines 30').stdout}", file=sys.stderr)
        return 1
    finally:
        guest.stop()
        if not asked.keep:
            shutil.rmtree(root, ignore_errors=True)
            if asked.work is None:
                shutil.rmtree(work, ignore_errors=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
