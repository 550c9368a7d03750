"""A sequence that is put together when somebody first reads it."""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar, overload

T = TypeVar("T")


class Late(Sequence[T]):
    """A sequence of known length whose items `make` returns when the first of them is read.

    There are hundreds of results of samples a second, and what reads them reads many at once: together they are put together in a
    fraction of the time.

    Args:
        n: their number.
        make: returns them; it is called once at most.
    """

    __slots__ = ("_items", "_make", "_n")

    def __init__(self, n: int, make: Callable[[], Sequence[T]]) -> None:
        self._n = n
        self._make: Callable[[], Sequence[T]] | None = make
        self._items: Sequence[T] = ()

    @property
    def items(self) -> Sequence[T]:
        """The items."""
        if self._make is not None:
            self._items, self._make = self._make(), None
        return self._items

    def __len__(self) -> int:
        return self._n

    def __iter__(self) -> Iterator[T]:
        return iter(self.items)

    @overload
    def __getitem__(self, index: int) -> T: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[T]: ...

    def __getitem__(self, index: int | slice) -> T | Sequence[T]:
        return self.items[index]

    def __eq__(self, other: object) -> bool:
        return list(self.items) == other if isinstance(other, list) else NotImplemented

    __hash__ = None  # type: ignore[assignment]
