"""Read the network of vision's second opinion: the shipped one, or a file."""

from collections.abc import Iterator
from pathlib import Path

from companion.settings.capabilities import Reference
from companion.settings.model import Settings
from decklander.place import SHIPPED
from drivers.files import Largest, bytes_of
from estimator.contracts.errors import BadInput
from estimator.vision.learned.second_opinion import SecondOpinion

SHIPPED_NETWORK = SHIPPED / "learned" / "second_opinion.onnx"


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
        path.stat()
    except OSError as why:
        raise BadInput(f"{what}: {path}: {why.strerror or why}: {cure}") from why
    return SecondOpinion(bytes_of(path, Largest.NETWORK, f"{what}: {path}"), f"{what}: {path}")


def references(settings: Settings) -> Iterator[Reference]:
    """Yield the network that the settings name."""
    vision = settings.vision
    if vision.learned != "off":
        yield "vision.learned_file", (vision.learned_file,), lambda: second_opinion(vision.learned_file, "vision.learned_file")
