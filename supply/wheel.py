"""Hatchling's hook for a wheel: it builds the native libraries, takes them in, and names the platform that the wheel is for."""

import os
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

sys.path.insert(0, str(Path(__file__).parents[1]))
from supply import core


class CoreHook(BuildHookInterface[Any]):
    """The hook. An editable install uses the libraries of its checkout, which `make core` builds."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the libraries before the wheel is packed: for this machine, or for the architecture that the environment names.

        Raises:
            BuildError: there is no compiler, or it refuses a source.
        """
        if self.target_name != "wheel" or version == "editable":
            return
        architecture = os.environ.get(core.ARCHITECTURE)
        platform = sysconfig.get_platform()
        if architecture is not None:
            platform = f"manylinux_{core.GLIBC[0]}_{core.GLIBC[1]}_{architecture}"
        self._folder = tempfile.TemporaryDirectory()
        for library in core.LIBRARIES:
            made = core.build(library, Path(self._folder.name, library.file.name), architecture=architecture)
            build_data["force_include"][str(made)] = str(library.file.relative_to(self.root))
            bound = core.bind(library, Path(self._folder.name, f"{library.file.name}.py"))
            build_data["force_include"][str(bound)] = str(library.abi.relative_to(self.root))
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform.replace('-', '_').replace('.', '_')}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the libraries that the wheel holds by now."""
        if hasattr(self, "_folder"):
            self._folder.cleanup()
