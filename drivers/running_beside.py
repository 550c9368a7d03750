"""Tasks that run while a caller's block runs, without the caller's own error coming out wrapped in a group."""

import asyncio
from collections.abc import AsyncIterator, Coroutine, Iterable
from contextlib import asynccontextmanager
from typing import Any


@asynccontextmanager
async def running_beside(tasks: Iterable[tuple[str, Coroutine[Any, Any, None]]]) -> AsyncIterator[None]:
    """Run each (name, coroutine) as a task until the block ends; then cancel the tasks and wait for them.

    Raises:
        Exception: the block's own error, as it is.
        ExceptionGroup: the errors of tasks, which also end the block.
    """
    failed: Exception | None = None
    async with asyncio.TaskGroup() as group:
        started = [group.create_task(body, name=name) for name, body in tasks]
        try:
            yield
        except Exception as why:
            failed = why
        finally:
            for task in started:
                task.cancel()
    if failed is not None:
        raise failed
