"""Name what a checkout lacks to be published: `python -m supply.release`, which `make release` ends with.

`--address URL` writes the repository's address into every file that names it; the one that counts is `[project.urls]`.
"""

import argparse
import re
import subprocess
import sys
import tomllib
from pathlib import Path

from hatchling.metadata.core import ProjectMetadata
from hatchling.plugin.manager import PluginManager
from packaging.version import Version

ROOT = Path(__file__).parents[1]
PLACEHOLDER = "https://example.org/ADDRESS-OF-THIS-REPOSITORY"
NAMING = ("pyproject.toml", "README.md", "docs/installation.md", "CITATION.cff")
"""The files that name the address."""
_BADGES = re.compile(r"^\[!\[tests\].*\n\n", re.MULTILINE)


def address(root: Path = ROOT) -> str:
    """Return the repository's address, or the placeholder while nobody knows it."""
    return str(tomllib.loads((root / "pyproject.toml").read_text())["project"]["urls"]["Source"])


def write(new: str, root: Path = ROOT) -> None:
    """Write another address into every file that names it. README has badges where there is one that works.

    Raises:
        ValueError: it is not an https address of a repository.
    """
    new = new.rstrip("/").removesuffix(".git")
    if re.fullmatch(r"https://[\w.-]+(/[\w.-]+){1,3}", new) is None:
        raise ValueError(f"{new} is no address as https://github.com/OWNER/decklander is one")
    old = address(root)
    for name in NAMING:
        (root / name).write_text((root / name).read_text().replace(old, new))
    shown = (
        f"[![tests]({new}/actions/workflows/tests.yml/badge.svg)]({new}/actions/workflows/tests.yml)\n"
        "[![PyPI](https://img.shields.io/pypi/v/decklander)](https://pypi.org/project/decklander/)\n"
        "[![licence](https://img.shields.io/pypi/l/decklander)](LICENSE)\n"
    ).replace("\n", " ").rstrip()  # fmt: skip
    title, _, text = (root / "README.md").read_text().partition("\n\n")
    badges = "" if new == PLACEHOLDER else f"{shown}\n\n"
    (root / "README.md").write_text(f"{title}\n\n{badges}{_BADGES.sub('', text, count=1)}")


def missing(root: Path = ROOT) -> list[str]:
    """Return what a release from this checkout lacks, a line each."""
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    version = Version(ProjectMetadata(str(root), PluginManager()).version)
    lines = []
    if address(root) == PLACEHOLDER:
        lines.append("the repository's address: python -m supply.release --address https://github.com/OWNER/decklander")
    if not any("email" in person for person in project.get("maintainers", ())):
        lines.append('who answers: maintainers = [{name = "NAME", email = "NAME@HOST"}] in [project] of pyproject.toml')
    if version.is_devrelease or version.local is not None:
        (newest,) = re.findall(r"\A.*?^## (\d\S*) - ", (root / "CHANGELOG.md").read_text(), re.MULTILINE | re.DOTALL)
        tags = subprocess.run(
            ["git", "tag", "--list", f"v{newest}"], cwd=root, capture_output=True, text=True, check=False
        ).stdout
        if tags.strip():
            lines.append(f"a section of CHANGELOG.md for what follows {newest}: ## X.Y.Z - DATE, of what stands under Unreleased")
        else:
            lines.append(f"the tag, on a commit without edits, as this is {version}: git tag --sign v{newest}")
    return lines


def main() -> int:
    """Run the command: 0 where nothing is missing, 1 where something is, 2 for an address that is none."""
    parser = argparse.ArgumentParser(prog="python -m supply.release", description="Name what a release lacks.")
    parser.add_argument("--address", metavar="URL", help="write the repository's address into every file that names it")
    args = parser.parse_args()
    if args.address is not None:
        try:
            write(args.address)
        except ValueError as why:
            print(why, file=sys.stderr)
            return 2
    lines = missing()
    for line in lines:
        print(f"to publish there is missing {line}")
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main())
