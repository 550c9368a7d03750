"""Pads of one's own, read from drawings and photographs."""

import json
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from queue import Queue
from urllib.error import HTTPError
from urllib.request import urlopen

import cv2
import msgspec
import numpy as np
import pytest

from companion.cli.main import main
from companion.cli.pad import clicked
from companion.settings.load import read_toml
from companion.tools.pad_price import CAMERA, planted, price, view
from companion.tools.pads import foreign
from companion.tools.pads.photograph import photographed
from companion.tools.pads.svg import read_svg
from companion.tools.pads.trace import drawn, traced
from companion.tools.print_pad.sheets import pad_drawing, sheets, svg
from drivers.camera.images import ImageRefused, as_shown
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation
from estimator.vision.camera.pose import PadPose
from estimator.vision.pad.drawing import edges_of
from estimator.vision.pad.geometry import convex_pieces_of, covers, depth_in
from estimator.vision.pad.pad import RARE, Pad
from estimator.vision.pad.shapes import PaintedArrowhead, PaintedPolygon, PaintedRing
from tests.support.shipped import shipped_pad
from tests.support.users_pads import trust, user_s

SVG = """<svg xmlns="http://www.w3.org/2000/svg" width="400mm" height="500mm" viewBox="0 0 400 500">
  <style>.panel {fill: #101010; stroke: none}</style>
  <g transform="translate(20,-30)">
    <circle cx="180" cy="280" r="150"/><circle cx="180" cy="280" r="120" style="fill:white"/>
    <rect class="panel" x="150" y="190" width="60" height="60"/>
    <path d="m 120,300 h 120 v 60 H 120 Z M 150,315 v 30 h 40 v -30 z" fill="rgb(16,16,16)"/>
  </g></svg>"""


