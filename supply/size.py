"""Print how large an installed environment is, and its largest packages: `python -m supply.size /opt/decklander/current`.

`--make FOLDER` first makes the environment of the pins there and takes out of it what the service does not use, as the Debian
package and the image do. `--wheel FILE` prints a table of what pip installs for the wheel and each of its extras, beside other
libraries (`make size`).
"""

import argparse
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
SHOWN = 12
BESIDE = ("pupil-apriltags", "gymnasium", "foxglove-sdk")
"""Libraries that a person compares with."""
_APART = ("dev", "witness")


def size_mb(path: Path) -> float:
    """Return the size of a file, or of all files below a folder, in MB of 10^6 bytes; links count nothing."""
    files = [path] if path.is_file() else path.rglob("*")
    return sum(file.lstat().st_size for file in files if file.is_file() and not file.is_symlink()) / 1e6


def make(folder: Path, checkout: Path = ROOT) -> None:
    """Make an environment of the pinned dependencies and a checkout, without what the service does not use.

    Raises:
        subprocess.CalledProcessError: a package cannot be had or built.
    """
    pip = [str(folder / "bin/python"), "-m", "pip", "--quiet", "--disable-pip-version-check", "install", "--no-cache-dir"]
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    for pins in ("build", "runtime"):
        subprocess.run([*pip, "--require-hashes", "-r", str(ROOT / f"requirements/{pins}.txt")], check=True)
    subprocess.run([*pip, "--no-deps", "--no-build-isolation", str(checkout)], check=True)
    build = (line.partition("==")[0] for line in (ROOT / "requirements/build.txt").read_text().splitlines() if "==" in line)
    runtime = (ROOT / "requirements/runtime.txt").read_text()
    only_build = [name for name in build if f"\n{name}==" not in f"\n{runtime}"]
    subprocess.run([*pip[:-2], "uninstall", "--yes", *only_build], check=True)
    subprocess.run(["sh", str(ROOT / "requirements/slim.sh"), str(folder)], check=True)


def table(wheel: Path) -> Iterator[str]:
    """Yield the rows of a table: what pip installs into an empty environment for the wheel, each extra, and `BESIDE`.

    Raises:
        subprocess.CalledProcessError: a package cannot be had.
    """
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    ours = {f"decklander[{extra}]": f"{wheel}[{extra}]" for extra in sorted(extras, key="all".__eq__) if extra not in _APART}
    yield from ("| pip install | packages | MB | seconds |", "|---|---|---|---|")
    for name, wanted in {"decklander": str(wheel), **ours, **dict(zip(BESIDE, BESIDE, strict=True))}.items():
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
            pip = (sys.executable, "-m", "pip", "--python", folder, "--quiet", "--disable-pip-version-check")
            began = time.monotonic()
            subprocess.run([*pip, "install", wanted], check=True, stderr=subprocess.DEVNULL)
            took_s = time.monotonic() - began
            packages = len(list(Path(folder).glob("lib/python3*/site-packages/*.dist-info")))
            yield f"| `{name}` | {packages} | {size_mb(Path(folder, 'lib')):.0f} | {took_s:.0f} |"


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m supply.size", description="Print how large an installation is.")
    parser.add_argument("folder", type=Path, nargs="?", help="environment")
    parser.add_argument("--make", action="store_true", help="make it first")
    parser.add_argument("--wheel", type=Path, help="print the table of this wheel")
    args = parser.parse_args()
    if args.wheel:
        for row in table(args.wheel):
            print(row, flush=True)
        return
    if args.folder is None:
        parser.error("name an environment, or a wheel by --wheel")
    if args.make:
        make(args.folder)
    packages = {path.name: size_mb(path) for path in args.folder.glob("lib/python3*/site-packages/*")}
    print(f"{'whole':<32}{size_mb(args.folder):6.0f} MB")
    for name, mb in sorted(packages.items(), key=lambda item: -item[1])[:SHOWN]:
        print(f"{name:<32}{mb:6.0f}")


if __name__ == "__main__":
    main()
