"""Hatchling's hook for a wheel: it builds the native core, takes it in, and names the platform that the wheel is for."""

from __future__ import annotations

import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

sys.path.insert(0, str(Path(__file__).parents[1]))
from supply import core


class CoreHook(BuildHookInterface[Any]):
    """The hook. An editable install uses the library of its checkout, which `make core` builds."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the library before the wheel is packed.

        Raises:
            BuildError: there is no compiler, or it refuses a source.
        """
        if self.target_name != "wheel" or version == "editable":
            return
        core.build()
        build_data["artifacts"].append(str(core.LIBRARY.relative_to(self.root)))
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
