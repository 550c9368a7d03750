"""The error tree, by what the caller can do about it.

    DecklanderError
    |- BadInput        the user's file, key or argument is wrong: say which and end with exit code 2
    |- Recoverable     the outside world failed (socket, device, peer): restart that one part
    `- SetupImpossible what was requested cannot exist on this machine (a missing device class or library)

Refusals of a single datum (a torn packet, an outlier) are results with a counter, never exceptions. Anything outside this
tree that escapes a task is a bug of ours and takes the service down loudly.
"""

import errno
from collections.abc import Iterator
from contextlib import contextmanager


class DecklanderError(Exception):
    """Base of every error raised on purpose.

    Its text is one line: a line break that a damaged file brought into it becomes a space, and what else cannot be printed is
    shown as Python writes it.
    """

    def __str__(self) -> str:
        text = super().__str__()
        if text.isprintable():
            return text
        return "".join(c if c.isprintable() else " " if c.isspace() else repr(c)[1:-1] for c in text)


class BadInput(DecklanderError):
    """The user's input is wrong; the text names the fault and its place in one line."""


class Recoverable(DecklanderError):
    """Something outside this process failed and may come back; the part that met it restarts alone."""


class SetupImpossible(DecklanderError):
    """This machine lacks something the request needs; trying again will not help."""


_NAMED_WRONG = frozenset(
    {
        *(errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ELOOP, errno.ENAMETOOLONG),
        *(errno.EACCES, errno.EPERM, errno.EINVAL),
    }
)


def one_line(text: str) -> str:
    """Return a text with a space in place of each line break and indentation."""
    return " ".join(text.split())


def unusable(what: str, why: OSError) -> DecklanderError:
    """Return the error for a file, folder or device of the user's that cannot be used, for the caller to raise from `why`.

    A wrong name, or one that may not be touched, stays so until somebody mends the settings: `BadInput`. A disk that fails, is
    full or read-only, or a machine without descriptors or memory, may be well again at the next try: `Recoverable`.

    Args:
        what: the setting and the name.
    """
    text = f"{what}: {fault_of(why)}"
    return BadInput(text) if why.errno in _NAMED_WRONG else Recoverable(text)


def fault_of(why: OSError) -> str:
    """Return the system's error for a file in the user's terms, such as "File exists" where a folder was to be made."""
    return "a file of that name is in the way" if why.errno == errno.EEXIST else why.strerror or str(why)


@contextmanager
def file_errors(what: str) -> Iterator[None]:
    """Turn an error of the system about a file into the one that `unusable` names.

    Raises:
        DecklanderError: it cannot be read or written.
    """
    try:
        yield
    except OSError as why:
        raise unusable(what, why) from why


@contextmanager
def refused(what: str, *causes: type[Exception], by: type[DecklanderError] = BadInput) -> Iterator[None]:
    """Turn an error of these classes into one of ours, whose text is `what` and the fault."""
    try:
        yield
    except causes as why:
        fault = fault_of(why) if isinstance(why, OSError) else getattr(why, "strerror", None) or why
        raise by(f"{what}: {fault}") from why


def in_words(error: BaseException) -> str:
    """Return the first error of a group in one line, or the name of its class if it has no text."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    try:
        return " ".join(str(error).split()) or type(error).__name__
    except Exception:  # the text of an error is made by whoever raised it
        return type(error).__name__
