"""What holds for every test, in whichever process and beside whatever else it runs."""

from __future__ import annotations

import os
import signal

import pytest

# One test, one core: `make test` starts a worker for each core, and a busy machine has none to spare. Set before numpy is imported;
# the processes that tests start inherit it.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")


def pytest_configure() -> None:
    """Heed SIGINT again where a shell's background job ignores it: what tests start inherits that and could not be interrupted."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
