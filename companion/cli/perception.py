"""`decklander perception`: fit the error models of simulated perception to recorded flights."""

import argparse
import math
from pathlib import Path

from companion.cli.options import named_wait, option, print_result, reading
from companion.cli.outputs import ERROR_MODEL, output
from companion.settings.load import write_whole
from estimator.contracts.errors import file_errors
from sitl.perception.model import symmetric
from sitl.perception.parameters import PerceptionModel, dump
from study.perception.fit import fit
from study.perception.recorded import read

DESCRIPTION = "Fit the error models that `simulate --perception model` and `truth` fly by."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    fitting = actions.add_parser(
        "fit",
        help="fit to recorded flights",
        description="Fit the error models of detections and of the estimate to flights that `decklander simulate --record` "
        "recorded with --perception pixels. The more heights, tilts and lights they hold, the wider the models reach.",
    )
    option(fitting, "recordings RECORDING", "recording of one simulated flight", nargs="+", type=Path)
    output(fitting, "--output FILE", "file to write (TOML)", ERROR_MODEL, required=True)
    option(fitting, "--json", "print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    recorded = [read(path, reading(path.name, quiet=args.json)) for path in args.recordings]
    with named_wait("fitting", quiet=args.json):
        model = fit(recorded)
    with file_errors(f"--output {args.output}"):
        write_whole(args.output, dump(model))
    print_result(args, _findings(model), f"{_table(model)}\nwritten: {args.output}")
    return 0


def _findings(model: PerceptionModel) -> dict[str, object]:
    return {
        "method": model.method, "recordings": list(model.recordings), "frames": model.detection.frames,
        "found": sum(cell.found for cell in model.detection.cell), "cells": len(model.detection.cell),
        "correlation": model.detection.correlation,
        "estimates": model.estimate.samples, "estimate_cells": len(model.estimate.cell),
    }  # fmt: skip


def _table(model: PerceptionModel) -> str:
    lines = [f"vision.method {model.method}: {model.detection.frames} frames, {model.estimate.samples} estimates", ""]
    lines.append("height m    shown       frames   found  kept   right mm/m  down mm/m  forward mm/m  outliers")
    for cell in model.detection.cell:
        sigma = [1e3 * math.sqrt(max(0.0, v)) for v in symmetric(cell.error, 6).diagonal()[:3]]
        lines.append(
            f"{_bin(model.detection.heights_m, cell.height):11s} {_bin(model.detection.shown, cell.shown):11s} {cell.frames:6d}"
            f"  {cell.found:6d}"
            f"  {cell.kept:.3f} {sigma[0]:11.3f} {sigma[1]:10.3f} {sigma[2]:13.3f} {100 * cell.outliers:8.1f}%"
        )
    return "\n".join(lines)


def _bin(edges: tuple[float, ...], index: int) -> str:
    low = f"{edges[index - 1]:g}" if index else ""
    high = f"{edges[index]:g}" if index < len(edges) else ""
    return f"{low}-{high}" if low and high else f"over {low}" if low else f"under {high}"
