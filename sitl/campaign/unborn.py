"""First import of the server that forks a campaign's workers: a worker that outlives its campaign ends quietly.

It then finds neither the pool's locks nor its orders, and the server would print a traceback over the campaign's last line. An
error of another kind is one of ours, and is printed. Nothing else imports this module, for it replaces the hook of its process.
"""

import sys
from types import TracebackType

_ENDED = (FileNotFoundError, EOFError, ConnectionError)
"""Errors of a late-forked worker: the semaphore, the orders in the pipe or the pipe's reader are gone."""


def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print an error as Python does, unless it only says that the campaign has ended."""
    if not issubclass(kind, _ENDED):
        sys.__excepthook__(kind, error, trace)


sys.excepthook = hook
