"""A throw-away virtual machine with a kernel of Debian's, this file system read-only, the vivid camera and a USB bus of its own.

Nothing is installed into it: its first file system holds busybox and kernel modules; then it goes over to the host's own tree.
"""

import json
import lzma
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
MODULES = ("virtio_pci", "9pnet_virtio", "9p", "virtio_rng", "vivid", "vhci-hcd", "uvcvideo")
MARK = "@@ "
"""Begins a line that the guest reports; the value after it is JSON."""

INIT = """#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin:/usr/bin:/usr/sbin:/sbin
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev
for m in {modules}; do insmod /modules/$m {options}; done 2>/dev/null
mount -t 9p -o ro,trans=virtio,version=9p2000.L,cache=loose,msize=1048576 host /host || echo "no host tree"
mount --bind /proc /host/proc; mount --bind /sys /host/sys; mount --bind /dev /host/dev
mount -t tmpfs scratch /host/mnt
cd /host
chroot /host /usr/bin/env -i PATH=/usr/bin:/bin HOME=/mnt TMPDIR=/mnt PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1 \\
  PYTHONPYCACHEPREFIX='{bytecode}' \\
  sh -c "cd '{root}' && exec '{python}' -m qualification.v4l2_vm.guest" > /dev/ttyS0 2>&1
poweroff -f
"""


def kernel() -> Path | None:
    """Return the newest kernel image whose modules hold vivid."""
    images = sorted(Path("/boot").glob("vmlinuz-*"), reverse=True)
    return next((i for i in images if any(_modules(i).glob("kernel/drivers/media/test-drivers/vivid/vivid.ko*"))), None)


def missing() -> str | None:
    """Return the reason why the machine cannot be made here, None for none."""
    if shutil.which("qemu-system-x86_64") is None:
        return "qemu-system-x86_64 is not installed (Debian: qemu-system-x86)"
    if shutil.which("busybox") is None:
        return "busybox is not installed (Debian: busybox-static)"
    image = kernel()
    if image is None:
        return "there is no kernel image with the vivid module in /boot (Debian: linux-image-amd64)"
    if not os.access(image, os.R_OK):
        return f"{image} cannot be read by this user"
    return None


def run(timeout_s: float) -> list[dict[str, Any]]:
    """Boot, run `qualification.v4l2_vm.guest` inside, power off; what it reported.

    Raises:
        RuntimeError: the guest did not end by itself, or said nothing; with the end of its console.
    """
    image = kernel()
    assert image is not None
    # The bytecode of what the guest imports: emulated, compiling would take ten times as long.
    subprocess.run([sys.executable, "-c", "import qualification.v4l2_vm.guest"], cwd=ROOT, check=True)
    with tempfile.TemporaryDirectory(prefix="decklander-vm-") as folder:
        initramfs = Path(folder) / "initramfs.cpio"
        initramfs.write_bytes(_initramfs(image))
        command = [
            "qemu-system-x86_64", "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2", "-m", "1024",
            "-nodefaults", "-no-user-config", "-display", "none", "-no-reboot", "-serial", "stdio",
            "-device", "virtio-rng-pci",
            "-kernel", str(image), "-initrd", str(initramfs),
            "-append", "console=ttyS0 quiet panic=-1 mitigations=off tsc=reliable random.trust_cpu=on",
            "-fsdev", "local,id=host,path=/,security_model=none,readonly=on,multidevs=remap",
            "-device", "virtio-9p-pci,fsdev=host,mount_tag=host",
        ]  # fmt: skip
        try:
            done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=timeout_s, check=False)
            console = done.stdout.decode(errors="replace") + done.stderr.decode(errors="replace")
        except subprocess.TimeoutExpired as why:
            console = f"{(why.stdout or b'').decode(errors='replace')}\n(stopped after {timeout_s:g} s)"
    reports = [json.loads(line.partition(MARK)[2]) for line in console.splitlines() if MARK in line]
    if not reports or reports[-1].get("name") != "end":
        raise RuntimeError("the guest did not come to its end:\n" + console[-4000:])
    return reports


def _modules(image: Path) -> Path:
    return Path("/lib/modules") / image.name.removeprefix("vmlinuz-")


def _initramfs(image: Path) -> bytes:
    modules = _with_dependencies(_modules(image), MODULES)
    names = {path: f"{i:02d}-{path.name.removesuffix('.xz')}" for i, path in enumerate(modules)}
    # One camera, frames only, in one plane; a second would only cost time.
    options = "$(case $m in *vivid*) echo n_devs=1 node_types=0x1 multiplanar=1;; esac)"
    where = {"root": ROOT, "python": _python(), "bytecode": sys.pycache_prefix or ""}
    init = INIT.format(modules=" ".join(names.values()), options=options, **where)
    busybox = shutil.which("busybox")
    assert busybox is not None
    folders = [(name, 0o040755, b"") for name in ("bin", "dev", "proc", "sys", "host", "modules")]
    files = [("init", 0o100755, init.encode()), ("bin/busybox", 0o100755, Path(busybox).read_bytes())]
    files += [(f"modules/{name}", 0o100644, _plain(path)) for path, name in names.items()]
    return _cpio([*folders, *files])


def _python() -> Path:
    """This very interpreter, not followed through the links of its environment."""
    return Path(sys.executable)


def _plain(path: Path) -> bytes:
    data = path.read_bytes()
    return lzma.decompress(data) if path.suffix == ".xz" else data


def _with_dependencies(folder: Path, wanted: Iterable[str]) -> list[Path]:
    """Files of modules, each behind all it needs (modules.dep lists the nearest need first); built-in ones have none."""
    needs: dict[str, list[str]] = {}
    for line in (folder / "modules.dep").read_text().splitlines():
        file, _, rest = line.partition(":")
        needs[file] = rest.split()
    stems = {Path(file).name.partition(".")[0].replace("-", "_"): file for file in needs}
    order: list[str] = []
    for name in (name.replace("-", "_") for name in wanted):
        if name in stems:
            order += [*reversed(needs[stems[name]]), stems[name]]
    return [folder / file for file in dict.fromkeys(order)]


def _cpio(entries: Iterable[tuple[str, int, bytes]]) -> bytes:
    """Return an archive in the kernel's "newc" form (Documentation/driver-api/early-userspace/buffer-format.rst)."""
    out = bytearray()
    for number, (name, mode, data) in enumerate([*entries, ("TRAILER!!!", 0, b"")], 1):
        fields = [number, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(name) + 1, 0]
        out += b"070701" + b"".join(b"%08x" % f for f in fields) + name.encode() + b"\0"
        out += b"\0" * (-len(out) % 4)
        out += data
        out += b"\0" * (-len(out) % 4)
    return bytes(out)
