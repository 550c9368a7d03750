"""Install, update, roll back and uninstall, on a computer in a folder."""

import fcntl
import stat
from pathlib import Path

import pytest

from companion.cli.main import main
from companion.tools.install import steps, versions
from companion.tools.install.layout import COMMAND, CURRENT, PREFIX, SETTINGS, SYSTEM_FILES, UNIT
from companion.tools.install.steps import InstallOptions
from companion.tools.install.versions import Release, own, read
from estimator.contracts.errors import BadInput, DecklanderError, Recoverable, SetupImpossible
from tests.companion.install.computer import BLIND, DIES, ENDS_LATER, GOOD, REFUSES, ROOT, Computer, wheel


def options(**more: object) -> InstallOptions:
    return InstallOptions(sleep=lambda _: None, **more)


@pytest.fixture
def first(tmp_path: Path) -> Release:
    return wheel(tmp_path, "1.0")


def installed(tmp_path: Path, first: Release) -> Computer:
    """Return a computer on which the first version runs."""
    computer = Computer(tmp_path / "root")
    computer.settings()
    steps.install(computer, first, options())
    return computer


def test_an_installation_runs_the_service_and_a_second_one_changes_nothing(tmp_path: Path, first: Release) -> None:
    computer = installed(tmp_path, first)
    assert versions.current(computer) == first.name
    for name, target in SYSTEM_FILES.items():
        assert computer.read(target) == first.files[name]
    assert computer.target(COMMAND) == f"{CURRENT}/bin/decklander"
    assert computer.unit()["active"] == "active"
    again = Computer(tmp_path / "root")
    steps.install(again, first, options())
    assert [line for line in again.said.splitlines() if line.startswith(("write", "make", "remove", "link"))] == []
    assert not any("restart" in line for line in again.commands)
    assert f"version {first.name} is current already" in again.said


def test_without_settings_nothing_is_started_and_the_next_step_is_reported(tmp_path: Path, first: Release) -> None:
    computer = Computer(tmp_path / "root")
    steps.install(computer, first, options())
    assert f"next: decklander start --out {SETTINGS}" in computer.said
    assert not any("restart" in line for line in computer.commands)


def test_a_dry_run_reports_the_same_changes_and_makes_none(tmp_path: Path, first: Release) -> None:
    dry, real = Computer(tmp_path / "dry", dry=True), Computer(tmp_path / "real")
    before = sorted(path.relative_to(tmp_path) for path in (tmp_path / "dry").rglob("*"))
    for computer in (dry, real):
        steps.install(computer, first, options(config=ROOT / "configs/sim.toml"))
    assert sorted(path.relative_to(tmp_path) for path in (tmp_path / "dry").rglob("*")) == before
    reported = [line.removeprefix("would ") for line in dry.said.splitlines() if line.startswith("would ")]
    done = real.said.splitlines()
    assert {f"write {UNIT} (mode 644)", f"link {CURRENT} -> {first.name}", "run systemctl restart decklander.service"} <= set(
        reported
    )
    # The check of a version that is not made is told instead.
    assert [line for line in reported if line not in done and "config check" not in line] == []


def test_secrets_are_for_root_alone_and_settings_are_never_overwritten(tmp_path: Path, first: Release) -> None:
    secret, settings = tmp_path / "secret", tmp_path / "rig.toml"
    secret.write_text("hidden")
    settings.write_text("good")
    computer = Computer(tmp_path / "root")
    loose = computer.path("/etc/credstore/decklander.page")
    loose.parent.mkdir(parents=True)
    loose.write_text("token")
    loose.chmod(0o644)
    steps.install(computer, first, options(config=settings, secrets={"mqtt-password": secret}))
    for name in ("mqtt-password", "page"):
        assert stat.S_IMODE(computer.path(f"/etc/credstore/decklander.{name}").stat().st_mode) == 0o600
    assert "hidden" not in computer.said
    with pytest.raises(BadInput, match="the unit loads none of that name; it loads mqtt-password"):
        steps.install(computer, first, options(secrets={"mqtt_password": secret}))
    settings.write_text("others")
    with pytest.raises(BadInput, match="is there and differs"):
        steps.install(computer, first, options(config=settings))
    assert computer.read(SETTINGS) == b"good"


def test_an_update_runs_the_other_version_and_rollback_returns(tmp_path: Path, first: Release) -> None:
    computer = installed(tmp_path, first)
    computer.unit(status="standing; 30 frames and 200 inertial samples a second")
    second = wheel(tmp_path, "1.1")
    steps.update(computer, second, options())
    assert (versions.current(computer), versions.previous(computer)) == (second.name, first.name)
    assert steps.running_version(computer, steps.state(computer)) == second.name
    assert (computer.read(UNIT) or b"").endswith(b"# of 1.1\n")
    steps.roll_back(computer, options())
    assert (versions.current(computer), versions.previous(computer)) == (first.name, second.name)
    assert steps.running_version(computer, steps.state(computer)) == first.name
    assert (computer.read(UNIT) or b"").endswith(b"# of 1.0\n")
    third = wheel(tmp_path, "1.2")
    steps.update(computer, third, options())
    assert versions.there(computer) == sorted((first.name, third.name)), "two versions are kept"