@pytest.fixture(autouse=True)
def drawn_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw in fewer pixels than for a person, to the same tenths of a millimetre, and in this process.

    tests/companion/test_files_of_others.py holds the child process to its bounds.
    """

    def drawn_here(module: str, task: str, data: bytes, where: str) -> bytes:
        try:
            return foreign._TASKS[task](data)
        except BadInput as why:
            raise BadInput(f"{where}: {why}") from why

    monkeypatch.setattr("companion.tools.pads.trace.ACROSS_PX", 1600)
    monkeypatch.setattr("companion.tools.pads.svg.in_child", drawn_here)


def imported(text: str, size_m: float | None = None, extent: str | None = None) -> Pad:
    return Pad.from_mapping(traced(drawn(read_svg(text, "a.svg"), size_m, "a.svg", extent), "a", "a.svg")[0])


@pytest.mark.parametrize(("name", "beyond_m"), [("thesis", 0.03), *((of, 0.0) for of in ("printed", "icao", "hospital", "lit"))])
def test_a_pad_that_is_printed_and_imported_is_the_same_pad(name: str, beyond_m: float) -> None:
    pad, change = shipped_pad(name), msgspec.structs.replace
    moved = (change(r, tip_m=r.tip_m + beyond_m) if isinstance(r, PaintedArrowhead) else r for r in pad.regions)
    drawing = pad_drawing(replace(pad, regions=tuple(moved)))
    page = svg(drawing, change(sheets(drawing, "full")[0], lines=(), labels=()))
    keys, remarks = traced(drawn(read_svg(page, "a.svg"), None, "a.svg"), "a", "a.svg")
    own, other = Pad.from_mapping(keys).markings, pad.markings
    for key in ("outer_radius_m", "rim_width_m", "ring_inner_m", "ring_outer_m"):
        assert getattr(own, key) == pytest.approx(getattr(other, key), abs=5e-4), key
    assert own.arrow_tip_m == pytest.approx(other.arrow_tip_m + beyond_m, abs=5e-4)
    assert own.lettering_m == pytest.approx(other.lettering_m, abs=2e-3)
    assert bool(remarks) == bool(pad.lamps)


def test_a_drawing_becomes_rings_and_polygons_with_holes_to_a_tenth_of_a_millimetre() -> None:
    pad = imported(SVG)
    ring = next(r for r in pad.regions if isinstance(r, PaintedRing))
    polygons = sorted((r for r in pad.regions if isinstance(r, PaintedPolygon)), key=lambda r: len(r.holes_m))
    assert (ring.inner_m, ring.outer_m) == pytest.approx((0.120, 0.150), abs=1e-4)
    assert pad.ground == "white"
    square, frame = polygons
    assert np.abs(square.corners()).max(axis=0) == pytest.approx((0.090, 0.030), abs=2e-4)
    at = np.array([(-0.05, -0.05), (-0.05, 0.0), (-0.05, 0.05)])
    assert covers(frame, at).tolist() == [True, False, True]
    assert (depth_in(frame, at) > 0.0).tolist() == [True, False, True]
    area = sum(cv2.contourArea(piece.astype(np.float32)) for piece in convex_pieces_of(frame))
    assert area == pytest.approx(0.12 * 0.06 - 0.04 * 0.03, rel=0.01)
    # The border of the hole is measured, too, and its normal points into the hole.
    edges = edges_of(pad)
    inner = np.abs(edges.at_m[:, 1]) < 0.0215
    assert np.any(inner & (np.abs(edges.at_m[:, 0] + 0.035) < 1e-3) & (edges.normal[:, 0] < -0.9))


def test_a_drawing_takes_the_size_that_it_is_given_and_needs_one() -> None:
    assert imported(SVG, 0.6).disc_radius_m == pytest.approx(0.3, rel=2e-3)
    with pytest.raises(BadInput, match="--size-mm"):
        imported(SVG.replace('width="400mm" height="500mm"', ""))


def test_sizes_left_out_paint_nothing_and_what_nearly_touches_is_a_pad_or_named() -> None:
    sizeless = '<g width="9"><ellipse cx="190" cy="225" r="17.5"/><circle cx="180" cy="250"/><rect x="90" height="40"/></g></svg>'
    assert imported(SVG.replace("</svg>", sizeless)).regions == imported(SVG).regions
    house = '<svg width="150mm" viewBox="0 0 150 150"><rect fill="#fff" width="150" height="150"/>{}</svg>'
    (merged,) = imported(house.format('<rect x="30" y="60" width="60" height="50"/><circle cx="60" cy="42" r="19.4"/>')).regions
    assert cv2.contourArea(merged.corners().astype(np.float32)) == pytest.approx(0.00415, rel=0.02)
    with pytest.raises(BadInput, match=r"a\.svg: draw the part -?[0-9]+ mm fore"):
        imported(house.format('<rect x="30" y="60" width="60" height=".5"/>'))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<svg", "no SVG drawing"),
        ("<html/>", "its root is no <svg>"),
        ('<svg viewBox="0 0 9 9"/>', "paints nothing"),
        ('<svg viewBox="0 0 9 9"><text>H</text></svg>', "convert it to paths"),
        ('<svg viewBox="0 0 9 9"><rect width="5" height="5" fill="url(#g)"/></svg>', "not in the drawing"),
        ('<svg viewBox="0 0 9 9"><use href="other.svg#a"/></svg>', "refers to 'other.svg#a'"),
        ('<svg viewBox="0 0 9 9"><style>@media print{rect{fill:red}}</style></svg>', "the rule '@media'"),
        ('<svg viewBox="0 0 9 9"><style>a+rect{fill:red}</style></svg>', "the selector"),
        ('<svg viewBox="0 0 9 9"><circle style="r:4px"/></svg>', "has 'r:'"),
        ('<svg viewBox="0 0 9 9"><rect width="5" height="5" opacity=".5"/></svg>', "half transparent"),
        ('<svg viewBox="0 0 9 9"><rect width="5" height="5"><animate/></rect></svg>', "animate"),
        ('<!DOCTYPE svg [<!ENTITY a "b">]><svg viewBox="0 0 9 9"/>', "no entities"),
    ],
)
def test_what_is_no_plain_drawing_is_refused_with_a_cure(text: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        imported(text, 0.5)


H = '<path d="M120 100h30v80h100v-80h30v200h-30v-90h-100v90h-30z" fill="#fff"/>'
ROUND = (
    f'<svg xmlns="http://www.w3.org/2000/svg" width="400mm" viewBox="0 0 400 400"><circle cx="200" cy="200" r="170"/>{H}</svg>'
)


@pytest.mark.parametrize(
    "changed",
    [
        (
            '<circle cx="200" cy="200" r="170"/>' + H,
            '<path fill-rule="evenodd" d="M30 200a170 170 0 01340 0 170 170 0 01-340 0z' + H[9:-15] + '"/>',
        ),
        (
            "<circle",
            '<clipPath id="c"><circle cx="200" cy="200" r="170"/></clipPath>'
            '<rect clip-path="url(#c)" width="400" height="400"/><circle',
        ),
        ("<circle", '<rect width="400" height="400" fill="#fff"/><circle'),
        ("#fff", "rgb(255,255,255)"),
    ],
    ids=["cut out", "clipped", "on a background", "no background"],
)  # fmt: skip
def test_lettering_in_the_colour_of_the_sheet_is_kept(changed: tuple[str, str]) -> None:
    pad = imported(ROUND.replace(*changed))
    disc, letter = pad.regions
    assert (pad.disc_radius_m, pad.ground) == (pytest.approx(0.17, abs=1e-3), "white")
    assert isinstance(letter, PaintedPolygon)
    assert pad.rgb(letter) == (255, 255, 255) != pad.rgb(disc)
    assert cv2.contourArea(letter.corners().astype(np.float32)) == pytest.approx(0.0151, rel=0.02)


def test_what_ends_in_white_has_no_known_ground() -> None:
    pad = imported(ROUND.replace("<circle", '<circle fill="#fff"').replace('d="M', 'style="fill:#00f" d="M'))
    assert (pad.ground, len(pad.regions)) == ("", 2)


def test_a_drawing_that_fills_its_sheet_keeps_its_size_and_middle_or_asks_for_them() -> None:
    sheet = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="400mm" viewBox="0 0 400 400"><rect width="400" height="400" fill="#048"/>'
    )
    text = f'{sheet}<rect x="100" y="40" width="100" height="60"/><rect x="100" y="140" width="100" height="60"/></svg>'
    with pytest.raises(BadInput, match="--extent sheet or --extent paint"):
        imported(text, 0.8)
    # A sheet that is painted beyond an edge between two pixels, as many programs' A4 is, ends there sharply.
    bled = text.replace('viewBox="0 0 400 400"', 'viewBox="0 0 400 282.9"')
    for (drawing, size_m, extent), (scale, middle) in {
        (bled, None, None): (1.0, (0.02145, -0.05)),
        (text, 0.8, "sheet"): (2.0, (0.16, -0.1)),
        (text, 0.8, "paint"): (5.0, (0.0, 0.0)),
    }.items():
        pad = imported(drawing, size_m, extent)
        corners = np.concatenate([region.corners() for region in pad.regions if isinstance(region, PaintedPolygon)])
        assert np.ptp(corners, axis=0) == pytest.approx((0.16 * scale, 0.1 * scale), rel=0.01)
        assert 0.5 * (corners.max(axis=0) + corners.min(axis=0)) == pytest.approx(middle, abs=2e-3)


@pytest.mark.parametrize(("half_m", "more"), [(0.2, []), (0.4, ["--sheet"])])
def test_a_photograph_is_rectified_by_four_corners_traced_and_found_again(tmp_path: Path, half_m: float, more: list[str]) -> None:
    pad = user_s("octagon")
    pose = PadPose(Rotation.from_rpy(0.2, -0.15, 0.1), np.array([0.02, -0.01, 0.95]))
    camera = replace(CAMERA, width=640, height=360, fx=512.0, fy=512.0, cx=319.5, cy=179.5)
    px = planted(np.asarray(cv2.resize(view(3), (640, 360)), np.uint8), camera, pad, pose, np.random.default_rng(1))
    square = half_m * np.array([(1, -1, 0), (1, 1, 0), (-1, 1, 0), (-1, -1, 0)])
    corners = camera.project(pose.points(square))
    picture, out = tmp_path / "photo.png", tmp_path / "mine.toml"
    cv2.imwrite(str(picture), px)
    places = " ".join(f"{u:.2f},{v:.2f}" for u, v in corners)
    size = f"{2000 * half_m:g}x{2000 * half_m:g}"
    words = ["pad", "import", str(picture), "--corners", places, "--size-mm", size, "--out", str(out), *more]
    assert main(words) == 0
    traced_pad = Pad.from_mapping(read_toml(out))
    assert cv2.imread(str(out.with_suffix(".preview.png"))) is not None
    assert traced_pad.disc_radius_m == pytest.approx(pad.disc_radius_m, rel=0.02)
    assert trust(traced_pad, px, pose, camera) >= 0.5


def test_a_photograph_whose_paint_reaches_the_edge_is_refused_with_its_share(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    px = np.full((420, 420, 3), 250, np.uint8)
    cv2.circle(px, (210, 210), 180, (200, 60, 20), -1)
    cv2.circle(px, (210, 210), 112, (250, 250, 250), 14)
    cv2.rectangle(px, (190, 180), (230, 240), (250, 250, 250), -1)
    picture = tmp_path / "photo.png"
    cv2.imwrite(str(picture), px)
    for at, code in ((28, 2), (5, 0), (150, 2)):
        corners = " ".join(f"{u},{v}" for u, v in ((at, at), (419 - at, at), (419 - at, 419 - at), (at, 419 - at)))
        words = ["pad", "import", str(picture), "--corners", corners, "--size-mm", "800x800", "--force"]
        assert main([*words, *["--sheet"][: at < 100], "--out", str(tmp_path / "mine.toml")]) == code
    err = capsys.readouterr().err
    assert "rectangle without 16 mm on each side, where sheets curl, and " in err
    assert " % of the paint would be left out: " in err
    assert "paint goes around the rectangle of --corners and would be left out: give one that holds all of the pad" in err


@pytest.mark.parametrize(("gap", "size_px"), [(5, 700), (5, 2100), (3, 1500), (14, 1000), (25, 2100)])
def test_an_arrowhead_of_a_picture_has_its_size_and_its_gap_to_the_ring(gap: int, size_px: int) -> None:
    round_parts = '<circle cx="350" cy="350" r="345"/><circle cx="350" cy="350" r="255" stroke="#fd2" stroke-width="30"/>'
    text = f'<svg viewBox="0 0 700 700"><g fill="#148">{round_parts}<path d="M350 20l-40 {60 - gap}h80" fill="#fd2"/></g></svg>'
    painted = read_svg(text, "a.svg").rendered(0.0, 0.0, (size_px, size_px), size_px / 700, crisp=False)
    px = np.where(painted[..., 3:] == 0, np.uint8(255), painted[..., :3])
    (arrow,) = traced(photographed(px, None, (0.69, 0.69), 3, "a.png"), "a", "a.png")[0]["regions"][2:]
    assert [arrow[key] for key in ("tip_m", "depth_m", "half_base_m")] == pytest.approx([0.33, 0.06 - 1e-3 * gap, 0.04], abs=2e-3)
    with pytest.raises(BadInput, match=r"mm2 of yellow 3[0-2]\d mm fore and -?0 mm right of the centre lies beyond the ring"):
        imported(text.replace("l-40 ", "h-40v").replace("h80", f"h80v-{60 - gap}"), 0.69)


def test_corners_are_clicked_on_a_page_that_only_its_address_opens() -> None:
    at, pages = [[10.0, 5.0], [90.5, 6.0], [95.0, 70.0], [8.0, 72.5]], Queue[str]()
    with ThreadPoolExecutor(1) as pool:
        taken = pool.submit(clicked, b"photo", pages.put)
        page = pages.get(timeout=10.0)
        for body in (b"[[1, 2]]", b"[[1, 1], [1, 2], [1, 3], [1, 4]]", json.dumps(at[::-1]).encode(), None):
            with pytest.raises(HTTPError):
                urlopen(page + "corners" if body else page[:-3], body)
        assert b"fore left" in urlopen(page).read()
        assert urlopen(page + "photo").read() == b"photo"
        urlopen(page + "corners", json.dumps(at).encode()).close()
        np.testing.assert_array_equal(taken.result(10.0), at)


def test_a_pad_with_more_to_tell_is_cheaper_and_its_calibration_belongs_to_its_drawing() -> None:
    pad = imported(SVG)
    found = price(pad, {}, 28)
    known = found.calibration
    assert known.chance <= RARE
    assert found.found[40.0] >= 0.8
    assert found.found[5.0] <= 0.5
    assert replace(pad, calibration=known).is_calibrated
    assert not replace(pad, calibration=known, regions=pad.regions[:2]).is_calibrated


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("hidden", [(0, 0, 0), (255, 255, 255), (0, 200, 0)])
def test_a_logo_on_glass_is_the_logo_on_white_whatever_colour_is_hidden(hidden, bits, tmp_path, capsys) -> None:
    paint, rows = np.zeros((600, 600), np.uint8), {}
    cv2.circle(paint, (300, 300), 260, 255, 40, cv2.LINE_AA)
    cv2.rectangle(paint, (260, 180), (340, 420), 255, -1)
    white = np.dstack([255 - paint] * 3)
    glass = np.dstack([np.where(paint[..., None] > 0, 0, np.array(hidden)).astype(np.uint8), paint])
    for name, px in (("white", white), ("glass", glass)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), px.astype(np.uint16) * 257 if bits == 16 else px)
        out = tmp_path / f"{name}.toml"
        assert main(["pad", "import", str(tmp_path / f"{name}.png"), "--size-mm", "900", "--out", str(out)]) == 0
        assert ("transparent" in capsys.readouterr().err) == (name == "glass")
        made = read_toml(out)
        rows[name] = made["ground"], [(region["shape"], region["paint"]) for region in made["regions"]]
    assert rows["glass"] == rows["white"]


def test_a_transparency_that_is_not_read_is_refused_and_an_unused_one_is_none() -> None:
    px = np.full((40, 60, 4), 90, np.uint8)
    px[..., 3] = 0
    assert not as_shown(cv2.imencode(".png", px)[1].tobytes())[1], "a file of 32 bits whose fourth byte means nothing"
    grey = cv2.imencode(".png", px[..., 0])[1].tobytes()
    chunk = b"tRNS\0\x5a"
    with pytest.raises(ImageRefused, match="alpha"):
        as_shown(grey[:33] + struct.pack(">I", 2) + chunk + struct.pack(">I", zlib.crc32(chunk)) + grey[33:])
