"""The software bill of materials in CycloneDX JSON: `python -m supply.sbom --out FILE [--environment FOLDER]`.

Components are the pinned distributions as they are installed, with licence, dependencies and the hashes that pip accepts, and
below each the native libraries that its wheel carries. Those of an extra are marked as optional, and an environment without the
extra has none of them. Debian's packages are not among them: an image's own dpkg database lists
those, and scanners read it.
"""

from __future__ import annotations

import argparse
import os
import sys
import tomllib
import uuid
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import ExternalReference, ExternalReferenceType, HashAlgorithm, HashType, Property, XsUri
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentScope, ComponentType
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL

from supply.packages import ROOT, Package, every_pin, installed, packages


def bill(shipped: Sequence[Package], version: str) -> str:
    """Return the bill as JSON."""
    licences = LicenseFactory()
    root = Component(
        name="decklander", version=version, type=ComponentType.APPLICATION, bom_ref="decklander",
        licenses=[licences.make_from_string("Apache-2.0")], purl=PackageURL("pypi", None, "decklander", version),
    )  # fmt: skip
    components = {package.pin.name: _component(package, licences) for package in shipped}
    serial = uuid.uuid5(uuid.NAMESPACE_URL, " ".join(f"{p.pin.name}=={p.pin.version}" for p in shipped) + version)
    bom = Bom(components=components.values(), serial_number=serial)
    bom.metadata.component = root
    if epoch := os.environ.get("SOURCE_DATE_EPOCH"):
        bom.metadata.timestamp = datetime.fromtimestamp(int(epoch), UTC)
    for package in shipped:
        bom.register_dependency(components[package.pin.name], [components[name] for name in package.requires])
    bom.register_dependency(root, components.values())
    return str(JsonV1Dot6(bom).output_as_string(indent=1))


def _component(package: Package, licences: LicenseFactory) -> Component:
    pin = package.pin
    carried = package.carried
    return Component(
        name=pin.name,
        version=pin.version,
        type=ComponentType.LIBRARY,
        scope=ComponentScope.OPTIONAL if pin.extra else ComponentScope.REQUIRED,
        bom_ref=f"{pin.name}=={pin.version}",
        purl=PackageURL("pypi", None, pin.name, pin.version),
        description=package.summary or None,
        licenses=[licences.make_from_string(package.licence)] if package.licence else (),
        components=[
            Component(
                name=library, type=ComponentType.LIBRARY, bom_ref=f"{pin.name}=={pin.version}#{library}",
                licenses=[licences.make_from_string(carried[library])] if library in carried else (),
            )
            for library in package.libraries
        ],
        external_references=[
            ExternalReference(
                type=ExternalReferenceType.DISTRIBUTION,
                url=XsUri(f"https://pypi.org/project/{pin.name}/{pin.version}/"),
                hashes=[HashType(alg=HashAlgorithm.SHA_256, content=content) for content in pin.hashes],
            )
        ],
        properties=[Property(name="decklander:pinned-files", value=str(len(pin.hashes)))],
    )  # fmt: skip


def site_of(environment: Path) -> list[str]:
    """Return the package folders of a virtual environment.

    Raises:
        FileNotFoundError: the environment has none.
    """
    found = [str(path) for path in sorted(environment.glob("lib/python3.*/site-packages"))]
    if not found:
        raise FileNotFoundError(f"{environment}: no virtual environment")
    return found


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m supply.sbom", description="Write the bill of materials.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--environment", type=Path, help="virtual environment to describe; this one by default")
    args = parser.parse_args()
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    site = site_of(args.environment) if args.environment else None
    shipped = packages(installed(every_pin(), site), site)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    text = bill(shipped, version)
    args.out.write_text(text + "\n")
    carried = sum(len(package.libraries) for package in shipped)
    print(f"{args.out}: {len(shipped)} distributions, {carried} native libraries in their wheels, {len(text) / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