@pytest.mark.parametrize(
    ("behaviour", "told"),
    [
        (DIES, "Job for decklander.service failed"),
        (ENDS_LATER, "ended and was started again"),
        (BLIND, "no frames come, and before they did"),
    ],
)
def test_a_version_that_does_not_come_up_is_taken_back(tmp_path: Path, first: Release, behaviour: str, told: str) -> None:
    computer = installed(tmp_path, first)
    older = wheel(tmp_path, "1.0.1")
    steps.update(computer, older, options())
    with pytest.raises(Recoverable, match=f"{told}.*; version {older.name} is current again and runs"):
        steps.update(computer, wheel(tmp_path, "1.1", behaviour), options())
    assert (versions.current(computer), versions.previous(computer)) == (older.name, first.name)
    assert steps.running_version(computer, steps.state(computer)) == older.name


def test_a_version_that_refuses_the_settings_is_never_current(tmp_path: Path, first: Release) -> None:
    computer = installed(tmp_path, first)
    restarts = len([line for line in computer.commands if "restart" in line])
    with pytest.raises(BadInput, match=r"refuses the present settings: .*vision\.colors is no key"):
        steps.update(computer, wheel(tmp_path, "1.1", REFUSES), options())
    assert versions.there(computer) == [first.name]
    assert len([line for line in computer.commands if "restart" in line]) == restarts
    steps.update(computer, wheel(tmp_path, "1.2"), options())
    computer.path(f"{PREFIX}/{first.name}/behaviour").write_text(REFUSES)
    with pytest.raises(BadInput, match="refuses the present settings"):
        steps.roll_back(computer, options())
    assert (versions.current(computer) or "").startswith("1.2")


@pytest.mark.parametrize("step", ["-m venv", "--require-hashes", "--no-deps", "slim.sh"])
def test_a_full_disk_leaves_the_version_that_runs(tmp_path: Path, first: Release, step: str) -> None:
    installed(tmp_path, first)
    full = Computer(tmp_path / "root", fails=(step, "OSError: [Errno 28] No space left on device"))
    with pytest.raises(Recoverable, match="No space left on device"):
        steps.update(full, wheel(tmp_path, "1.1"), options())
    assert versions.there(full) == [first.name]
    assert versions.current(full) == first.name
    assert not any("restart" in line for line in full.commands)


def test_too_little_room_is_seen_before_anything_is_made(tmp_path: Path, first: Release, monkeypatch: pytest.MonkeyPatch) -> None:
    computer = installed(tmp_path, first)
    monkeypatch.setattr(computer, "free_bytes", lambda _: 120_000_000)
    with pytest.raises(Recoverable, match="120 MB are free, a version needs 900 MB"):
        steps.update(computer, wheel(tmp_path, "1.1"), options())
    assert versions.there(computer) == [first.name]


def test_nothing_is_done_while_the_drone_flies_or_may_fly(tmp_path: Path, first: Release) -> None:
    computer = installed(tmp_path, first)
    second = wheel(tmp_path, "1.1")
    made = {
        "update": lambda o: steps.update(computer, second, o),
        "rollback": lambda o: steps.roll_back(computer, o),
        "uninstall": lambda o: steps.uninstall(computer, o, purge=True),
    }
    before = computer.made
    for do in made.values():
        computer.unit(flying=True, answers=True)
        for on_ground in (False, True):
            with pytest.raises(Recoverable, match=r"the drone is flying .* land it first"):
                do(options(on_ground=on_ground))
        computer.unit(flying=None)
        with pytest.raises(Recoverable, match=r"not known \(the service has no word of the vehicle\)"):
            do(options())
        computer.unit(answers=False)
        with pytest.raises(Recoverable, match=r"not known \(the service does not answer: nobody"):
            do(options())
    assert computer.made == before
    steps.update(computer, second, options(on_ground=True))
    assert versions.current(computer) == second.name


def test_a_drone_that_took_off_during_the_update_is_seen_before_the_restart(tmp_path, first, monkeypatch):
    computer = installed(tmp_path, first)
    made = versions.make

    def slowly(*args: object) -> bool:
        computer.unit(flying=True)
        return made(*args)

    monkeypatch.setattr(versions, "make", slowly)
    with pytest.raises(Recoverable, match="the drone is flying"):
        steps.update(computer, wheel(tmp_path, "1.1"), options())
    assert versions.current(computer) == first.name


