"""The metadata of what is uploaded are held to their specification."""

import io
import tarfile
from pathlib import Path

import pytest

from supply import wheels

GOOD = (
    "Metadata-Version: 2.4\nName: decklander\nVersion: 1.0\nSummary: lands\nLicense-Expression: Apache-2.0\n"
    "Requires-Python: >=3.11\nDescription-Content-Type: text/markdown\n\n# Text\n"
)


def archive(folder: Path, text: str) -> Path:
    made = folder / "decklander-1.0.tar.gz"
    with tarfile.open(made, "w:gz") as out:
        entry = tarfile.TarInfo("decklander-1.0/PKG-INFO")
        entry.size = len(text.encode())
        out.addfile(entry, io.BytesIO(text.encode()))
    return made


def test_good_metadata_pass(tmp_path: Path) -> None:
    wheels.check_metadata(archive(tmp_path, GOOD))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("Apache-2.0", "Apache Two", "license"),
        ("Version: 1.0", "Version: one", "version"),
        (">=3.11", "later", "requires-python"),
        ("text/markdown", "text/plain", "no description in Markdown"),
        ("# Text", "", "no description in Markdown"),
        ("Summary: lands\n", "", "summary, licence or Python's version is missing"),
    ],
)
def test_what_an_index_would_refuse_is_refused_here(tmp_path: Path, old: str, new: str, told: str) -> None:
    with pytest.raises(wheels.WheelError, match=told):
        wheels.check_metadata(archive(tmp_path, GOOD.replace(old, new)))
