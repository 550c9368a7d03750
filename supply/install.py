"""Install pinned packages: `python -m supply.install PINS...` calls pip once for all these files, and prints what that took.

A file of pins names every package, so pip has nothing to resolve. It compiles nothing to byte code either, for Python does that
with what it imports, unless it may keep none.
"""

import re
import subprocess
import sys
import time

_DOWNLOADED = re.compile(r" Downloading .*(?<!\.metadata) \(([\d.]+) ([kMG]?)B?\w*\)$")
_MB = {"": 1e-6, "k": 1e-3, "M": 1.0, "G": 1e3}


def main() -> int:
    """Run the command and return pip's exit code."""
    command = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--progress-bar=off", "--no-deps"]
    command += ["--require-hashes", *([] if sys.dont_write_bytecode else ["--no-compile"])]
    print(f"fetching the packages of {', '.join(sys.argv[1:])} ...", flush=True)
    began_s = fetched_s = time.monotonic()
    sizes_mb, installed = list[float](), 0
    with subprocess.Popen([*command, *(f"-r{pins}" for pins in sys.argv[1:])], stdout=subprocess.PIPE, text=True) as pip:
        for line in pip.stdout or ():
            if found := _DOWNLOADED.search(line):
                sizes_mb.append(float(found[1]) * _MB[found[2]])
            elif line.startswith("Installing collected packages: "):
                fetched_s, installed = time.monotonic(), line.count(",") + 1
    if pip.returncode == 0:
        fetched = f"downloaded {len(sizes_mb)} files, {sum(sizes_mb):.1f} MB, in {fetched_s - began_s:.1f} s"
        print(f"{fetched}; installed {installed} packages in {time.monotonic() - fetched_s:.1f} s", flush=True)
    return pip.returncode


if __name__ == "__main__":
    sys.exit(main())
