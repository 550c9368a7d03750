"""Field tables of navdata options: a structure whose annotations carry the wire type of each field.

All options are packed, little-endian. A field `Annotated[int, "I"]` is one number, `Annotated[tuple[float, ...], "9f"]` nine;
the letters are those of the `struct` module.
"""

import struct
from collections.abc import Callable
from typing import Annotated, Any, TypeVar, get_type_hints

U8 = Annotated[int, "B"]
U16 = Annotated[int, "H"]
I16 = Annotated[int, "h"]
U32 = Annotated[int, "I"]
I32 = Annotated[int, "i"]
F32 = Annotated[float, "f"]
F64 = Annotated[float, "d"]
Ints = tuple[int, ...]
Floats = tuple[float, ...]

OPTION_HEADER = struct.Struct("<HH")
"""The tag, and the size in bytes of the whole option with this header."""


class OptionLayout:
    """The wire layout of one option class."""

    def __init__(self, tag: int, cls: type[Any]) -> None:
        hints = get_type_hints(cls, include_extras=True)
        codes = [hints[name].__metadata__[0] for name in cls.__struct_fields__]
        self.tag = tag
        self.cls = cls
        self.names: tuple[str, ...] = cls.__struct_fields__
        self.body = struct.Struct("<" + "".join(codes))
        self.size = OPTION_HEADER.size + self.body.size
        self._codes = dict(zip(self.names, codes, strict=True))
        self._plan: list[tuple[int, int | None]] = []
        at = 0
        for code in codes:
            count = int(code[:-1] or 0)
            self._plan.append((at, at + count if count else None))
            at += count or 1
        self._flat = all(stop is None for _, stop in self._plan)

    def field(self, name: str) -> tuple[int, str]:
        """Return where a field begins in the body, bytes, and its letters of the `struct` module."""
        before = "".join(self._codes[other] for other in self.names[: self.names.index(name)])
        return struct.calcsize(f"<{before}"), self._codes[name]

    def unpack(self, data: bytes, offset: int) -> Any:
        """Return the option whose body begins at `offset`; the caller has checked that the body is whole."""
        values = self.body.unpack_from(data, offset)
        if self._flat:
            return self.cls(*values)
        return self.cls(*[values[start] if stop is None else values[start:stop] for start, stop in self._plan])

    def pack(self, option: Any) -> bytes:
        """Return the option's header and body.

        Raises:
            struct.error: a value does not fit its field.
        """
        values: list[Any] = []
        for name, (_, stop) in zip(self.names, self._plan, strict=True):
            value = getattr(option, name)
            if stop is None:
                values.append(value)
            else:
                values.extend(value)
        return OPTION_HEADER.pack(self.tag, self.size) + self.body.pack(*values)


LAYOUT_OF_CLASS: dict[type[Any], OptionLayout] = {}
TAG_OF_CLASS: dict[type[Any], int] = {}
C = TypeVar("C", bound=type[Any])


def option(tag: int) -> Callable[[C], C]:
    """Enter a class into the table of options under its tag; two classes of one tag differ in size."""

    def enter(cls: C) -> C:
        LAYOUT_OF_CLASS[cls], TAG_OF_CLASS[cls] = OptionLayout(tag, cls), tag
        return cls

    return enter
