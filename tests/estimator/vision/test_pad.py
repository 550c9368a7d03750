"""A pad's file: what is refused and how, what is derived from the regions, edges, and the coverage of slanted shapes."""

import copy
import re
import tomllib
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.errors import BadInput
from estimator.vision.pad.drawing import edges_of
from estimator.vision.pad.geometry import convex_pieces_of, covers, depth_in, is_slanted, outlines_of, rectangles_of
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import PaintedLetter, PaintedPolygon, PaintedStroke, PaintedTriangle, Region
from tests.support.shipped import CONFIGS, shipped_pad

THESIS, HOSPITAL, FAA = (
    tomllib.loads((CONFIGS / "pads" / f"{name}.toml").read_text()) for name in ("thesis", "hospital", "faa_triangle")
)
SHIPPED = sorted(path.stem for path in (CONFIGS / "pads").glob("*.toml"))

STROKE = {"shape": "stroke", "width_m": 0.04}


def alter(region: int, **keys: Any) -> dict[str, Any]:
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


def on_sheet(side_m: float, *, polygon: bool = False, paint: str = "white", stroke_m: float = 0.04) -> dict[str, Any]:
    """Return a ring with an H on a square sheet, as a person writes it first."""
    corners = [[0.5 * x * side_m, 0.5 * y * side_m] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    square = {"shape": "polygon", "points_m": corners} if polygon else {"shape": "panel", "length_m": side_m, "width_m": side_m}
    ring = {"shape": "ring", "paint": "orange", "inner_m": 0.4, "outer_m": 0.5}
    letter = {"shape": "letter", "letter": "H", "paint": "green", "length_m": 0.4, "width_m": 0.3, "stroke_m": stroke_m}
    return {**THESIS, "regions": [{**square, "paint": paint}, ring, letter]}


@settings(max_examples=30, deadline=None)
@given(side_m=st.floats(1.01, 3.0), polygon=st.booleans(), named=st.booleans())
def test_a_sheet_around_a_ring_is_its_ground(side_m: float, polygon: bool, named: bool) -> None:
    written = on_sheet(side_m, polygon=polygon) | ({"ground": "white"} if named else {})
    pad, known = Pad.from_mapping(written), Pad.from_mapping({**written, "regions": written["regions"][1:], "ground": "white"})
    assert (pad.regions, pad.ground, pad.markings, pad.fingerprint) == (known.regions, "white", known.markings, known.fingerprint)
    assert [one.sheet is None for one in (pad, known)] == [False, True]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({**THESIS, "name": 3}, "name: Expected `str`, got `int`, got 3"),
        ({**THESIS, "sigma_m": 3}, "sigma_m is not a known key; did you mean size_sigma_m?"),
        ({**THESIS, "title": "mine"}, "title is not a known key; known here are name, paints, regions, lamps, size_sigma_m"),
        ({key: value for key, value in THESIS.items() if key != "paints"}, "paints is missing"),
        (alter(0, radus_m=0.39), "regions[0]: radus_m is not a known key; did you mean radius_m?"),
        (beside(shape="disc", paint="white"), "regions[4]: radius_m is missing"),
        (beside(paint="white"), "regions[4]: Object missing required field `shape`"),
        (alter(0, radius_m="wide"), "regions[0].radius_m: Expected `float`, got `str`, got 'wide'"),
        (alter(0, radius_m=390), "regions[0].radius_m must be 0.001 to 20 m, got 390.0: is it in millimetres? Write metres"),
        (alter(0, radius_m=10**400), "regions[0].radius_m: Number out of range, got 1000"),
        (alter(1, inner_m=0.3), "regions[1]: inner_m must be less than outer_m, got 0.3 and 0.261"),
        (alter(3, paint="pink"), "regions[3].paint 'pink' is not in [paints], which has 'green, orange, white'"),
        (alter(3, paint="green"), "regions[3] lies in regions[0], which has the same paint 'green': it cannot be seen"),
        (alter(3, length_m=0.6), "inside of the ring, whose inner_m is 0.243; a sheet or deck around"),
        (alter(3, stroke_m=0.11), "regions[3]: stroke_m 0.11 or bar_m 0.11 leaves no room"),
        (alter(2, tip_m=0.41), r"regions[2] (arrow) crosses the border of regions[0] (disc)"),
        (alter(2, tip_m=0.25), "must have the ring's paint and point beyond it: its tip_m is 0.25"),
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
        (on_sheet(0.9), "unless it comes first and lies around all others, a panel carries fiducials and lettering alone"),
        (on_sheet(1.5, paint="orange"), "regions[1].paint 'orange' [255, 149, 0] does not stand out from 'orange' below it"),
        (on_sheet(1.5, stroke_m=0.3), "regions[2]: stroke_m 0.3 or bar_m 0.3 leaves no room"),
        ({**on_sheet(1.5), "ground": "green"}, "is a sheet of paint 'white' below all others, and ground is 'green'"),
        (beside(shape="blob", paint="white"), "regions[4].shape: Invalid value 'blob', got 'blob'"),
        ({**THESIS, "regions": [*THESIS["regions"][1:], THESIS["regions"][0]]}, "regions[3] hides regions[0]"),
        ({**THESIS, "paints": THESIS["paints"] | {"white": [5, 104, 3]}}, "does not stand out from 'green' below it: 0.00"),
        ({**THESIS, "size_sigma_m": 2}, "size_sigma_m: Expected `float` <= 0.05, got 2"),
        ({**THESIS, "disc_radius_m": 0.39}, 'write [[regions]] with shape = "disc"'),
    ],
)  # fmt: skip
def test_what_cannot_be_painted_is_refused_with_path_value_and_cure(data: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput, match=rf"\Amine\.toml: [^\n]*{re.escape(said)}[^\n]*\Z"):
        Pad.from_mapping(data, "mine.toml")


