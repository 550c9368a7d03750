"""The interface of the native core: one description, from which the C header is generated and Python's calls are declared.

`python -m supply.core --header` writes it as `interface.h`, which every C file includes, so the compiler holds the sources to it.
The library carries the digest of the header that it was compiled with. This file imports nothing of ours: the generator reads it
where no library is built yet.
"""

from __future__ import annotations

import zlib
from typing import NamedTuple

ORDER_MAX = 54
"""The largest number of states that a linear-algebra function takes."""
ROWS_MAX = 9
"""The largest number of measured numbers that a linear-algebra function takes."""

CONSTANTS = {"ORDER_MAX": ORDER_MAX, "ROWS_MAX": ROWS_MAX}
"""Numbers that C and Python share, by their names in the header."""


class Function(NamedTuple):
    """One function of the library."""

    name: str
    result: str
    """Its C type."""
    parameters: str
    """Its C parameters, as in a prototype."""
    source: str
    """The file that defines it."""


FUNCTIONS = (
    Function("core_digest", "uint32_t", "void", "core.c"),
    Function(
        "kalman_predict",
        "void",
        "int32_t n, const double *P, const double *F, const double *Q, double *P_after",
        "kalman.c",
    ),
    Function(
        "kalman_correct",
        "int32_t",
        "int32_t n, int32_t m, const double *P, const double *innov, const double *H, const double *R, "
        "double *dx, double *P_after, double *S, double *nis",
        "kalman.c",
    ),
)
"""Every function that Python calls. Matrices are row-major; what a function writes overlaps nothing that it reads."""


def prototype(function: Function) -> str:
    """Return a function's prototype as one line of C."""
    return f"{function.result} {function.name}({function.parameters});"


def _body() -> str:
    constants = "\n".join(f"#define {name} {value}" for name, value in CONSTANTS.items())
    files = sorted({function.source for function in FUNCTIONS})
    prototypes = "\n\n".join(
        "\n".join([f"/* {file} */", *(prototype(one) for one in FUNCTIONS if one.source == file)]) for file in files
    )
    return f"#include <stdint.h>\n\n{constants}\n\n{prototypes}\n"


def digest() -> int:
    """Return the digest that a library must carry to fit this interface."""
    return zlib.crc32(_body().encode())


def header() -> str:
    """Return the text of `interface.h`."""
    return (
        "/* Made from interface.py by `python -m supply.core --header`. */\n"
        "#ifndef DECKLANDER_INTERFACE_H\n#define DECKLANDER_INTERFACE_H\n\n"
        f"{_body()}\n#ifndef INTERFACE_DIGEST\n#define INTERFACE_DIGEST {digest()}u\n#endif\n\n#endif\n"
    )
