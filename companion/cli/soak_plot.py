"""Plot a soak: the resources of the process over time, and the outcome of each flight."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from companion.cli.soak_flights import Class, Flown, by_fault, fault_of
from companion.cli.soak_judge import Reading
from estimator.contracts.errors import BadInput

_COLOURS = {Class.ON_PAD: "#2a9d3a", Class.REFUSED_RIGHTLY: "#3a6fb0", Class.FAILED: "#c0392b", Class.STARVED: "#8a8a8a"}
_ROW_IN = 0.16
"""Height of one fault's row, which its name needs, in."""


def plot(path: Path, readings: Sequence[Reading], flights: Sequence[Flown]) -> None:
    """Write the plot; the suffix of the path selects the format (png, svg, pdf).

    Raises:
        BadInput: the file cannot be written.
    """
    from matplotlib.figure import Figure

    names = sorted(by_fault(flights), reverse=True)
    rows_in = max(4.0, _ROW_IN * len(names))
    figure = Figure(figsize=(11, 5.0 + rows_in), layout="constrained")
    memory, counts, outcomes = figure.subplots(3, 1, height_ratios=[3.0, 2.0, rows_in])
    minutes = [reading.at_s / 60 for reading in readings]
    before = [reading.memory_mib if reading.before_mib is None else reading.before_mib for reading in readings]
    memory.plot(minutes, before, color="#bbbbbb", label="with the free pages that the allocator keeps")
    memory.plot(minutes, [reading.memory_mib for reading in readings], color="#333333", label="judged")
    memory.legend(loc="lower right", fontsize="small")
    memory.set_ylabel("memory, MiB")
    for name in ("descriptors", "threads", "tasks"):
        values = [getattr(reading, name) for reading in readings]
        if all(value is not None for value in values):
            counts.plot(minutes, values, label=name)
    counts.set_ylabel("count")
    counts.legend(loc="upper left", fontsize="small")
    rows = {name: n for n, name in enumerate(names)}
    for worth, colour in _COLOURS.items():
        its = [flight for flight in flights if flight.worth is worth]
        places = [rows[fault_of(flight.title)] for flight in its]
        outcomes.scatter([f.at_s / 60 for f in its], places, s=22, color=colour, label=f"{len(its)} {worth.value}")
    outcomes.set_yticks(range(len(names)), [name[:44] for name in names], fontsize="x-small")
    outcomes.set_xlabel("minutes since the start")
    outcomes.legend(loc="upper center", bbox_to_anchor=(0.4, -0.5 / rows_in), ncols=4, fontsize="small", frameon=False)
    for axes in (memory, counts, outcomes):
        axes.grid(alpha=0.25)
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as why:
        raise BadInput(f"--plot {path}: {getattr(why, 'strerror', None) or why}") from why
