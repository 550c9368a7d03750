"""Paper is true to scale: pages are rendered by another program, put together by their marks, and measured."""

import json
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.cli.main import main
from companion.settings.load import read_toml
from companion.tools.calibrate.board import Board
from companion.tools.print_pad.sheets import Disc, Polygon, board_drawing, pad_drawing, sheets
from decklander.place import SHIPPED
from estimator.vision.pad.pad import Pad
from tests.support.shipped import shipped_pad

PAD = Pad.from_mapping(read_toml(SHIPPED / "pads" / "thesis.toml"))
DPI = 100
PX_PER_MM = DPI / 25.4
needs_poppler = pytest.mark.skipif(shutil.which("pdftoppm") is None, reason="pdftoppm is not installed (Debian: poppler-utils)")


def rendered(pdf: Path) -> list[NDArray[np.uint8]]:
    """Pages as (H, W, 3) BGR at `DPI`."""
    subprocess.run(["pdftoppm", "-r", str(DPI), str(pdf), str(pdf.with_suffix(""))], check=True)
    return [cv2.imread(str(p)) for p in sorted(pdf.parent.glob(f"{pdf.stem}-*.ppm"))]


def near(px: NDArray[np.uint8], rgb: tuple[int, int, int]) -> NDArray[np.bool_]:
    low, high = ([side * 59 + c for c in rgb[::-1]] for side in (-1, 1))
    return cv2.inRange(px, np.array(low), np.array(high)) > 0


@needs_poppler
@pytest.mark.parametrize(("paper", "pages"), [("a4", 15), ("full", 1)])
def test_the_sheets_put_together_are_the_pad_in_its_true_size(tmp_path: Path, paper: str, pages: int) -> None:
    out = tmp_path / "pad.pdf"
    assert main(["pad", "print", "thesis", "--paper", paper, "--out", str(out)]) == 0
    drawing = pad_drawing(PAD)
    layout = sheets(drawing, paper)  # type: ignore[arg-type]
    images = rendered(out)
    assert len(images) == len(layout) <= pages
    side = round(800 * PX_PER_MM)
    whole = np.full((side, side, 3), 255, np.uint8)
    for sheet, px in zip(layout, images, strict=True):
        assert px.shape[:2] == pytest.approx((sheet.height_mm * PX_PER_MM, sheet.width_mm * PX_PER_MM), abs=1.0)
        window = [sheet.left_mm, sheet.top_mm, sheet.left_mm + sheet.window_width_mm, sheet.top_mm + sheet.window_height_mm]
        x0, y0, x1, y1 = (round(v * PX_PER_MM) for v in window)
        # One pixel in from the clip, where the drawing is whole.
        part = px[y0 + 1 : y1 - 1, x0 + 1 : x1 - 1]
        at_x, at_y = (round((v + 10) * PX_PER_MM) + 1 for v in (sheet.from_x_mm, sheet.from_y_mm))
        cut_x, cut_y = max(0, -at_x), max(0, -at_y)
        part = part[cut_y : cut_y + side - at_y - cut_y, cut_x : cut_x + side - at_x - cut_x]
        target = whole[at_y + cut_y : at_y + cut_y + part.shape[0], at_x + cut_x : at_x + cut_x + part.shape[1]]
        np.copyto(target, part[: target.shape[0], : target.shape[1]])
    green, white = near(whole, PAD.markings.colours.disc), near(whole, (255, 255, 255))
    orange = near(whole, PAD.markings.colours.ring)
    ys, xs = np.nonzero(~white)
    for low, high in ((xs.min(), xs.max()), (ys.min(), ys.max())):
        assert (high - low + 1) / PX_PER_MM == pytest.approx(2000 * PAD.disc_radius_m, abs=0.8)
    ys, xs = np.nonzero(orange)
    centre = (10 + 1000 * PAD.disc_radius_m) * PX_PER_MM
    reach_mm = (centre - ys.min()) / PX_PER_MM
    assert reach_mm == pytest.approx(1000 * PAD.markings.arrow_tip_m, abs=1.0)  # the arrow is up
    area_mm2 = float(np.count_nonzero(orange)) / PX_PER_MM**2
    ring = np.pi * (PAD.markings.ring_outer_m**2 - PAD.markings.ring_inner_m**2)
    head = PAD.markings.arrow_depth_m * PAD.markings.arrow_half_base_m
    ring_under_head = area_mm2 / 1e6 - ring
    assert 0.3 * head < ring_under_head < 1.02 * head
    assert area_mm2 / 1e6 == pytest.approx(ring + head, rel=0.05)
    half = side // 2
    assert np.count_nonzero(white[half - 5 : half + 5, half - 5 : half + 5]) == 100  # the H's cross-bar
    h = 2 * PAD.markings.h_length_m * PAD.markings.leg_width_m + PAD.markings.bar_length_m * PAD.markings.bar_width_m
    left = np.pi * PAD.disc_radius_m**2 - ring - head - h
    assert np.count_nonzero(green) / PX_PER_MM**2 / 1e6 == pytest.approx(left, rel=0.01)


