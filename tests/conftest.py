"""Fixtures and rules for every test, in any process and beside any load."""

import gc
import os
import signal
import sys
import tempfile
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from shutil import copy
from typing import Any

import pytest

# Where bytecode is not to lie beside its source it lies in the environment: else each process compiles us and Hypothesis again.
if sys.dont_write_bytecode and not sys.pycache_prefix:
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix = f"{sys.prefix}/bytecode"
    sys.dont_write_bytecode = False

import hypothesis

# A busy machine is no failure: no example is timed. Every run has the same examples; others come by --hypothesis-profile=drawn.
hypothesis.settings.register_profile("drawn", deadline=None)
hypothesis.settings.register_profile("same", deadline=None, derandomize=True)
hypothesis.settings.load_profile("same")

# One test, one core: `make test` runs several at once. Set before numpy is imported; what tests start inherits it.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

# Services of different workers must not meet at one local socket.
os.environ["XDG_RUNTIME_DIR"] = f"{tempfile.gettempdir()}/decklander-tests-{os.getpid()}"
os.environ.pop("RUNTIME_DIRECTORY", None)

ROOT = Path(__file__).parents[1]
SLOW = (ROOT / "tests/slow.txt").read_text(encoding="ascii").split()
"""Files and folders that take more than a second of processor time, the longest first. They are marked `slow`, and start first.
Not among them are the strongest tests of filter and registration, some seconds each, which run before each commit."""
APART = ("tests/sitl/autopilots/test_stand_in_landings.py", "tests/sitl/test_one_flight.py", "tests/sitl/test_flight.py")
"""Files of long tests that share nothing, so that one worker need not run them all."""


def pytest_configure() -> None:
    """Heed SIGINT and SIGQUIT again where a shell's background job ignores them, which all that a test starts would inherit."""
    for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGQUIT, signal.SIG_DFL)):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


@pytest.fixture(autouse=True, scope="module")
def out_of_the_collectors_sight() -> None:
    """Freeze the thousands of collected tests, which stay: a full collection looks through what the running one made alone."""
    if gc.get_freeze_count() == 0:  # a daemon's end thaws
        gc.collect()
        gc.freeze()


@pytest.fixture(scope="session")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the flights that are kept (`tests.support.kept.KeptFlights`); a mutant's are its own."""
    from tests.support.kept import KeptFlights, folder

    return KeptFlights(tmp_path_factory.mktemp("kept") if "DECKLANDER_MUTANT" in os.environ else folder())


@pytest.fixture(scope="session")
def recorded_flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """Return the recording of 1.5 s of a flight, and the calls that another observer received."""
    from tests.fly import record_to

    path = tmp_path_factory.mktemp("recorded") / "flight.mcap"
    return path, record_to(path, seconds=1.5)


@pytest.fixture(scope="session")
def flight_file(kept: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the recording of a flight alone, in a folder of its own."""
    from tests.fly import record_to

    return Path(copy(kept("1.5 s of the demo", partial(record_to, seconds=1.5)), tmp_path_factory.mktemp("kept") / "flight.mcap"))


@cache
def place(name: str) -> int:
    """Return the place of a file, or of the file of a test, among `SLOW`; their number for what is not slow."""
    return next((n for n, start in enumerate(SLOW) if name.startswith(start)), len(SLOW))


def pytest_sessionstart(session: pytest.Session) -> None:
    """Let each worker of a whole run import the test files from another one on: what one compiled the others read."""
    config, files = session.config, sorted(ROOT.glob("tests/**/test_*.py"))
    if hasattr(config, "workerinput") and config.args == ["tests"] and not config.option.markexpr:
        first = int(config.workerinput["workerid"][2:]) * len(files) // config.workerinput["workercount"]
        for file in files[first:] + files[:first]:
            with suppress(Exception, pytest.skip.Exception):  # which its collection reports
                import_module(".".join(file.relative_to(ROOT).with_suffix("").parts))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not even import what `-m "not slow"` leaves out: `make check` is for between two edits."""
    if config.getoption("markexpr") == "not slow" and collection_path.suffix == ".py":
        return place(collection_path.relative_to(ROOT).as_posix()) < len(SLOW) or None
    return None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is slow and put it first: workers end at about the same time only if short files come last."""
    for item in items:
        if place(item.nodeid) < len(SLOW):
            item.add_marker("slow")
    items.sort(key=lambda item: place(item.nodeid))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Start one worker more than there are cores: what a test waits for takes no core, but each worker collects all tests."""
    return len(os.sched_getaffinity(0)) + 1


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Deal the shares to the workers in the order of collection."""
    from xdist.scheduler.loadscope import LoadScopeScheduling

    class ByShare(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            """Return the name of the tests that one worker runs in a row: a file or a single test."""
            file = nodeid.partition("::")[0]
            return nodeid if file in APART else file

    config.option.loadscopereorder = False
    return ByShare(config, log)
