"""The images without an engine: their Dockerfiles' own steps, in roots made by debootstrap, up to a landing in them.

    python -m qualification.packaging.image [--work DIR] [--config FILE] [--keep]

Needs root, debootstrap and whatever this machine uses to reach Debian's and Python's packages. Each step is read from the
Dockerfiles, so that the two cannot drift. Then compose.yaml's broker, sim and daemon run from those roots as its user, the roots
read-only, in a network of their own, until the simulated drone has landed on the pad, the health check says yes, Prometheus'
endpoint has every figure of the dashboard and the ground receives the drone through TLS. Times are printed.
"""

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
SUITES = {"debian:trixie-slim": "trixie"}
MIRROR = "http://deb.debian.org/debian"
_KNOWN = {"RUN", "COPY", "WORKDIR", "ENV", "USER", "HEALTHCHECK", "ENTRYPOINT", "CMD", "LABEL", "ARG"}


@dataclass(frozen=True, slots=True)
class Step:
    """One instruction."""

    word: str
    text: str


@dataclass(slots=True)
class Stage:
    """Stage of a Dockerfile, from one FROM to the next."""

    base: str
    name: str
    steps: list[Step] = field(default_factory=list)


def stages(dockerfile: str) -> list[Stage]:
    """Return the stages of a Dockerfile.

    Raises:
        ValueError: an instruction that is not understood here.
    """
    found: list[Stage] = []
    lines = [line for line in dockerfile.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    for instruction in re.sub(r"\\\n\s*", " ", "\n".join(lines)).splitlines():
        word, _, text = instruction.partition(" ")
        if word == "FROM":
            base, _, name = text.partition(" AS ")
            found.append(Stage(base, name or str(len(found))))
        elif word in _KNOWN:
            found[-1].steps.append(Step(word, text.strip()))
        else:
            raise ValueError(f"not understood: {instruction}")
    return found


@dataclass(slots=True)
class Image:
    """Image that the steps have made so far."""

    root: Path
    environment: dict[str, str] = field(default_factory=lambda: {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin"})
    folder: str = "/"
    user: str = "root"
    health: list[str] = field(default_factory=list)
    entry: list[str] = field(default_factory=list)


class Builder:
    """Makes images of Dockerfiles under one working folder."""

    def __init__(self, work: Path) -> None:
        self.work = work
        self._bases: dict[str, Path] = {}
        self._pip = _pip_files()

    def build(self, dockerfile: Path) -> Image:
        """Return the last stage of it."""
        made: dict[str, Image] = {}
        for stage in stages(dockerfile.read_text()):
            image = Image(self.work / f"{dockerfile.stem}-{stage.name}")
            self._timed(f"FROM {stage.base}", lambda base=stage.base, to=image.root: self._copy_base(base, to))
            for step in stage.steps:
                self._timed(f"{step.word} {step.text}", lambda step=step, image=image: self._do(step, image, made))
            made[stage.name] = image
        return image

    def _timed(self, what: str, handler: object) -> None:
        began = time.monotonic()
        handler()  # type: ignore[operator]
        print(f"{time.monotonic() - began:7.1f} s  {what[:110]}", flush=True)

    def _copy_base(self, base: str, to: Path) -> None:
        if base not in self._bases:
            self._bases[base] = root = self.work / "base"
            if not (root / "usr/bin/apt-get").exists():
                subprocess.run(
                    ["debootstrap", "--variant=minbase", SUITES[base], str(root), MIRROR], check=True, stdout=subprocess.DEVNULL
                )
        subprocess.run(["cp", "--archive", "--reflink=auto", str(self._bases[base]), str(to)], check=True)

    def _do(self, step: Step, image: Image, made: dict[str, Image]) -> None:
        match step.word:
            case "RUN":
                self.run_in(image, step.text)
            case "COPY":
                self._copy(step.text.split(), image, made)
            case "WORKDIR":
                image.folder = step.text
                (image.root / step.text.lstrip("/")).mkdir(parents=True, exist_ok=True)
            case "ENV":
                name, _, value = step.text.partition("=")
                image.environment[name] = value
            case "USER":
                image.user = step.text
            case "HEALTHCHECK":
                image.health = json.loads(step.text[step.text.index("CMD ") + 4 :])
            case "ENTRYPOINT":
                image.entry = json.loads(step.text)

    def _copy(self, words: list[str], image: Image, made: dict[str, Image]) -> None:
        source = ROOT
        if words[0].startswith("--from="):
            source = made[words.pop(0).removeprefix("--from=")].root
        target = words[-1] if words[-1].startswith("/") else f"{image.folder}/{words[-1]}"
        to = image.root / target.lstrip("/")
        for word in words[:-1]:
            if word.endswith("*") and not [*source.glob(word)]:
                continue
            origin = source / word.lstrip("/")
            ignored = shutil.ignore_patterns("__pycache__") if source == ROOT else None
            if origin.is_dir():
                shutil.copytree(origin, to, symlinks=True, dirs_exist_ok=True, ignore=ignored)
            else:
                place = to / origin.name if words[-1].endswith("/") or to.is_dir() else to
                place.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(origin, place)

    def run_in(self, image: Image, command: str) -> None:
        """Execute a RUN, with this machine's way to packages lent to it and to nobody after it."""
        lent = ["/etc/resolv.conf", *map(str, self._pip)]
        environment = {**image.environment, "DEBIAN_FRONTEND": "noninteractive"}
        if self._pip:
            environment["PIP_CONFIG_FILE"] = str(self._pip[0] / "pip.conf")
        subprocess.run(chroot(image, ["/bin/sh", "-c", command], binds=lent, environment=environment, user="root"), check=True)


def chroot(
    image: Image, command: list[str], *, binds: list[str], environment: dict[str, str], user: str, read_only: bool = False
) -> list[str]:
    """Return the command line that runs another in a root of its own.

    Args:
        binds: "PATH" or "HOST:PATH", lent for reading only; "HOST:PATH:rw" for writing too.
    """
    root = shlex.quote(str(image.root))
    script, mounts = ["set -e", f"mount --bind {root} {root}"], []
    for bind in binds:
        host, _, path = bind.removesuffix(":rw").partition(":")
        target = shlex.quote(str(image.root) + (path or host))
        if Path(host).is_dir():
            script.append(f"mkdir -p {target}")
        else:
            script.append(f"mkdir -p $(dirname {target}); test -e {target} || touch {target}")
        mounts.append(f"mount --bind {shlex.quote(host)} {target}")
        if not bind.endswith(":rw"):
            mounts.append(f"mount -o remount,ro,bind {target}")
    if read_only:
        script += [f"mount -o remount,ro,bind {root}", f"mount -t tmpfs tmpfs {root}/tmp"]
    script += [f"mount -t proc proc {root}/proc", f"mount -t tmpfs tmpfs {root}/dev"]
    for node in ("null", "zero", "full", "random", "urandom", "tty"):
        script.append(f"touch {root}/dev/{node}; mount --bind /dev/{node} {root}/dev/{node}")
    script += [f"mkdir -m 1777 {root}/dev/shm; ln -s /proc/self/fd {root}/dev/fd", *mounts]
    identity = [] if user == "root" else [f"--userspec={user}:{user}"]
    inner = f"cd {image.folder} && exec {shlex.join(command)}"
    words = ["env", "-i", *(f"{name}={value}" for name, value in environment.items()), "sh", "-c", inner]
    script.append(f"exec chroot {shlex.join([*identity, str(image.root), *words])}")
    return ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", "\n".join(script)]


def _pip_files() -> list[Path]:
    """Pip's configuration of this machine in a folder, with a copy of the files that it names; then the folders it names."""
    output = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, check=False).stdout
    options = dict(re.findall(r"^(?:global|:env:)\.([\w-]+)='(.*)'$", output, re.MULTILINE))
    if not options:
        return []
    lent = Path(tempfile.mkdtemp(prefix="decklander-pip-"))
    files = [name for name in ("cert", "constraint") if name in options]
    for name in files:
        options[name] = str(shutil.copy(options[name], lent / f"{name}.txt"))
    wanted = {
        name: " ".join(value.replace("\\n", " ").split())
        for name, value in options.items()
        if name != "disable-pip-version-check"
    }
    (lent / "pip.conf").write_text("[global]\n" + "".join(f"{name} = {value}\n" for name, value in wanted.items()))
    places = re.findall(r"(?:file://)?(/[^\s'\\]+)", " ".join(value for name, value in wanted.items() if name not in files))
    folders = {Path(place).parent if place.endswith("/simple") else Path(place) for place in places}
    return [lent, *sorted(folder for folder in folders if folder.is_dir())]


def main() -> int:
    parser = argparse.ArgumentParser(description="The images' own steps without an engine, up to a landing.")
    parser.add_argument("--work", type=Path, help="working folder; a base made there before is used again")
    parser.add_argument("--config", type=Path, help="settings to fly with instead of compose's own, on a slow machine")
    parser.add_argument("--keep", action="store_true", help="leave it")
    asked = parser.parse_args()
    if os.geteuid() != 0 or shutil.which("debootstrap") is None:
        print("this needs root and debootstrap (apt install debootstrap)", file=sys.stderr)
        return 2
    from qualification.packaging.image_flight import CONFIG, fly

    work = asked.work or Path(tempfile.mkdtemp(prefix="decklander-image-"))
    work.mkdir(parents=True, exist_ok=True)
    for old in work.iterdir():
        if old.name != "base":
            shutil.rmtree(old)
    try:
        builder = Builder(work)
        service = builder.build(ROOT / "Dockerfile")
        broker = builder.build(ROOT / "configs/compose/broker.Dockerfile")
        builder.build(ROOT / "configs/compose/lab.Dockerfile")
        fly(work, service, broker, asked.config or CONFIG)
    finally:
        if not asked.keep and asked.work is None:
            shutil.rmtree(work)
    return 0


if __name__ == "__main__":
    sys.exit(main())
