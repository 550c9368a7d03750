"""What holds for every test, in whichever process and beside whatever else it runs."""

from __future__ import annotations

import os
import signal
from typing import Any

import pytest

# One test, one core: `make test` starts a worker for each core. Set before numpy is imported; what tests start inherits it.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

TOGETHER = ("tests/v4l2_vm/",)
"""Folders whose files share what is dear to make: one virtual machine is started for all of them."""
APART = ("tests/sitl/test_flight.py", "tests/packaging/test_installation.py")
"""Files of long tests that share little, so that one worker need not run them all."""


def pytest_configure() -> None:
    """Heed SIGINT again where a shell's background job ignores it, which everything that a test starts would inherit."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def share(nodeid: str) -> str:
    """Return the name of the tests that one worker runs in a row: a file, a folder of files, or a single test."""
    file = nodeid.partition("::")[0]
    if file in APART:
        return nodeid
    return next((folder for folder in TOGETHER if file.startswith(folder)), file)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put what takes long first: the workers end at about the same time only if short files come last."""
    slow = {share(item.nodeid) for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: share(item.nodeid) not in slow)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Deal the shares to the workers in the order of collection."""
    from xdist.scheduler.loadscope import LoadScopeScheduling

    class ByShare(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return share(nodeid)

    config.option.loadscopereorder = False
    return ByShare(config, log)
