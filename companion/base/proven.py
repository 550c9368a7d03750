"""Treat settings that have worked since this computer was switched on as right, whatever fails later.

systemd does not restart a service that ends with exit code 2, because wrong settings stay wrong. But what looks like a wrong
setting may be a camera that is not ready yet, or a file on a failing disk, after a crash in flight. So the first frame that came
with certain settings is noted in $RUNTIME_DIRECTORY, which survives restarts but not a reboot. From then on the same error counts
as a failure outside the service: exit code 1, and a restart.
"""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from companion.base.observer import NullObserver, ProcessedFrame
from companion.settings import whole_file
from companion.settings.model import Settings
from estimator.contracts.errors import BadInput, DecklanderError, Recoverable, in_words

log = logging.getLogger(__name__)


class Proven(NullObserver):
    """An observer that notes the first frame.

    Args:
        settings: the settings of this run.
    """

    name = "proven"

    def __init__(self, settings: Settings, environment: Mapping[str, str] = os.environ) -> None:
        folder = environment.get("RUNTIME_DIRECTORY", "").split(":")[0]
        self._path = Path(folder) / "proven" if folder else None
        self._digest = hashlib.sha256(whole_file.toml(settings).encode()).hexdigest()
        self._noted = False

    @property
    def known(self) -> bool:
        """Whether a frame came with these settings in this run or an earlier one."""
        if self._noted or self._path is None:
            return self._noted
        try:
            return self._path.read_text().strip() == self._digest
        except (OSError, ValueError):
            return False

    def on_frame(self, processed: ProcessedFrame) -> None:
        if not self._noted:
            self._noted = True
            if self._path is not None:
                self._path.write_text(self._digest + "\n")

    @contextmanager
    def excusing(self) -> Iterator[None]:
        """Turn an error about settings that are `known` into a recoverable one.

        Raises:
            Recoverable: in place of that `BadInput`.
        """
        try:
            yield
        except BadInput as why:
            if not self.known:
                raise
            raise Recoverable(f"{why} (with these settings it has worked before)") from why
        except BaseExceptionGroup as group:
            wrong, other = group.split(BadInput)
            if wrong is None or (other is not None and other.split(DecklanderError)[1] is not None) or not self.known:
                raise
            raise Recoverable(f"{in_words(wrong)} (with these settings it has worked before)") from group
