"""The numbers of the error models, as a file holds them: configs/perception/*.toml, by `python -m sitl.study.perception`."""

import json
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from companion.settings.load import find_file, read_toml
from estimator.contracts.errors import BadInput, refused
from estimator.contracts.keys import number

FOLDER = "perception"
FORMAT = 1
"""Number of this layout of the file."""

Fraction = Annotated[float, number("fraction", "1", 0.0, 1.0)]
Count = Annotated[int, Meta(ge=0)]
Six = Annotated[tuple[float, ...], Meta(min_length=6, max_length=6)]
TwentyOne = Annotated[tuple[float, ...], Meta(min_length=21, max_length=21)]
Seven = Annotated[tuple[float, ...], Meta(min_length=7, max_length=7)]
TwentyEight = Annotated[tuple[float, ...], Meta(min_length=28, max_length=28)]
Edges = Annotated[tuple[float, ...], Meta(min_length=1, max_length=64)]


class DetectionCell(Struct, frozen=True, forbid_unknown_fields=True):
    """Detection at one height with one fraction of the disc in the image.

    Errors are those of the pose that vision measures, in the camera's axes: position right, down, forward over the height, then
    a small rotation of the pad, rad. Matrices are lower triangles, row by row.
    """

    height: Count
    """Index of the bin of height."""
    shown: Count
    """Index of the bin of the fraction of the disc that is in the image."""
    frames: Count
    found: Count
    kept: Fraction
    """Probability of a detection after a frame in which the pad was found."""
    regained: Fraction
    """Probability of a detection after a frame in which it was not."""
    confidence: Fraction
    ambiguous: Fraction = 0.0
    """Fraction of the detections that say that their heading may be half a turn off."""
    turned: Fraction = 0.0
    """Fraction of the detections whose heading is half a turn off."""
    outliers: Fraction = 0.0
    outlier_ratio: float = 1.0
    """Factor by which an outlier's errors are larger."""
    bias: Six = (0.0,) * 6
    error: TwentyOne = (0.0,) * 21
    """Covariance of the errors about the bias, without outliers."""
    claimed: TwentyOne = (0.0,) * 21
    """Covariance that vision claims, the mean."""
    spread: float = 0.0
    """Standard deviation of the logarithm of a detection's own scale, a factor of its errors and of its claims."""


class Factor(Struct, frozen=True, forbid_unknown_fields=True):
    """The effect of one condition on top of the cells: one entry for each bin."""

    edges: Edges
    frames: tuple[Count, ...]
    odds: tuple[float, ...]
    """Factor of the odds of a detection."""
    ratio: tuple[float, ...]
    """Factor of the errors and of the claimed standard deviations."""


class DetectionModel(Struct, frozen=True, forbid_unknown_fields=True):
    """The error model of detections."""

    heights_m: Edges
    """Edges between the bins of height of the lens over the pad's plane."""
    shown: Edges
    """Edges between the bins of the fraction of the disc in the image."""
    frames: Count
    frame_s: Annotated[float, number("time between the frames to which it was fitted", "s", 0.001, 1.0)]
    correlation: Annotated[float, number("correlation of the errors of two successive frames", "1", 0.0, 0.999)]
    tilt_deg: Factor
    """Angle between the optical axis and the pad's normal."""
    light_stops: Factor
    """Light on the pad against white paint at 80 % of full scale."""
    cell: Annotated[tuple[DetectionCell, ...], Meta(min_length=1)]
    scale_correlation: Annotated[float, number("the same of the logarithm of a detection's own scale", "1", 0.0, 0.999)] = 0.0


class EstimateCell(Struct, frozen=True, forbid_unknown_fields=True):
    """The estimate's error at one height, and one age of the newest sighting.

    Position forward, right and down over the height, velocity forward, right and down in m/s, heading in rad.
    """

    height: Count
    age: Count
    samples: Count
    error: TwentyEight
    """Covariance of the errors, the lower triangle row by row: the mean product, any bias included."""


class EstimateModel(Struct, frozen=True, forbid_unknown_fields=True):
    """The error model of the filter's estimate."""

    heights_m: Edges
    ages_s: Edges
    samples: Count
    correlation_s: Seven
    """Correlation time of each component."""
    cell: Annotated[tuple[EstimateCell, ...], Meta(min_length=1)]


