"""The table of capabilities, vehicles of other packages, and the answer where something is missing."""

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import pytest
from msgspec import structs

from companion.cli.commands import OWNERS
from companion.cli.main import main
from companion.guidance.pilot import make_pilot
from companion.recording.reading import open_recording
from companion.settings import capabilities, schema
from companion.settings.capabilities import CAPABILITIES, VEHICLES, Capability, VehicleKind, vehicle_kind
from companion.settings.load import from_file, from_mapping, load
from companion.settings.model import Settings
from companion.settings.overrides import with_overrides
from companion.settings.referenced_files import check_installed
from drivers import extras
from drivers.importer import ForeignFile
from drivers.log_stamps import stamp
from drivers.vehicle import VehicleOptions
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import text
from estimator.contracts.samples import Range, Sample
from estimator.contracts.tables import imported
from estimator.contracts.time import NS_PER_S

ROOT = Path(__file__).parents[2]
_PLAIN = """
import sys
from importlib.abc import MetaPathFinder

class Missing(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"aiomqtt", "av", "paho", "pyais", "pynmea2", "pyulog", "resvg_py", "rosbags"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
from companion.cli.main import main

sys.exit(main(sys.argv[1:]))
"""
"""Runs a command where no extra is installed."""
SIM = load("sim")


class Kite(VehicleOptions, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="kite"):
    """A vehicle of another package."""

    string: Annotated[str, text("what holds it", 20, public=True)] = "hemp"
    response = "autopilot"

    @property
    def name(self) -> str:
        return f"a kite on {self.string}"


def test_the_modules_of_the_service_are_those_that_its_extra_installs() -> None:
    needs = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["service"]
    names = {re.split("[<>=]", need)[0].replace("-", "_") for need in needs}
    tops = metadata.packages_distributions().items()
    assert set(extras.SERVICE) == {top for top, owners in tops if names & {owner.replace("-", "_") for owner in owners}}


