"""Text files that were edited on Windows are read as any other."""

from collections.abc import Callable
from pathlib import Path

import pytest

from companion.settings.files import key
from companion.settings.load import load
from companion.tools.doctor.gather_outside import parameters_of
from drivers.file_kinds import FileKind, kind_of
from drivers.imports.pictures import attitudes
from estimator.contracts.errors import BadInput
from estimator.contracts.text import text_of

WAYS: dict[str, Callable[[str], bytes]] = {
    "mark": lambda text: text.encode("utf-8-sig"),
    "lines": lambda text: text.replace("\n", "\r\n").encode(),
    "wide": lambda text: text.encode("utf-16"),
    "wide, big end first": lambda text: b"\xfe\xff" + text.encode("utf-16-be"),
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_files_of_windows_are_read(tmp_path: Path, way: Callable[[str], bytes]) -> None:
    def written(name: str, text: str) -> Path:
        path = tmp_path / name
        path.write_bytes(way(text))
        path.chmod(0o600)
        return path

    sim = Path("configs/sim.toml").read_text(encoding="utf-8")
    assert load(written("rig.toml", sim)).camera.file == load("sim").camera.file
    assert key(str(written("a.key", "ab" * 32 + "\n")), "mqtt.command_key_file") == b"\xab" * 32
    assert parameters_of(written("a.param", "PLND_LAG,0.05\nPLND_ENABLED,1\n")).parameters["PLND_LAG"] == 0.05
    table = written("a.csv", "time_s,roll_deg,pitch_deg\n0,1,2\n0.1,1,2\n")
    assert (kind_of(table), len(attitudes(table))) == (FileKind.TABLE, 2)


def test_what_is_no_text_is_named() -> None:
    for data, why in ((b"a\xff", "byte 1"), ("ab".encode("utf-16-le"), "UTF-16 without a byte order mark")):
        with pytest.raises(BadInput, match=why):
            text_of(data, "a.toml")