class PerceptionModel(Struct, frozen=True, forbid_unknown_fields=True):
    """The content of one file."""

    format: Annotated[int, Meta(ge=1)]
    method: str
    """`vision.method` of the recorded flights."""
    recordings: tuple[str, ...]
    """The recordings to which the model was fitted: scenario, seed and number of frames."""
    detection: DetectionModel
    estimate: EstimateModel


def load(name_or_path: str) -> PerceptionModel:
    """Return the model in a file, or a shipped one by its bare name.

    Raises:
        BadInput: there is no such file, or it does not hold a model of this version. One line that names file and key.
    """
    path = find_file(name_or_path, FOLDER, Path(), "--perception-model")
    return _read(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=8)
def _read(path: Path, changed_ns: int) -> PerceptionModel:
    """Return the model in a file that was last changed at this time; the flights of one process read it once."""
    data = read_toml(path)
    if data.get("format") != FORMAT:
        raise BadInput(f"{path}: format {data.get('format')!r} is not {FORMAT}: fit again with python -m sitl.study.perception")
    with refused(str(path), msgspec.ValidationError):
        model = msgspec.convert(data, PerceptionModel, strict=True)
    _check(model, path)
    return model


def _check(model: PerceptionModel, path: Path) -> None:
    detection, estimate = model.detection, model.estimate
    for name, edges in (
        ("detection.heights_m", detection.heights_m),
        ("detection.shown", detection.shown),
        ("detection.tilt_deg.edges", detection.tilt_deg.edges),
        ("detection.light_stops.edges", detection.light_stops.edges),
        ("estimate.heights_m", estimate.heights_m),
        ("estimate.ages_s", estimate.ages_s),
    ):
        if any(b <= a for a, b in pairwise(edges)):
            raise BadInput(f"{path}: {name} must rise")
    for name, factor in (("detection.tilt_deg", detection.tilt_deg), ("detection.light_stops", detection.light_stops)):
        if not len(factor.frames) == len(factor.odds) == len(factor.ratio) == len(factor.edges) + 1:
            raise BadInput(f"{path}: {name} needs one entry more than it has edges")
        if any(not 0.0 < value < 1e6 for value in (*factor.odds, *factor.ratio)):
            raise BadInput(f"{path}: the odds and ratios of {name} must be positive")
    for n, cell in enumerate(detection.cell):
        if cell.height > len(detection.heights_m) or cell.shown > len(detection.shown):
            raise BadInput(f"{path}: detection.cell[{n}] lies outside the bins")
    for n, part in enumerate(estimate.cell):
        if part.height > len(estimate.heights_m) or part.age > len(estimate.ages_s):
            raise BadInput(f"{path}: estimate.cell[{n}] lies outside the bins")


def dump(model: PerceptionModel) -> str:
    """Return the text of a model's file."""
    lines = ["# Written by `python -m sitl.study.perception`. Fit it again rather than editing it.", ""]
    lines += [f"format = {model.format}", f"method = {_value(model.method)}", "recordings = ["]
    lines += [f"    {_value(name)}," for name in model.recordings] + ["]"]
    return "\n".join(lines + _table("[detection]", model.detection) + _table("[estimate]", model.estimate)) + "\n"


def _table(head: str, of: Struct) -> list[str]:
    """Return the lines of a table, then those of the tables in it."""
    out, inner, name = ["", head], [], head.strip("[]")
    for key in of.__struct_fields__:
        value = getattr(of, key)
        if isinstance(value, Struct):
            inner += _table(f"[{name}.{key}]", value)
        elif isinstance(value, tuple) and isinstance(value[0], Struct):
            inner += [line for part in value for line in _table(f"[[{name}.{key}]]", part)]
        else:
            out.append(f"{key} = {_value(value)}")
    return out + inner


def _value(value: Any) -> str:
    """Return a text, a number with five digits, or a list of numbers, as TOML."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_value, value))}]"
    return json.dumps(float(f"{value:.5g}") if isinstance(value, float) else value)
