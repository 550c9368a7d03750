"""Look up the pins of the service and its extras among known weaknesses: `python -m supply.audit [--advisories FILE]`.

With a file of advisories (the OSV database of PyPI: a zip, or a folder, of its JSON entries, which a CI without a network can
keep) it is read; without one pip-audit asks PyPI. Ends with 1 when a pinned version has a known weakness. When PyPI cannot be
reached the audit has not been made: it says so and ends with 0, unless `--strict` is given.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from packaging.version import InvalidVersion, Version

from supply.packages import Pin, every_pin, normal

COULD_NOT = "THE AUDIT COULD NOT BE MADE"
_NETWORK_S = 60


def entries(source: Path) -> Iterator[Mapping[str, Any]]:
    """Yield every advisory of a zip or folder of OSV entries.

    Raises:
        OSError: the source cannot be read.
        ValueError: an entry is not JSON, or the file is not a zip.
    """
    if source.is_dir():
        texts: Iterable[bytes] = (path.read_bytes() for path in sorted(source.glob("**/*.json")))
        yield from (json.loads(text) for text in texts)
        return
    try:
        with zipfile.ZipFile(source) as archive:
            for name in sorted(archive.namelist()):
                if name.endswith(".json"):
                    yield json.loads(archive.read(name))
    except zipfile.BadZipFile as why:
        raise ValueError(f"{source}: {why}") from why


def hits(advisories: Iterable[Mapping[str, Any]], wanted: Iterable[Pin]) -> list[str]:
    """Return one line for each advisory that affects a pinned version."""
    by_name = {normal(pin.name): pin for pin in wanted}
    found = []
    for advisory in advisories:
        if "withdrawn" in advisory:
            continue
        for affected in advisory.get("affected", ()):
            package = affected.get("package", {})
            pin = by_name.get(normal(str(package.get("name", ""))))
            if pin is not None and package.get("ecosystem") == "PyPI" and _affects(affected, pin.version):
                found.append(f"{pin.name} {pin.version}: {advisory.get('id')} {str(advisory.get('summary', ''))[:100]}".rstrip())
                break
    return found


def _affects(affected: Mapping[str, Any], version: str) -> bool:
    if version in affected.get("versions", ()):
        return True
    return any(_within(r.get("events", ()), Version(version)) for r in affected.get("ranges", ()) if r.get("type") == "ECOSYSTEM")


def _within(events: Iterable[Mapping[str, str]], version: Version) -> bool:
    """Return whether a version is affected by OSV's rule: the events in order of version switch between affected and not."""
    inside = False
    for event in sorted(events, key=_of):
        if "introduced" in event and version >= _of(event):
            inside = True
        elif ("fixed" in event and version >= _of(event)) or ("last_affected" in event and version > _of(event)):
            inside = False
    return inside


def _of(event: Mapping[str, str]) -> Version:
    text = next(iter(event.values()))
    try:
        return Version("0.dev0" if text == "0" else text)
    except InvalidVersion:
        return Version("0.dev0")


def ask_pypi(wanted: Iterable[Pin]) -> tuple[list[str] | None, str]:
    """Return what pip-audit finds (None if it did not look up all of them) and its message."""
    with tempfile.TemporaryDirectory() as folder:
        listed = Path(folder, "pins.txt")
        listed.write_text("".join(_requirement(pin) for pin in wanted))
        command = [
            sys.executable, "-m", "pip_audit", "--requirement", str(listed), "--require-hashes", "--disable-pip",
            "--format", "json", "--progress-spinner", "off", "--vulnerability-service", "pypi", "--timeout", "5",
        ]  # fmt: skip
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_NETWORK_S)
        except subprocess.TimeoutExpired:
            return None, f"no answer within {_NETWORK_S} s"
    try:
        found = json.loads(done.stdout)["dependencies"]
    except (json.JSONDecodeError, KeyError):
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1][:300]
        return None, last
    weak = [f"{d['name']} {d['version']}: {v['id']}" for d in found for v in d.get("vulns", ())]
    skipped = [d for d in found if "skip_reason" in d]
    if skipped and not weak:
        return None, f"{len(skipped)} of {len(found)} were not looked up, {skipped[0]['name']}: {skipped[0]['skip_reason'][:120]}"
    return weak, f"{len(found) - len(skipped)} asked of PyPI"


def _requirement(pin: Pin) -> str:
    return " ".join([f"{pin.name}=={pin.version}", *(f"--hash=sha256:{one}" for one in pin.hashes)]) + "\n"


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m supply.audit", description="Look the pins up among known weaknesses.")
    parser.add_argument("--advisories", type=Path, help="zip or folder of OSV entries; without it PyPI is asked")
    parser.add_argument("--strict", action="store_true", help="end with 1 when the audit could not be made")
    args = parser.parse_args()
    wanted = every_pin()
    if args.advisories is not None:
        try:
            rows = list(entries(args.advisories))
        except (OSError, ValueError) as why:
            print(f"{COULD_NOT}: {args.advisories}: {why}")
            return 1
        found, said = hits(rows, wanted), f"{len(rows)} advisories read from {args.advisories}"
    else:
        asked, said = ask_pypi(wanted)
        if asked is None:
            print(f"{COULD_NOT}: PyPI gave no answer ({said}); --advisories FILE reads the OSV database of PyPI instead")
            return int(args.strict)
        found = asked
    print(f"{len(wanted)} pinned distributions, {said}: {len(found)} known weaknesses")
    for line in found:
        print(f"  {line}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