@needs_poppler
@pytest.mark.parametrize("board", [Board(), Board("chessboard"), Board("charuco", 7, 10, 0.036, 0.026)])
def test_the_printed_board_is_found_where_it_was_drawn(tmp_path: Path, board: Board) -> None:
    out = tmp_path / "board.pdf"
    paper = "a3" if board.square_m > 0.03 else "a4"
    chosen = ["--square-mm", str(1000 * board.square_m), "--marker-mm", str(1000 * board.marker_m), "--paper", paper]
    if board.kind == "chessboard":
        chosen += ["--squares", "7x10"]
    assert main(["pad", "print", "--board", board.kind, *chosen, "--out", str(out)]) == 0
    (px,) = rendered(out)
    found = board.find(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY))
    ids, uv = found
    assert len(ids) == 6 * 9
    sheet = sheets(board_drawing(board), paper)[0]  # type: ignore[arg-type]
    corner = np.array([sheet.left_mm - sheet.from_x_mm, sheet.top_mm - sheet.from_y_mm])
    mm = (uv + 0.5) / PX_PER_MM - corner
    wanted = 1000 * board.corners_m[ids][:, :2]
    if board.kind == "chessboard" and np.linalg.norm(mm[0] - wanted[0]) > 10:
        wanted = wanted[::-1]  # a chessboard may be numbered from its other end
    assert np.abs(mm - wanted).max() < 0.15


def test_neighbouring_sheets_share_their_cut() -> None:
    """The mark on one sheet and the mark on the next are the same place of the drawing."""
    there = {(s.row, s.column): s for s in sheets(pad_drawing(PAD), "a4")}
    joints = 0
    for (row, column), left in there.items():
        right = there.get((row, column + 1))
        if right is None:
            continue
        joints += 1
        of_left = {round(m.x0 - left.left_mm + left.from_x_mm, 6) for m in left.lines if m.x0 == m.x1}
        of_right = {round(m.x0 - right.left_mm + right.from_x_mm, 6) for m in right.lines if m.x0 == m.x1}
        cut = round(right.from_x_mm + 5.0, 6)
        assert cut in of_left
        assert cut in of_right
    assert joints >= 8


def test_svg_says_millimetres_and_draws_the_same_circles(tmp_path: Path) -> None:
    out = tmp_path / "pad.svg"
    assert main(["pad", "print", "--paper", "full", "--out", str(out)]) == 0
    root = ET.parse(out).getroot()
    width_mm, height_mm = (float(root.attrib[k].removesuffix("mm")) for k in ("width", "height"))
    assert root.attrib["viewBox"] == f"0 0 {width_mm:g} {height_mm:g}"
    assert (width_mm, height_mm) == (800.0, 800.0)
    drawn = [float(c.attrib["r"]) for c in root.iter("{http://www.w3.org/2000/svg}circle")]
    assert drawn == pytest.approx([s.radius_mm for s in pad_drawing(PAD).shapes if isinstance(s, Disc)])
    out = tmp_path / "many.svg"
    assert [main(["pad", "print", *more, "--out", str(out)]) for more in ([], ["printed"], ["--force"])] == [0, 2, 0]
    assert len(list(tmp_path.glob("many_r*c*.svg"))) == len(sheets(pad_drawing(PAD), "a4"))


def test_shipped_pads_are_listed_and_checked(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pad", "list"]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert {"thesis", "printed", "icao", "helideck", "h", "x"} <= set(listed)
    assert main(["pad", "check", "x", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["alike_headings"] == 4
    assert "quarter turn" in found["warnings"][0]
    assert "any of these proportions is taken for it, and it is found from cold to 5.7 m" in found["warnings"][-1]
    ranges = [bound["range_m"] for bound in found["bounds"]]
    assert ranges[2:] == sorted(ranges[2:]), "less is known from farther away"


def test_a_triangle_is_checked_and_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pad", "check", "faa_triangle", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert ("triangle" in found["contrasts"], found["alike_headings"]) == (True, 1)
    assert any("nearly the same after a turn by 120 degrees" in warning for warning in found["warnings"])
    assert main(["pad", "print", "faa_triangle", "--out", str(tmp_path / "pad.pdf")]) == 0
    pad = shipped_pad("faa_triangle")
    shapes = pad_drawing(pad).shapes
    assert {shape.fill for shape in shapes} == {rgb for _, rgb in pad.paints}
    outer, inner = pad.markings.triangle.borders()
    line = next(shape for shape in shapes if isinstance(shape, Polygon) and len(shape.points_mm) == 8)
    painted = cv2.contourArea((1000 * outer).astype(np.float32)) - cv2.contourArea((1000 * inner).astype(np.float32))
    assert cv2.contourArea(line.points_mm.astype(np.float32)) == pytest.approx(painted, rel=1e-5)


@pytest.mark.parametrize("command", ["simulate calm --pad bar.toml", "detect frame.png --camera sim --pad bar.toml"])
def test_a_pad_that_clutter_is_taken_for_is_not_detected(command, tmp_path, monkeypatch, capsys):
    """A bar has no distinction: it looks like a plank."""
    monkeypatch.chdir(tmp_path)
    Path("bar.toml").write_text(
        'name = "bar"\n[paints]\nwhite = [245, 245, 245]\n[[regions]]\nshape = "stroke"\npaint = "white"\n'
        "from_m = [-0.2, 0.0]\nto_m = [0.2, 0.0]\nwidth_m = 0.1\n"
    )
    drawing = Pad.from_mapping(read_toml(Path("bar.toml"))).fingerprint
    with Path("bar.toml").open("a") as file:
        file.write(f'[calibration]\nleast_support = 5.0\nchance = 0.03\ndrawing = "{drawing}"\n')
    cv2.imwrite("frame.png", np.zeros((36, 64, 3), np.uint8))
    assert main(command.split()) == 2
    output = capsys.readouterr().err
    assert "clutter is taken for this pad in 30 of 1,000 frames" in output
    assert output.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        ["calibrate", "camera", "{}", "--out", "{}/camera.toml", "--figures", "{}"],
        ["campaign", "demo", "--report", "{}/report", "--out", "{}/flown", "--runs", "1"],
    ],
    ids=lambda words: words[0],
)
def test_every_command_that_draws_refuses_at_once(words, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main([word.format(tmp_path) for word in words]) == 2
    assert "matplotlib, which is not installed" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
