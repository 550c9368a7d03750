"""Back-pressure by type: a slot for the newest item alone, and a bounded queue that keeps every item until it is full."""

import asyncio
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Generic, TypeVar

T = TypeVar("T")


class _Mailbox(ABC, Generic[T]):
    """Items for one reader. Cancelling it loses nothing. After `fail` it gets what is left, then the error."""

    def __init__(self) -> None:
        self._end: BaseException | None = None
        self._ready = asyncio.Event()
        self.offered = 0

    @abstractmethod
    def _next(self) -> T | None:
        """Take the next item, or None if none waits."""

    def fail(self, why: BaseException) -> None:
        """No more items will come; the reader is to raise `why`."""
        self._end = why
        self._ready.set()

    async def get(self) -> T:
        """Wait for an item and return it."""
        while True:
            await self._ready.wait()
            if (item := self._next()) is not None:
                return item
            if self._end is not None:
                raise self._end
            self._ready.clear()

    async def __aiter__(self) -> AsyncIterator[T]:
        while True:
            yield await self.get()


class Latest(_Mailbox[T]):
    """One slot: a newer item replaces an unread one, and the replacement is counted."""

    def __init__(self) -> None:
        super().__init__()
        self._item: T | None = None
        self.replaced = 0

    def offer(self, item: T) -> T | None:
        """Put an item (from the loop's thread only) and return the unread one it pushed out, if any."""
        pushed_out, self._item = self._item, item
        self.offered += 1
        self.replaced += pushed_out is not None
        self._ready.set()
        return pushed_out

    def _next(self) -> T | None:
        item, self._item = self._item, None
        return item


class Line(_Mailbox[T]):
    """A bounded queue that drops the oldest when full, and counts the drops.

    Args:
        capacity: the largest number of items that wait.
        fetch: offers what has come elsewhere, as in a socket; it is called before what waits is taken.
    """

    def __init__(self, capacity: int, fetch: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self._items: deque[T] = deque()
        self._fetch = fetch
        self.capacity = capacity
        self.dropped = 0

    def offer(self, item: T) -> None:
        """Append an item (from the loop's thread only)."""
        self.offer_all((item,))

    def offer_all(self, items: Sequence[T]) -> None:
        """Append items, the oldest first (from the loop's thread only)."""
        if not items:
            return
        self._items.extend(items)
        self.offered += len(items)
        for _ in range(len(self._items) - self.capacity):
            self._items.popleft()
            self.dropped += 1
        self._ready.set()

    def __len__(self) -> int:
        return len(self._items)

    def _next(self) -> T | None:
        return self._items.popleft() if self._items else None

    def waiting(self) -> list[T]:
        """Take all items that wait, the oldest first, without waiting for one."""
        self._fetch()
        items = list(self._items)
        self._items.clear()
        return items

    def check(self) -> None:
        """Check that more items may come or some are left; raise the error of `fail` otherwise."""
        if self._end is not None and not self._items:
            raise self._end

    async def together(self) -> AsyncIterator[list[T]]:
        """Wait for items, and yield all that wait together, the oldest first."""
        while True:
            yield [await self.get(), *self.waiting()]
