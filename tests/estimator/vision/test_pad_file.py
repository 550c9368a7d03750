"""A pad's file: what is refused and how, and what is derived from the regions."""

import copy
import tomllib
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.errors import BadInput
from estimator.vision.drawing import EdgeKind, edges_of
from estimator.vision.pad import Pad
from estimator.vision.regions import PaintedLetter, PaintedPolygon, PaintedStroke, depth_in, outlines_of, part_of, rectangles_of
from tests.support.shipped import CONFIGS, shipped_pad

THESIS, HOSPITAL, FAA = (
    tomllib.loads((CONFIGS / "pads" / f"{name}.toml").read_text()) for name in ("thesis", "hospital", "faa_triangle")
)
SHIPPED = sorted(path.stem for path in (CONFIGS / "pads").glob("*.toml"))

STROKE = {"shape": "stroke", "width_m": 0.04}


def changed(region: int, **keys: Any) -> dict[str, Any]:
    data = copy.deepcopy(THESIS)
    data["regions"][region] |= keys
    return data


def beside(*regions: dict[str, Any], **region: Any) -> dict[str, Any]:
    data = copy.deepcopy(THESIS)
    data["paints"]["red"] = [190, 25, 30]
    data["regions"] += [*regions, *([region] if region else [])]
    return data


def upper(*regions: dict[str, Any]) -> dict[str, Any]:
    """Return the hospital's pad with more regions above."""
    return {**HOSPITAL, "regions": [*HOSPITAL["regions"], *regions]}


def triangle(**keys: Any) -> dict[str, Any]:
    """Return the pad with a triangle around the H, with other keys of the triangle."""
    data = copy.deepcopy(FAA)
    data["regions"][2] |= keys
    return data


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({**THESIS, "name": 3}, "name: Expected `str`, got `int`, got 3"),
        ({**THESIS, "sigma_m": 3}, "sigma_m is not a known key; did you mean size_sigma_m?"),
        ({**THESIS, "title": "mine"}, "title is not a known key; known here are name, paints, regions, lamps, size_sigma_m"),
        ({key: value for key, value in THESIS.items() if key != "paints"}, "paints is missing"),
        (changed(0, radus_m=0.39), "regions[0]: radus_m is not a known key; did you mean radius_m?"),
        (beside(shape="disc", paint="white"), "regions[4]: radius_m is missing"),
        (beside(paint="white"), "regions[4]: Object missing required field `shape`"),
        (changed(0, radius_m="wide"), "regions[0].radius_m: Expected `float`, got `str`, got 'wide'"),
        (changed(0, radius_m=390), "regions[0].radius_m must be 0.001 to 20 m, got 390.0: is it in millimetres? Write metres"),
        (changed(0, radius_m=10**400), "regions[0].radius_m: Number out of range, got 1000"),
        (changed(1, inner_m=0.3), "regions[1]: inner_m must be less than outer_m, got 0.3 and 0.261"),
        (changed(3, paint="pink"), "regions[3].paint 'pink' is not in [paints], which has 'green, orange, white'"),
        (changed(3, paint="green"), "regions[3] lies in regions[0], which has the same paint 'green': it cannot be seen"),
        (changed(3, length_m=0.6), "lettering must fit inside of the ring, whose inner_m is 0.243"),
        (changed(3, stroke_m=0.11), "regions[3]: stroke_m 0.11 or bar_m 0.11 leaves no room"),
        (changed(2, tip_m=0.41), r"regions[2] (arrow) crosses the border of regions[0] (disc)"),
        (changed(2, tip_m=0.25), "must have the ring's paint and point beyond it: its tip_m is 0.25"),
        (beside(shape="disc", paint="white", radius_m=0.1), "regions[4] is a second disc beside regions[0]"),
        (beside({**STROKE, "paint": "orange", "from_m": [0.1, 0.05], "to_m": [0.2, 0.05]}), "crosses the border of regions[3]"),
        (
            beside(*[{**STROKE, "paint": p, "from_m": [0.1, 0], "to_m": [0.12, 0]} for p in ("orange", "red")]),
            "several paints ('orange, red, white'); give them one, and a second one to those that lie above",
        ),
        (beside(shape="stroke", paint="white", from_m=[0, 0], to_m=[0.1, 0.1], width_m=0.02), "draw both as one polygon"),
        (beside(shape="stroke", paint="white", from_m=[0, 0.1], to_m=[0, 0.1], width_m=0.02), "from_m and to_m must differ"),
        (beside(shape="polygon", paint="white", points_m=[[0, 0], [0.1, 0.1], [0.1, 0], [0, 0.1]]), "does not touch itself"),
        (beside(shape="triangle", paint="white", side_m=0.2, stroke_m=0.01), "a triangle and an arrowhead are in regions"),
        (triangle(stroke_m=0.3), "regions[2].stroke_m 0.3 leaves no room in a triangle of side_m 0.7"),
        (triangle(side_m=1.0), "the triangle must fit inside of the ring, whose inner_m is 0.485"),
        (triangle(paint="asphalt"), "the triangle must have the lettering's paint, got 'asphalt'"),
        (triangle(side_m=0.3, stroke_m=0.02), "touches regions[2] (triangle) of the same paint"),
        (
            upper({"shape": "stroke", "paint": "red", "from_m": [0.44, 0.0], "to_m": [0.0, 0.2352], "width_m": 0.002}),
            "regions[4] of the second paint 'red' touches the border of regions[2]",
        ),
        (
            upper({"shape": "stroke", "paint": "red", "from_m": [-0.3, 0.3], "to_m": [-0.25, 0.3], "width_m": 0.02}),
            "regions[4] of the second paint 'red' lies beside the other lettering",
        ),
        (
            upper({"shape": "stroke", "paint": "white", "from_m": [-0.3, 0.3], "to_m": [-0.25, 0.3], "width_m": 0.02}),
            "regions[3] has the second paint 'red' of lettering, and lettering of the first one follows",
        ),
        (beside(shape="blob", paint="white"), "regions[4].shape: Invalid value 'blob', got 'blob'"),
        ({**THESIS, "regions": [*THESIS["regions"][1:], THESIS["regions"][0]]}, "regions[3] hides regions[0]"),
        ({**THESIS, "paints": THESIS["paints"] | {"white": [5, 104, 3]}}, "does not stand out from 'green' below it: 0.00"),
        ({**THESIS, "size_sigma_m": 2}, "size_sigma_m: Expected `float` <= 0.05, got 2"),
        ({**THESIS, "disc_radius_m": 0.39}, 'write [[regions]] with shape = "disc"'),
    ],
)  # fmt: skip
def test_what_cannot_be_painted_is_refused_with_path_value_and_cure(data: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput) as why:
        Pad.from_mapping(data, "mine.toml")
    text = str(why.value)
    assert text.startswith("mine.toml: ")
    assert "\n" not in text
    assert said in text


