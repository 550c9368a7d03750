"""The settings file of a running service: read it, and save another text in its place, which the next start reads."""

import hashlib
import os
from pathlib import Path

from msgspec import Struct

from companion.settings.load import read_text, write_whole
from decklander.place import SHIPPED
from estimator.contracts.errors import BadInput, refused

BEFORE = ".before"
"""Suffix of the backup of the previous settings file."""


class SettingsFile(Struct, frozen=True):
    """See the module's docstring. A link is followed: the file that it names is replaced."""

    path: Path

    def read(self) -> tuple[str, str]:
        """Return the text, and its revision, which another text has not.

        Raises:
            BadInput: it cannot be read, or is not UTF-8.
        """
        text = read_text(self.path)
        return text, _revision(text.encode())

    def refusal(self) -> str:
        """Return why it cannot be saved here; empty if it can, as far as this shows before."""
        target = self.path.resolve()
        if target.is_relative_to(SHIPPED):
            return f"{self.path.name} belongs to the installation, and an update would overwrite it"
        if not os.access(target.parent, os.W_OK):
            return f"the service may not write into {target.parent}"
        if target.exists() and os.statvfs(target).f_flag & os.ST_RDONLY:
            return f"{target} is mounted read-only: mount its folder, writable, in place of the file"
        return ""

    def save(self, text: str, revision: str) -> str:
        """Replace the file as a whole, keep the one before beside it, and return the new revision.

        Args:
            revision: of the text that was edited.

        Raises:
            BadInput: it cannot be written, or was changed by somebody else since.
        """
        if refusal := self.refusal():
            raise BadInput(f"cannot be saved: {refusal}")
        if self.read()[1] != revision:
            raise BadInput(f"{self.path} was changed since it was read here: load it again, and make your changes again")
        target, content = self.path.resolve(), text.encode()
        with refused(f"cannot be saved: {target}", OSError):
            write_whole(target.with_name(target.name + BEFORE), target.read_bytes(), like=target)
            write_whole(target, content, like=target)
        return _revision(content)

    def save_beside(self, name: str, text: str) -> None:
        """Write a file of this name into the settings' folder; one that is there is kept, as `save` keeps it.

        Raises:
            BadInput: it cannot be written.
        """
        if refusal := self.refusal():
            raise BadInput(f"cannot be saved: {refusal}")
        like = self.path.resolve()
        target = like.with_name(name)
        with refused(f"cannot be saved: {target}", OSError):
            if target.exists():
                write_whole(target.with_name(name + BEFORE), target.read_bytes(), like)
            write_whole(target, text.encode(), like)


def _revision(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