@pytest.mark.parametrize("name", SHIPPED)
def test_the_edges_of_shipped_pads_lie_between_their_paints(name: str) -> None:
    pad = shipped_pad(name)
    edges = edges_of(pad)
    inside, outside = np.full((2, len(edges.at_m), 3), 128)
    for rgb, side_m in ((inside, -1e-4), (outside, 1e-4)):
        for region in pad.regions:
            rgb[depth_in(region, edges.at_m + side_m * edges.normal) > 0.0] = pad.rgb(region)
    assert np.array_equal(inside, edges.inside_rgb)
    assert np.array_equal(np.sign(edges.contrast), np.sign(inside.sum(axis=1) - outside.sum(axis=1)))
    assert np.all(np.diff(edges.kind) >= 0)
    assert np.all(np.diff(edges.piece) >= 0)


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


HOOK = PaintedPolygon("white", ((-0.3, -0.2), (0.3, -0.25), (0.1, 0.0), (0.28, 0.3), (-0.1, 0.1)))
TRIANGLE = PaintedTriangle("white", 0.7, 0.05)
BAR = PaintedStroke("white", (-0.2, -0.1), (0.2, 0.15), 0.05)


@pytest.mark.parametrize("region", [BAR, HOOK, TRIANGLE], ids=lambda r: type(r).__name__)
def test_convex_pieces_cover_a_shape_once(region: Region) -> None:
    assert is_slanted(region)
    at = np.random.default_rng(2).uniform(-0.5, 0.5, (4000, 2))
    times = np.zeros(len(at), int)
    for piece in convex_pieces_of(region):
        assert len(piece) in (3, 4)
        way = np.roll(piece, -1, axis=0) - piece
        to = at[:, None, :] - piece[None]
        times += np.all(way[None, :, 0] * to[..., 1] - way[None, :, 1] * to[..., 0] > 0.0, axis=1)
    assert np.array_equal(times, covers(region, at).astype(int))
