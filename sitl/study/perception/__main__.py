"""Fit the error models that `simulate --perception model` and `truth` fly by: `python -m sitl.study.perception`.

They are fitted to flights that `decklander simulate --record` recorded with --perception pixels. The more heights, tilts and
lights these hold, the wider the models reach.
"""

import argparse
import math
import sys
from pathlib import Path

from companion.settings.load import write_whole
from estimator.contracts.errors import BadInput
from sitl.perception.model import symmetric
from sitl.perception.parameters import PerceptionModel, dump
from sitl.study.perception.fit import fit
from sitl.study.perception.recorded import read


def main(argv: list[str] | None = None) -> None:
    """Run the command; one that cannot fit ends with the reason."""
    parser = argparse.ArgumentParser("python -m sitl.study.perception", description=__doc__)
    parser.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING", help="recording of one simulated flight")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE", help="file to write (TOML)")
    args = parser.parse_args(argv)
    if args.output.exists():
        parser.error(f"--output {args.output}: there is a file of that name already: name a new one")
    try:
        model = fit([read(path) for path in args.recordings])
        write_whole(args.output, dump(model))
    except (BadInput, OSError) as why:
        sys.exit(f"python -m sitl.study.perception: {why}")
    print(f"{_table(model)}\nwritten: {args.output}")


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


if __name__ == "__main__":
    main()
