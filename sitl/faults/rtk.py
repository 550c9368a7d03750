"""Faults of the two receivers that measure the vector from the ship to the vehicle."""

from typing import Annotated, Literal

from estimator.contracts.keys import choice
from sitl.faults.fault import Fault


class RtkSolution(Fault, frozen=True, tag="rtk_solution"):
    """The receivers' solution is not what it should be."""

    solution: Annotated[
        Literal["silent", "float", "wrong"],
        choice("no solution; estimated ambiguities; or a wrong whole number of wavelengths, claimed as a right one"),
    ] = "silent"
