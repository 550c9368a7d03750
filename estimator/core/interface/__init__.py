"""The interface of the native core: one description, from which the C header is generated and Python's calls are declared.

`python -m supply.core --header` writes it as `interface.h`, which every C file includes, so the compiler holds the sources to it.
The library carries the digest of the header that it was compiled with. These files import nothing but each other: the generator
reads them where no library is built yet.
"""

from __future__ import annotations

import zlib

from . import eyes, filter, guidance, lamps, look, registration, render, search, sim, video
from .describe import Field, Function

_PARTS = (filter, guidance, registration, eyes, look, lamps, search, render, sim, video)
CONSTANTS = {name: value for part in _PARTS for name, value in part.CONSTANTS.items()}
"""Numbers that C and Python share, by their names in the header."""
STRUCTS: dict[str, tuple[Field, ...]] = {name: members for part in _PARTS for name, members in part.STRUCTS.items()}
"""The structures, without padding: every member is of eight bytes."""
FUNCTIONS = (
    Function("core_digest", "uint32_t", "void", "estimator/core/base/digest.c"),
    *(function for part in _PARTS for function in part.FUNCTIONS),
)
"""Every function that Python calls. Matrices are row-major; what a function writes overlaps nothing that it reads."""


def size_of(name: str) -> int:
    """Return the size of a structure in words of eight bytes."""
    return sum(member.length * (size_of(member.type) if member.type in STRUCTS else 1) for member in STRUCTS[name])


def places_of(name: str) -> dict[str, slice]:
    """Return where the members of a structure lie, in words."""
    found, at = {}, 0
    for member in STRUCTS[name]:
        size = member.length * (size_of(member.type) if member.type in STRUCTS else 1)
        found[member.name] = slice(at, at + size)
        at += size
    return found


def prototype(function: Function) -> str:
    """Return a function's prototype as one line of C."""
    return f"{function.result} {function.name}({function.parameters});"


def struct(name: str) -> str:
    """Return a structure's definition in C."""
    members = "".join(f"    {m.type} {m.name}{f'[{m.length}]' if m.length > 1 else ''};\n" for m in STRUCTS[name])
    return f"typedef struct {{\n{members}}} {name};\n"


def _body() -> str:
    constants = "\n".join(f"#define {name} {value}" for name, value in CONSTANTS.items())
    structs = "\n".join(map(struct, STRUCTS))
    files = sorted({function.source for function in FUNCTIONS})
    prototypes = "\n\n".join(
        "\n".join([f"/* {file} */", *(prototype(one) for one in FUNCTIONS if one.source == file)]) for file in files
    )
    return f"#include <stdint.h>\n\n{constants}\n\n{structs}\n{prototypes}\n"


def digest() -> int:
    """Return the digest that a library must carry to fit this interface."""
    return zlib.crc32(_body().encode())


def header() -> str:
    """Return the text of `interface.h`."""
    return (
        "/* Made from interface/ by `python -m supply.core --header`. */\n"
        "#ifndef DECKLANDER_INTERFACE_H\n#define DECKLANDER_INTERFACE_H\n\n"
        f"{_body()}\n#ifndef INTERFACE_DIGEST\n#define INTERFACE_DIGEST {digest()}u\n#endif\n\n#endif\n"
    )
