"""The door to a native library: its entries, the numbers of its header, and its structures in memory of ours.

The library of the estimator lies beside this module. Any thread may call it: its entries change only what they are given. A call
releases the interpreter's lock. cffi refuses a pointer to another structure with a TypeError.
"""

import weakref
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.errors import SetupImpossible
from estimator.core import CURE, abi

FILE = f"{__file__.rpartition('/')[0]}/libdecklander.so.1"
"""Path of the library that `python -m supply.core` builds.

Python would take a name that ends with ".so" for an extension module.
"""


class Door:
    """A loaded library. `lib` has its entries, `file` is where it lies, `ffi` the types of its header.

    Call entries as `door.lib.name(...)` each time: tests load another library in its place.

    Args:
        made: the module that was made from the library's header.
        file: the library.

    Raises:
        SetupImpossible: it is missing, no library for this machine, or built from another header.
    """

    lib: Any
    file: str

    def __init__(self, made: ModuleType, file: str) -> None:
        self.ffi: Any = made.ffi
        self._digest: int = made.DIGEST
        self._members: dict[Any, dict[str, Any]] = {}
        self._held: weakref.WeakKeyDictionary[Any, list[Any]] = weakref.WeakKeyDictionary()
        self._dtypes: dict[str, tuple[np.dtype[Any], Any]] = {}
        self.load(file)

    def load(self, file: str) -> None:
        """Call this library from now on.

        Raises:
            SetupImpossible: as at the start.
        """
        try:
            lib = self.ffi.dlopen(file)
            found = int(lib.dl_digest())
        except OSError as why:
            raise SetupImpossible(f"the native core {file} cannot be loaded ({why}); {CURE}") from why
        except self.ffi.error as why:
            raise SetupImpossible(f"{file} is not the native core; {CURE}") from why
        if found != self._digest:
            raise SetupImpossible(
                f"the native core {file} was built for interface {found:08x}, this code needs {self._digest:08x}; {CURE}"
            )
        self.lib, self.file = lib, file

    def dtype(self, kind: str) -> np.dtype[Any]:
        """Return the layout of a C type as numpy's: of a number by its name, of a structure with its members."""
        return self._known(kind)[0]

    def names(self, enumeration: str) -> dict[str, int]:
        """Return the names of an enumeration and their values, in order."""
        return dict(sorted(self.ffi.typeof(f"enum {enumeration}").relements.items(), key=lambda named: named[1]))

    def record(self, kind: str, /, **values: Any) -> NDArray[Any]:
        """Return a structure, an array without axes whose members are read and written as `record["name"]`.

        Args:
            kind: the structure's name in the header.
            values: its members by name: a number, an array, a mapping for a structure, or a sequence of mappings. Those that are
                left out are zero, as are elements after those given.

        Raises:
            ValueError: the structure has no such member, or it holds fewer elements.
            TypeError: a number of another kind.
        """
        made = np.zeros((), self.dtype(kind))
        _fill(made, values)
        return made

    def new(self, kind: str, /, **values: Any) -> Any:
        """Return a structure for entries and for reading and writing one number at a time, `made.name`; members as in `fill`."""
        made = self.ffi.new(f"{kind} *")
        self.fill(made, **values)
        return made

    def fill(self, made: Any, /, **values: Any) -> None:
        """Write members of a structure: numbers, one number for a whole array, arrays, or another structure.

        A member that points takes an array, which lives as long as the structure does, or None.

        Raises:
            AttributeError: it has no such member.
            IndexError: it holds fewer elements.
            TypeError: a number of another kind, or an array of another kind of numbers.
        """
        whole = self.ffi.typeof(made)
        members = self._members.get(whole)
        if members is None:
            members = self._members[whole] = {name: member.type for name, member in whole.item.fields}
        for name, value in values.items():
            kind = members.get(name)
            if kind is not None and kind.kind == "pointer" and not isinstance(value, self.ffi.CData):
                self._held.setdefault(made, []).append(value)
                value = self.ffi.NULL if value is None else self.array(kind.item.cname, value)
            elif kind is not None and kind.kind == "array":
                value = np.ravel(value).tolist() if np.ndim(value) else [value] * kind.length
            setattr(made, name, value)

    def array(self, kind: str, values: NDArray[Any], count: int | None = None) -> Any:
        """Return the memory of an array as C's, for a parameter that points to this kind.

        Args:
            kind: a number or a structure of the header.
            values: the array, its elements one after the other.
            count: how many elements C takes for granted. By default C learns it by another parameter.

        Raises:
            TypeError: the elements are of another kind.
            ValueError: there are more or fewer of them, or they do not lie one after the other.
        """
        dtype, pointer = self._known(kind)
        if values.dtype != dtype:
            raise TypeError(f"the core takes {kind}, not {values.dtype}")
        if count is not None and values.size != count:
            raise ValueError(f"the core takes {count} of {kind}, not {values.size}")
        return self.ffi.from_buffer(pointer, values if values.dtype.names is None else values.reshape(-1).view(np.uint8))

    def block(self, kind: str, count: int) -> tuple[NDArray[np.uint8], Any]:
        """Return bytes for structures that C writes, and C's pointer to the first of this many.

        numpy takes ten times as long to make an array of structures, or to lend one to C, as to do so with bytes.
        """
        dtype, pointer = self._dtypes.get(kind) or self._known(kind)
        block = np.empty(count * dtype.itemsize, np.uint8)
        return block, self.ffi.from_buffer(pointer, block)

    def room(self, kind: str, count: int) -> tuple[NDArray[Any], Any]:
        """Return room for structures that C writes: an array of this many, and C's pointer to the first."""
        block, pointer = self.block(kind, count)
        return np.ndarray((count,), self._dtypes[kind][0], block), pointer

    def _known(self, kind: str) -> tuple[np.dtype[Any], Any]:
        known = self._dtypes.get(kind)
        if known is None:
            known = self._dtypes[kind] = (self._dtype(self.ffi.typeof(kind)), self.ffi.typeof(f"{kind}[]"))
        return known

    def _dtype(self, kind: Any) -> np.dtype[Any]:
        if kind.kind == "enum":
            return np.dtype("i4")
        if kind.kind == "primitive":
            return np.dtype({"double": "f8", "float": "f4", "_Bool": "?"}.get(kind.cname) or kind.cname.removesuffix("_t"))
        if kind.kind == "array":
            return np.dtype((self._dtype(kind.item), (kind.length,)))
        members = dict(kind.fields)
        return np.dtype(
            {
                "names": list(members),
                "formats": [self._dtype(member.type) for member in members.values()],
                "offsets": [member.offset for member in members.values()],
                "itemsize": self.ffi.sizeof(kind),
            }
        )


def _fill(place: NDArray[Any], values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        member, each = place[name].reshape(-1), value
        if member.dtype.names is None:
            each = np.ravel(value)
        elif isinstance(value, Mapping):
            each = [value]
        if len(each) > len(member):
            raise ValueError(f"{name} holds {len(member)} elements, not {len(each)}")
        if member.dtype.names is None:
            np.copyto(member[: len(each)], each, casting="same_kind")
            continue
        for i, one in enumerate(each):
            _fill(member[i, ...], one)


CORE = Door(abi, FILE)
"""The library that flies."""