@pytest.mark.parametrize("purge", [False, True])
def test_uninstall_leaves_what_is_the_user_s_unless_it_is_purged(tmp_path: Path, first: Release, purge: bool) -> None:
    secret = tmp_path / "secret"
    secret.write_text("hidden")
    computer = installed(tmp_path, first)
    steps.install(computer, first, options(secrets={"page": secret}))
    recording = computer.path("/var/lib/private/decklander/recordings/a.mcap")
    recording.parent.mkdir(parents=True)
    recording.touch()
    others = computer.path("/etc/credstore/other.key")
    others.touch()
    for _ in range(2):
        steps.uninstall(computer, options(), purge=purge)
        assert not computer.exists(PREFIX)
        assert not any(computer.exists(path) for path in (*SYSTEM_FILES.values(), COMMAND))
        kept = [recording.exists(), computer.exists(SETTINGS), computer.exists("/etc/credstore/decklander.page")]
        assert kept == [not purge] * 3
    assert others.exists()
    assert ("left, since they are yours: /etc/decklander" in computer.said) is not purge
    assert computer.unit()["active"] == "inactive"


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        ("3 11 32\n", r"is a 32-bit Python; decklander needs a 64-bit operating system .*Raspberry Pi OS \(64-bit\)"),
        ("3 9 64\n", "is Python 3.9; decklander needs 3.11 or newer"),
        ("", "no Python here"),
    ],
)
def test_a_computer_that_cannot_run_it_is_refused(tmp_path, first, answer, told, monkeypatch):
    computer = Computer(tmp_path / "root")
    answered = computer._answer
    monkeypatch.setattr(
        computer, "_answer", lambda words, line: (0, answer, "") if words[1:2] == ["-c"] else answered(words, line)
    )
    with pytest.raises(SetupImpossible, match=told):
        steps.install(computer, first, options())
    assert computer.made == 0


def test_two_installations_at_a_time_do_not_meet(tmp_path: Path, first: Release) -> None:
    computer = installed(tmp_path, first)
    with computer.locked(f"{PREFIX}/.lock"), pytest.raises(Recoverable, match="another installation or update is at work"):
        steps.update(Computer(tmp_path / "root"), wheel(tmp_path, "1.1"), options())


def test_a_wheel_that_cannot_install_itself_is_refused(tmp_path: Path) -> None:
    (tmp_path / "decklander-1-py3-none-any.whl").write_text("no zip")
    for name, reported in (("decklander-1-py3-none-any.whl", "not a wheel of decklander"), ("none.whl", "No such file")):
        with pytest.raises(BadInput, match=reported):
            read(tmp_path / name)


def test_this_checkout_is_the_source_of_an_installation_from_it() -> None:
    assert Path(own()).resolve() == ROOT.resolve()


def test_the_commands_refuse_what_they_cannot_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["service", "uninstall", "--root", str(tmp_path / "none"), "--dry-run"]) == 2
    assert "no such folder" in capsys.readouterr().err
    assert main(["service", "rollback", "--root", str(tmp_path), "--dry-run"]) == 2
    assert "there is no version to return to" in capsys.readouterr().err
    assert main(["service", "update", str(wheel(tmp_path, "1.0").wheel), "--root", str(tmp_path), "--dry-run"]) == 2
    assert "nothing is installed here" in capsys.readouterr().err
    assert main(["service", "install", "nonsense", "--root", str(tmp_path), "--dry-run"]) == 2
    assert "no such file or folder, and no version" in capsys.readouterr().err


def test_nobody_but_root_changes_the_system(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    assert main(["service", "uninstall", "--root", str(tmp_path)]) == 1
    assert "needs root: sudo decklander service uninstall" in capsys.readouterr().err


def test_without_systemd_it_is_reported(tmp_path: Path, first: Release) -> None:
    computer = Computer(tmp_path / "root")
    computer.settings()
    for gone in ("usr/bin/systemctl", "usr/bin/systemd-sysusers", "run/systemd/system"):
        path = computer.path(gone)
        path.rmdir() if path.is_dir() else path.unlink()
    steps.install(computer, first, options())
    assert "there is no systemd on this computer" in computer.said
    assert versions.current(computer) == first.name
    assert not any(line.startswith("systemctl") for line in computer.commands)


def test_errors_are_ours(tmp_path: Path) -> None:
    computer = Computer(tmp_path / "root", fails=("pip", "no"))
    with pytest.raises(DecklanderError):
        steps.install(computer, wheel(tmp_path, "1.0", GOOD), options())
    assert versions.there(computer) == []


def test_what_fails_leaves_no_lock_and_no_folder_of_its_own(tmp_path: Path, first: Release) -> None:
    root = tmp_path / "empty"
    root.mkdir()
    with pytest.raises(BadInput, match="there is no version to return to"):
        steps.roll_back(Computer(root), options())
    assert not (root / PREFIX.lstrip("/")).exists()
    computer = installed(tmp_path, first)
    assert not computer.exists(f"{PREFIX}/.lock")
    computer.path(f"{PREFIX}/.lock").write_text("")  # of one that was killed
    with computer.locked(f"{PREFIX}/.lock"):
        assert computer.exists(f"{PREFIX}/.lock")
    assert not computer.exists(f"{PREFIX}/.lock")
    assert versions.current(computer) == first.name


def test_a_lock_that_goes_away_while_it_is_taken_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The one before removes the file between our opening it and our lock."""
    computer = Computer(tmp_path)
    path = computer.path(f"{PREFIX}/.lock")
    flock = fcntl.flock

    def late(file: int, how: int) -> None:
        path.unlink()
        flock(file, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with pytest.raises(Recoverable, match="at work"), computer.locked(f"{PREFIX}/.lock"):
        raise AssertionError("two would be at work")