@pytest.mark.parametrize("name", SHIPPED)
def test_the_edges_of_shipped_pads_lie_between_their_paints(name: str) -> None:
    pad = shipped_pad(name)
    edges = edges_of(pad)
    for side, rgb in ((-1e-4, edges.inside_rgb), (1e-4, edges.outside_rgb)):
        at = edges.at_m + side * edges.normal
        seen = np.full((len(at), 3), 128)
        for region in pad.regions:
            seen[depth_in(region, at) > 0.0] = pad.rgb(region)
        assert np.array_equal(seen, rgb)
    bright = np.sign(edges.inside_rgb.sum(axis=1, dtype=int) - edges.outside_rgb.sum(axis=1, dtype=int))
    assert np.array_equal(np.sign(edges.contrast), bright)
    assert np.all(np.diff(edges.kind) >= 0)


def test_strokes_that_cross_are_one_shape() -> None:
    """Neither of two crossing strokes has an edge there, and the ground that both cover counts once."""
    arms = [PaintedStroke("white", (-0.2, 0.0), (0.2, 0.0), 0.04), PaintedStroke("white", (0.0, -0.15), (0.0, 0.15), 0.04)]
    area = sum((x1 - x0) * (y1 - y0) for x0, x1, y0, y1 in rectangles_of(arms))
    assert area == pytest.approx(0.4 * 0.04 + 0.3 * 0.04 - 0.04 * 0.04)
    cross = Pad("cross", (("white", (255, 255, 255)),), tuple(arms))
    letter = Pad("letter", (("white", (255, 255, 255)),), (PaintedLetter("white", "X", 0.4, 0.3, 0.04),))
    edges, same = edges_of(cross), edges_of(letter)
    assert np.all(edges.kind == EdgeKind.H)
    assert edges.spacing_m.sum() == pytest.approx(same.spacing_m.sum(), rel=0.02)
    assert min(np.abs(edges.at_m).max(axis=1)) > 0.0199


@settings(max_examples=60)
@given(st.sampled_from("HILTX"), st.floats(0.1, 0.5), st.floats(0.1, 0.5), st.floats(0.01, 0.04), st.floats(0.01, 0.04))
def test_the_rectangles_of_a_letter_cover_its_outline(letter, length, width, stroke, bar):
    painted = PaintedLetter("white", letter, length, width, stroke, bar)  # type: ignore[arg-type]
    rng = np.random.default_rng(1)
    at = rng.uniform(-0.3, 0.3, (400, 2))
    inside = depth_in(PaintedPolygon("white", tuple(map(tuple, outlines_of(painted)[0].tolist()))), at) > 0.0
    covered = sum(
        ((at[:, 0] > x0) & (at[:, 0] < x1) & (at[:, 1] > y0) & (at[:, 1] < y1)).astype(int)
        for x0, x1, y0, y1 in rectangles_of([painted])
    )
    assert np.array_equal(np.asarray(covered), inside.astype(int))


def test_a_ring_is_not_filled() -> None:
    ring = next(region for region in shipped_pad("thesis").regions if part_of(region) == "ring")
    x, y = outlines_of(ring, 3600)[0].T
    area = 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))
    assert area == pytest.approx(np.pi * (0.261**2 - 0.243**2), rel=1e-4)
