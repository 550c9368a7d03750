"""Record the faults that a run found, each once, with the shortest input that shows it."""

import hashlib
import traceback
from dataclasses import dataclass, field
from pathlib import Path

_LONGEST = 20_000
"""Characters of an input's repr and of a traceback that are written down."""


def innermost(why: BaseException) -> BaseException:
    """Return the first error that is not a group."""
    while isinstance(why, BaseExceptionGroup):
        why = why.exceptions[0]
    return why


def signature(why: BaseException, root: Path) -> str:
    """Return the error's kind and the innermost line of ours in its traceback; equal ones count as the same crash."""
    inner = innermost(why)
    ours = [frame for frame in traceback.extract_tb(inner.__traceback__) if Path(frame.filename).is_relative_to(root)]
    ours = [frame for frame in ours if ".venv" not in frame.filename] or ours
    where = f"{Path(ours[-1].filename).relative_to(root)}:{ours[-1].lineno}" if ours else "nowhere"
    return f"{type(inner).__name__} at {where}"


@dataclass(slots=True)
class Finds:
    """Writes each new fault to `folder` as `<target>-<hash>.bin` and `.txt`; a shorter input replaces a longer one.

    Raises:
        OSError: the folder cannot be written to.
    """

    target: str
    folder: Path
    root: Path
    lengths: dict[str, int] = field(default_factory=dict)

    def note(self, data: bytes, why: BaseException) -> None:
        """Record one input that broke the contract."""
        output = signature(why, self.root)
        if len(data) >= self.lengths.get(output, len(data) + 1):
            return
        self.lengths[output] = len(data)
        stem = f"{self.target}-{hashlib.sha256(output.encode()).hexdigest()[:8]}"
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / f"{stem}.bin").write_bytes(data)
        trace = "".join(traceback.format_exception(innermost(why)))
        text = f"{self.target}: {output}\n\ninput ({len(data)} bytes): {data!r:.{_LONGEST}}\n\n{trace[-_LONGEST:]}"
        (self.folder / f"{stem}.txt").write_text(text, encoding="utf-8", errors="backslashreplace")