def test_each_command_of_the_library_alone_names_the_extra_of_the_service(tmp_path: Path) -> None:
    """`--version` and the help need nothing, since a person types them first."""
    alone = f"{_PLAIN.replace('{', repr(set(extras.SERVICE))[:-1] + ', ', 1)}"
    for words, code in (("--help", 0), ("--version", 0), ("demo", 2), ("run --config rig.toml", 2), ("record info x", 2)):
        done = subprocess.run(
            [sys.executable, "-c", alone, *words.split()],
            cwd=tmp_path,
            env={"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert (done.returncode, done.stderr.count("\n")) == (code, code // 2), done.stderr
        assert code == 0 or re.fullmatch(
            rf"decklander: decklander {words.split()[0]} needs \S+, which is not installed: .* decklander\[service\]\n",
            done.stderr,
        )


@pytest.mark.parametrize("capability", CAPABILITIES, ids=lambda capability: capability.what)
def test_what_the_table_names_is_there_and_in_the_extras_of_the_distribution(capability: Capability) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert capability.extra in project["optional-dependencies"]
    kinds = capability.vehicles.values()
    commands = (f"{command.module}:run" for command in capability.commands.values())
    for name in (capability.join, capability.references, *commands, *(name for kind in kinds for name in kind)):
        assert not name or imported(name) is not None
    for key in capability.keys:
        assert key.partition("=")[0] in dict(schema.walk(Settings))


def test_a_package_offers_a_vehicle_that_settings_then_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    offered = SimpleNamespace(
        name="kite", value="kites:KIND", load=lambda: VehicleKind("tests.companion.test_capabilities:Kite", "kites:make")
    )
    monkeypatch.setattr(metadata, "entry_points", lambda group: [offered] if group == capabilities.VEHICLE_GROUP else [])
    tables: dict[str, Any] = {"vehicle": {"kind": "kite"}, "camera": {"file": "sim"}, "pad": {"file": "thesis"}}
    settings = from_mapping(tables, "rig.toml")
    assert (settings.vehicle.kind, settings.vehicle.name) == ("kite", "a kite on hemp")
    assert 'string = "hemp"' in schema.toml(settings)
    tables["vehicle"]["string"] = 3
    with pytest.raises(BadInput, match=r"^rig\.toml: vehicle\.string must be text"):
        from_mapping(tables, "rig.toml")
    with pytest.raises(BadInput, match=r'^vehicle\.kind must be one of "ardrone", "kite", "mavlink", found "ufo"$'):
        vehicle_kind("ufo")


class Diary:
    """An importer of another package: a line of text a range, in decimetres and seconds."""

    def recognizes(self, path: Path) -> bool:
        return path.suffix == ".diary"

    def read(self, file: ForeignFile) -> Iterator[Sample]:
        for second, line in enumerate(file.path.read_text().split()):
            yield Range(stamp(second * NS_PER_S), 0.1 * float(line), 0.01)


def test_a_package_offers_an_importer_of_its_own_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    offered = SimpleNamespace(name="diary", value="diaries:IMPORTER", load=Diary)
    monkeypatch.setattr(metadata, "entry_points", lambda group: [offered] if group == capabilities.IMPORTER_GROUP else [])
    (tmp_path / "a.diary").write_text("31 28 25")
    command = ["record", "import", f"{tmp_path / 'a.diary'}@2", "--config", "sim", "--output", str(tmp_path / "a.mcap")]
    assert main(command) == 0
    ranges = [(event.stamp.measured_at // NS_PER_S, event.range_m) for event in open_recording([tmp_path / "a.mcap"]).events()]
    assert ranges == [(2, pytest.approx(3.1)), (3, pytest.approx(2.8)), (4, pytest.approx(2.5))]


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ("record import flight.ulg --config sim --output a.mcap", "flight.ulg: a PX4 log"),
        ("doctor flight.ulg", "flight.ulg: a PX4 log"),
        ("config import v.conf --out rig.toml", "decklander config import"),
    ],
)
def test_files_of_others_are_refused_where_their_import_is_not_installed(
    words: str, what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "flight.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8))
    monkeypatch.chdir(tmp_path)
    found = extras.is_installed
    monkeypatch.setattr(capabilities, "is_installed", lambda name: name != "drivers.imports" and found(name))
    assert main(words.split()) == 2
    line = f"decklander: {what} needs the import of others' files, which is not installed: install the extra decklander[logs]\n"
    assert capsys.readouterr().err == line


@pytest.mark.parametrize("key", ["http.foxglove = true", 'operator.gamepad = "thesis"', 'vessel.nmea = "127.0.0.1:10110"'])
def test_a_key_of_a_capability_that_is_not_installed_is_refused_in_a_settings_file(
    key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    capability = next(c for c in CAPABILITIES if key.partition(" ")[0] in c.keys)
    monkeypatch.setattr(capabilities, "is_installed", lambda name: name != capability.module)
    with pytest.raises(BadInput, match=rf"^rig\.toml: {key.partition(' ')[0]} needs .* extra decklander\[{capability.extra}\]$"):
        from_file(tomllib.loads(key), "rig.toml")


_MISSING = "from drivers import extras\nextras.is_installed = lambda name: name != 'companion.parts.ship'\n"
"""Takes the ship's wires away."""


@pytest.mark.parametrize(
    "command",
    [
        "simulate demo --set vessel.nmea=127.0.0.1:10110",
        "campaign demo --vary settings.vessel.nmea=a,b",
        "run --config sim --check --set rtk.source=ship",
    ],
)
def test_a_key_of_a_capability_that_is_not_installed_is_refused_at_the_command_line_too(command: str) -> None:
    words = [sys.executable, "-c", _MISSING + _PLAIN, *command.split()]
    done = subprocess.run(words, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False)
    needs = f"{words[-1].partition('=')[0]} needs the ship's wires, which is not installed: install the extra decklander[ship]"
    assert (done.returncode, done.stderr) == (2, f"decklander: {words[-2]}: {needs}\n")


@pytest.mark.parametrize("capability", [c for c in CAPABILITIES if c.keys], ids=lambda capability: capability.what)
def test_settings_that_want_what_is_not_installed_are_refused_in_a_line_that_says_what_to_install(
    capability: Capability, monkeypatch: pytest.MonkeyPatch
) -> None:
    key, _, value = capability.keys[0].partition("=")
    table, name = key.split(".")
    on: Any = value or (True if isinstance(getattr(getattr(SIM, table), name), bool) else "on")
    device = {"device": "/deck"} if table == "camera" else {}
    on = {"vessel.nmea": "127.0.0.1:10110", "bridge.links": "udpin://127.0.0.1:0"}.get(key, on)
    wanting = structs.replace(SIM, **{table: structs.replace(getattr(SIM, table), **{name: on}, **device)})
    assert not capability.wanted_by(SIM)
    found = extras.is_installed
    for missing in (capability.module, *capability.needs):
        for module in (capabilities, extras):
            monkeypatch.setattr(module, "is_installed", lambda name, missing=missing: name != missing and found(name))
        with pytest.raises(BadInput, match=rf"^{key} needs .* install the extra decklander\[{capability.extra}\]$"):
            check_installed(wanting)


@pytest.mark.parametrize("word", ["guidance.mission=thesis", "vision.method=fused", "estimator.path=dead_reckoning"])
def test_a_flight_that_wants_the_thesis_is_refused_without_it(word: str, monkeypatch: pytest.MonkeyPatch) -> None:
    wanting = with_overrides(SIM, [word], "--set")
    make_pilot(wanting)
    monkeypatch.setattr(capabilities, "is_installed", lambda name: name != "sitl.study.experiments")
    for module in ("estimator.pipeline", "estimator.vision.track.config"):
        monkeypatch.setattr(f"{module}.find_spec", lambda name: None)
    with pytest.raises(BadInput, match=rf"{word.partition('=')[2]}\W*needs .* the extra decklander\[compare\]$"):
        make_pilot(wanting)


def test_a_vehicle_that_is_not_installed_is_refused_likewise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capabilities, "is_installed", lambda name: not name.startswith("drivers.ardrone"))
    assert set(VEHICLES) == {"ardrone", "mavlink"}
    with pytest.raises(BadInput, match=r'kind = "ardrone" needs the AR.Drone, .* install the extra decklander\[ardrone\]$'):
        vehicle_kind("ardrone")


@pytest.mark.parametrize("command", OWNERS)
def test_a_command_that_is_not_installed_is_refused_likewise(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    owner = OWNERS[command]
    monkeypatch.setattr(capabilities, "is_installed", lambda name: name != owner.module)
    assert main([*command.split(), "--help"]) == 2
    assert re.fullmatch(
        rf"decklander: decklander {command} needs {owner.what}, .* install the extra decklander\[{owner.extra}\]\n",
        capsys.readouterr().err,
    )


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        ("completion bash", ""),
        ("pad check thesis", ""),
        ("pad import p.svg --size-mm 780 --out p.toml", "pads"),
        ("doctor flight.ulg", "logs"),
        ("doctor --config rig.toml", "ship"),
        ("watch --broker 127.0.0.1", "mqtt"),
    ],
)
def test_an_installation_without_extras_works_or_says_which_one_a_command_needs(words: str, extra: str, tmp_path: Path) -> None:
    (tmp_path / "flight.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8))
    (tmp_path / "p.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="80" height="80"><circle cx="40" cy="40" r="30"/></svg>'
    )
    tables = [
        '[vehicle]\nkind = "mavlink"\nlinks = "udpin://127.0.0.1:14550"',
        '[camera]\nfile = "sim"\nsource = "v4l2"\ndevice = "/dev/video9"',
        '[pad]\nfile = "thesis"',
    ]
    (tmp_path / "rig.toml").write_text("\n".join([*tables, '[vessel]\nnmea = "127.0.0.1:10110"\n']))
    command = [sys.executable, "-c", _PLAIN, *words.split()]
    done = subprocess.run(command, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False)
    if extra:
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert done.stderr.endswith(f"install the extra decklander[{extra}]\n")
    else:
        assert done.returncode == 0, done.stderr
