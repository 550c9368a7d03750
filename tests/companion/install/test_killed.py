"""Whenever an installation or update is killed, a whole version is current, and the same command begun again ends well."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from companion.tools.install import steps, versions
from companion.tools.install.layout import COMPLETE, PREFIX
from companion.tools.install.steps import InstallOptions
from companion.tools.install.versions import Release
from estimator.contracts.errors import Recoverable
from tests.companion.install.computer import DIES, Computer, wheel

OPTIONS = InstallOptions(sleep=lambda _: None)


def killed(root: Path, step: int, do: Callable[[Computer], None]) -> bool:
    """Return whether a child process that is killed before its n-th change got so far. Nothing of it is cleared away."""
    child = os.fork()
    if child == 0:
        try:
            do(Computer(root, killed_at=step))
        except BaseException:
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9


def started_at(root: Path) -> Computer:
    """Return the computer after a power cycle: the current version is started."""
    computer = Computer(root)
    name = versions.current(computer)
    assert name is not None
    assert computer.read(f"{PREFIX}/{name}/{COMPLETE}") is not None
    assert computer.behaviour(name)
    return computer


@pytest.fixture
def before(tmp_path: Path) -> tuple[Path, Release, Release]:
    """Return a computer on which version 1.1 runs, which was an update of 1.0."""
    root, first, second = tmp_path / "before", wheel(tmp_path, "1.0"), wheel(tmp_path, "1.1")
    computer = Computer(root)
    computer.settings()
    steps.install(computer, first, OPTIONS)
    steps.update(computer, second, OPTIONS)
    return root, first, second


def test_an_update_may_be_killed_at_any_step(tmp_path: Path, before: tuple[Path, Release, Release]) -> None:
    original, first, second = before
    third = wheel(tmp_path, "1.2")
    step, seen = 0, set()
    while True:
        root = tmp_path / f"killed-{step}"
        shutil.copytree(original, root, symlinks=True)
        if not killed(root, step, lambda computer: steps.update(computer, third, OPTIONS)):
            break
        computer = started_at(root)
        seen.add(versions.current(computer))
        assert versions.current(computer) in (second.name, third.name)
        steps.update(computer, third, OPTIONS)
        found = steps.state(computer)
        assert found is not None
        assert (versions.current(computer), steps.running_version(computer, found)) == (third.name, third.name)
        assert versions.there(computer) == sorted({versions.previous(computer) or third.name, third.name})
        step += 1
    assert step > 10
    assert seen == {second.name, third.name}
    assert first.name not in versions.there(Computer(root))


def test_an_update_that_goes_back_may_be_killed_too(tmp_path: Path, before: tuple[Path, Release, Release]) -> None:
    original, _, second = before
    bad = wheel(tmp_path, "1.2", DIES)
    step = 0
    while True:
        root = tmp_path / f"killed-{step}"
        shutil.copytree(original, root, symlinks=True)
        if not killed(root, step, lambda computer: steps.update(computer, bad, OPTIONS)):
            break
        computer = started_at(root)
        if versions.current(computer) == second.name:
            steps.update(computer, second, OPTIONS)
        else:
            with pytest.raises(Recoverable, match="does not come up"):
                steps.update(computer, bad, OPTIONS)
        found = steps.state(computer)
        assert found is not None
        assert (versions.current(computer), steps.running_version(computer, found)) == (second.name, second.name), step
        step += 1
    assert step > 10


def test_a_first_installation_may_be_killed_at_any_step(tmp_path: Path) -> None:
    first = wheel(tmp_path, "1.0")
    step = 0
    while True:
        root = tmp_path / f"killed-{step}"
        Computer(root).settings()
        if not killed(root, step, lambda computer: steps.install(computer, first, OPTIONS)):
            break
        computer = Computer(root)
        steps.install(computer, first, OPTIONS)
        assert versions.current(computer) == first.name
        assert versions.there(computer) == [first.name]
        step += 1
    assert step > 10


def test_a_rollback_may_be_killed_at_any_step(tmp_path: Path, before: tuple[Path, Release, Release]) -> None:
    original, first, second = before
    step = 0
    while True:
        root = tmp_path / f"killed-{step}"
        shutil.copytree(original, root, symlinks=True)
        if not killed(root, step, lambda computer: steps.roll_back(computer, OPTIONS)):
            break
        assert versions.current(started_at(root)) in (first.name, second.name)
        step += 1
    assert step >= 4


def test_an_uninstallation_may_be_killed_at_any_step(tmp_path: Path, before: tuple[Path, Release, Release]) -> None:
    original, _, _ = before
    step = 0
    while True:
        root = tmp_path / f"killed-{step}"
        shutil.copytree(original, root, symlinks=True)
        if not killed(root, step, lambda computer: steps.uninstall(computer, OPTIONS, purge=True)):
            break
        computer = Computer(root)
        steps.uninstall(computer, OPTIONS, purge=True)
        assert not computer.exists(PREFIX)
        step += 1
    assert step > 5
