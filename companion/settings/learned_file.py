"""Read the trained network for a second opinion on candidates."""

from pathlib import Path

from companion.settings.load import SHIPPED
from companion.settings.plain_file import refuse_special
from estimator.contracts.errors import BadInput
from estimator.vision.learned.second_opinion import SecondOpinion

SHIPPED_NETWORK = SHIPPED / "learned" / "second_opinion.onnx"
_LARGEST_BYTES = 2_000_000


def second_opinion(file: str, what: str) -> SecondOpinion:
    """Return the network in a file; the shipped one for an empty name.

    Args:
        what: the setting or option that names the file, for errors.

    Raises:
        BadInput: the file cannot be read, is larger than 2 MB, or holds no network of this kind.
    """
    path = Path(file) if file else SHIPPED_NETWORK
    cure = (
        f"decklander is not installed completely: install it again, or name a network with {what}"
        if not file
        else (f"name a file that is there, or leave {what} empty for the shipped network")
    )
    try:
        found = path.stat()
        if found.st_size > _LARGEST_BYTES:
            raise BadInput(f"{what}: {path} has {found.st_size} bytes, a network for a second opinion at most {_LARGEST_BYTES}")
        refuse_special(path, f"{what}: {path}", _LARGEST_BYTES)
        return SecondOpinion(path.read_bytes(), f"{what}: {path}")
    except OSError as why:
        raise BadInput(f"{what}: {path}: {why.strerror or why}: {cure}") from why
