"""Check the folder of `--report` before the flight that the report is about."""

import tempfile
from pathlib import Path

from estimator.contracts.errors import BadInput, fault_of


def written(page: Path) -> str:
    """Return the line that says where the report is and how large."""
    return f"report: {page} ({page.stat().st_size / 1e6:.1f} MB, one file; open it in a browser)\n"


def prepare_folder(folder: Path | None) -> None:
    """Create the report's folder and check that files can be written into it; do nothing without a folder.

    Raises:
        BadInput: the folder cannot be created or written.
    """
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as why:
        raise BadInput(f"--report {folder}: {fault_of(why)}") from why
