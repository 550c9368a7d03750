import math
import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from companion.report.figures import TruthTrack, all_series, body_over_pad, error_rows, timing_rows
from companion.report.flight_log import CommandRecord, FlightLog, FrameRecord, LoggedTouchdown, PhaseChange, TruthSample
from companion.report.overlay import Overlay, annotate, annotated_size
from companion.report.page import render, write_report
from companion.report.palette import OUTLINE, bgr, colour
from companion.report.video import FlightVideo, video_from_log
from estimator.contracts.commands import Hover, Land, Velocity
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Feature, RelativeState, Sighting, Verdict
from estimator.contracts.geometry import Rotation, Transform
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera import Camera
from tests.support.shipped import shipped_pad

CAMERA = Camera(
    320, 180, 187.3, 187.3, 159.5, 89.5, np.zeros(5), Transform(Rotation.from_rpy(0, 0, math.pi / 2), np.array([0.15, 0, 0]))
)
PAD = shipped_pad("thesis")


def ns(seconds: float) -> MonoNs:
    return MonoNs(round(seconds * 1e9))


def truth_at(t):
    """A descent from 3 m along a curve, turning through the limit of the heading's range."""
    return np.array([0.6 * math.cos(t), 0.5 - 0.1 * t, 3.0 - 0.6 * t]), math.remainder(3.0 + 0.2 * t, math.tau)


def flight(images=True) -> FlightLog:
    rng = np.random.default_rng(4)
    log = FlightLog("A test <flight> & more", ns(100), PAD, CAMERA, outcome="landed", facts=[("scenario", "calm & <b>")])
    for i in range(401):
        t = i * 0.01
        d, yaw = truth_at(t)
        log.truth.append(TruthSample(ns(100 + t), d, np.zeros(3), yaw))
    for i in range(100):
        t = i * 0.04
        d, yaw = truth_at(t)
        at = ns(100 + t)
        stamp = Stamp(at, ns(100 + t + 0.05), 0.001, "sim")
        for method, sigma in (("ellipse", 0.05), ("corners", 0.005), ("selected", 0.005)):
            ellipse = method == "ellipse"
            if ellipse and i % 2:
                continue
            cov = np.diag([sigma**2] * 3 + [UNKNOWN_YAW_VAR if ellipse else 1e-4])
            outline = Feature("outline", "disc", np.array([[100.0, 50], [140, 50], [140, 90], [100, 90]]))
            seen = d + rng.normal(0, sigma, 3)
            log.sightings.append(Sighting(stamp, i, method, seen, None if ellipse else yaw, False, cov, 0.8, features=(outline,)))
        noisy = d + rng.normal(0, 0.02, 3) + [0, 0, 0.1]
        log.estimates.append(RelativeState(at, "dead_reckoning", noisy, np.zeros(3), yaw, 1e-4 * np.eye(7), at, True))
        command = Velocity(np.array([0.1, 0.0, 0.3]), 0.1) if i % 30 else Hover()
        log.commands.append(CommandRecord(at, Land() if i > 95 else command))
        jpeg = None
        if images:
            jpeg = cv2.imencode(".jpg", np.full((180, 320, 3), (90, 60, 30), np.uint8))[1].tobytes()
        log.frames.append(FrameRecord(at, i, Verdict.FUSED, Rotation.identity(), image=jpeg))
    log.verdicts = Counter({Verdict.FUSED: 100, Verdict.NO_PAD: 20, Verdict.REPLACED: 5})
    log.phases = [PhaseChange(ns(100), "approach"), PhaseChange(ns(102), "descend"), PhaseChange(ns(103.8), "land")]
    log.stage_s = {"decode": [0.001] * 100, "detect": [0.004 + 0.00001 * i for i in range(100)]}
    log.delay_s = [0.1, 0.2, 0.3]
    log.touchdown = LoggedTouchdown(ns(104), 0.0312, 0.27, 0.05, on_pad=True)
    return log


def test_truth_is_interpolated_across_the_wrap_and_not_beyond_its_record():
    truth = TruthTrack(flight().truth)
    got = truth.at([ns(100 + t) for t in (0.005, 0.705, 2.345)])
    for row, t in zip(got, (0.005, 0.705, 2.345), strict=True):
        d, yaw = truth_at(t)
        np.testing.assert_allclose(row[:3], d, atol=1e-4)
        assert abs(math.remainder(row[3] - yaw, math.tau)) < 1e-6
    assert np.all(np.isnan(truth.at([ns(99.9), ns(104.2)])))
    holed = TruthTrack([s for s in flight().truth if not 1.0 < (s.at - ns(100)) * 1e-9 < 2.0])
    assert np.all(np.isnan(holed.at([ns(101.5)])))
    assert np.all(np.isfinite(holed.at([ns(100.5), ns(102.5)])))
    assert np.all(np.isnan(TruthTrack([]).at([ns(1)])))


def test_error_statistics_are_those_put_in():
    rows = {r.name: r for r in error_rows(flight(), all_series(flight()))}
    assert rows["ellipse"].count == 50
    assert rows["ellipse"].fraction == pytest.approx(50 / 125)
    assert rows["ellipse"].lateral_median_m == pytest.approx(0.05 * math.sqrt(2 * math.log(2)), rel=0.3)
    assert math.isnan(rows["ellipse"].yaw_median_rad)
    assert rows["corners"].lateral_median_m < 0.01
    assert rows["corners"].yaw_p95_rad < 1e-3
    assert rows["dead_reckoning"].down_bias_m == pytest.approx(0.1, abs=0.01)
    assert rows["dead_reckoning"].fraction is None


def test_timings_keep_their_order_and_quantiles():
    rows = timing_rows(flight())
    assert [r.name for r in rows] == ["decode", "detect", "exposure to belief"]
    assert rows[1].median_s == pytest.approx(0.004495)
    assert rows[1].max_s == pytest.approx(0.00499)
    assert rows[2].median_s == pytest.approx(0.2)


def test_position_over_the_pad_is_turned_by_the_heading():
    """Nose to starboard of the arrow, pad straight ahead: the body stands to port of it."""
    p = body_over_pad(np.array([[2.0, 0.0, 3.0]]), np.array([math.pi / 2]))
    np.testing.assert_allclose(p, [[0.0, -2.0, 3.0]], atol=1e-12)


class _Addresses(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found, self.ids = [], []

    def handle_starttag(self, tag, attrs):
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "data", "poster"):
                self.found.append(value)
            if name == "id":
                self.ids.append(value)


def test_the_page_stands_alone_and_says_what_happened(tmp_path):
    page = write_report(flight(), tmp_path / "report")
    text = page.read_text("utf-8")
    assert sorted(p.name for p in page.parent.iterdir()) == ["flight.mp4", "index.html"]
    assert "http" not in text
    assert "@import" not in text
    parser = _Addresses()
    parser.feed(text)
    assert all(a == "flight.mp4" or a.startswith(("#", "data:")) for a in parser.found)
    assert len(parser.ids) == len(set(parser.ids))
    assert {a[1:] for a in parser.found if a.startswith("#")} <= set(parser.ids)
    assert set(re.findall(r"url\(#([^)]+)\)", text)) <= set(parser.ids)
    assert "A test &lt;flight&gt; &amp; more" in text
    assert "calm &amp; &lt;b&gt;" in text
    for said in ("31.2 mm", "0.27 m/s", "stands on the pad", "100  (80.0 %)", "exposure to belief", "corners", "descend"):
        assert said in text
    assert text.count("<svg") == 6
    for name in ("ellipse", "corners", "selected", "dead_reckoning", "truth"):
        assert f'class="series series-{name}"' in text
    assert "#010203" not in text


def test_many_dots_are_all_drawn():
    log = flight(images=False)
    log.sightings = [s for s in log.sightings if s.method == "corners"] * 5
    svg = render(log, None)
    path = re.search(r'class="series series-corners">\s*<path d="([^"]*)"', svg)
    assert path is not None
    assert path[1].count("M") == path[1].count("L") == 500


def test_an_empty_flight_still_has_a_page(tmp_path):
    page = write_report(FlightLog("nothing", ns(0), PAD, CAMERA), tmp_path)
    text = page.read_text("utf-8")
    for said in ("No touchdown", "No frames", "Neither truth", "Nothing was estimated", "No frames", "No commands", "No times"):
        assert said in text
    assert [p.name for p in tmp_path.iterdir()] == ["index.html"]


def test_a_flight_without_truth_shows_estimates_and_no_errors():
    log = flight(images=False)
    log.truth = []
    text = render(log, None)
    assert "No truth was recorded" in text
    assert text.count("<svg") == 5


def test_a_video_from_elsewhere_is_refused(tmp_path):
    stray = tmp_path / "stray.mp4"
    stray.write_bytes(b"x")
    for video in (stray, tmp_path / "report" / "missing.mp4"):
        with pytest.raises(BadInput, match="must be a file inside"):
            write_report(flight(), tmp_path / "report", video)


def test_the_video_is_what_browsers_play(tmp_path):
    path = tmp_path / "flight.mp4"
    assert video_from_log(flight(), path, scale=1.0) == 100
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert (stream.width, stream.height) == annotated_size(320, 180)
        frames = list(container.decode(stream))
    assert len(frames) == 100
    times = np.array([f.time for f in frames])
    np.testing.assert_allclose(times, 0.04 * np.arange(100), atol=1e-3)
    sea = frames[50].to_ndarray(format="bgr24")[20:40, 20:40].reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(sea, [90, 60, 30], atol=6)


def test_the_video_shows_the_pad_of_the_path_that_steered(tmp_path):
    """A shadow path that is metres off is in the log, before or after the one that steered."""
    log = flight()
    shadow = [
        RelativeState(
            e.at, "median_mean", e.d_body_pad_level + np.array([0, 9.0, 0]), e.v_pad_level, e.yaw_rad, e.cov, e.at, True
        )
        for e in log.estimates
    ]
    log.sightings = []

    def image(estimates, steering):
        log.estimates, log.steering = estimates, steering
        video_from_log(log, tmp_path / "v.mp4")
        with av.open(str(tmp_path / "v.mp4")) as container:
            return next(container.decode(video=0)).to_ndarray(format="bgr24").astype(int)

    steered, none = log.estimates, image([], None)
    mixed = [e for pair in zip(steered, shadow, strict=True) for e in pair]
    drawn = image(steered, None)
    assert np.abs(drawn[:180] - none[:180]).max() > 60
    np.testing.assert_array_equal(image(mixed, None), drawn)
    np.testing.assert_array_equal(image(list(reversed(mixed)), "dead_reckoning"), drawn)


def test_images_keep_their_times_and_a_late_one_is_left_out(tmp_path):
    path = tmp_path / "v.mp4"
    with FlightVideo(path, (64, 48), 30) as video:
        image = np.zeros((48, 64, 3), np.uint8)
        added = [video.add(image, ns(t)) for t in (5.0, 5.1, 5.05, 6.0)]
        with pytest.raises(ValueError, match="48, 64, 3"):
            video.add(np.zeros((64, 48, 3), np.uint8), ns(7))
    video.close()
    assert added == [True, True, False, True]
    with av.open(str(path)) as container:
        assert [f.time for f in container.decode(video=0)] == pytest.approx([0.0, 0.1, 1.0], abs=1e-3)


def test_no_image_no_file(tmp_path):
    with FlightVideo(tmp_path / "v.mp4", (64, 48), 30):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("size", "fps"), [((63, 48), 30), ((64, 0), 30), ((64, 48), 0)])
def test_sizes_and_rates_that_cannot_be(tmp_path, size, fps):
    with pytest.raises(BadInput):
        FlightVideo(tmp_path / "v.mp4", size, fps)
    with pytest.raises(BadInput, match="cannot write"):
        FlightVideo(tmp_path / "no" / "such" / "folder.mp4", (64, 48), 30)


def test_broken_images_are_passed_over(tmp_path):
    log = flight()
    log.frames = [
        FrameRecord(ns(100), 0, Verdict.FAILED, None, image=b"no frame"),
        FrameRecord(ns(100.1), 1, Verdict.FAILED, None, image=Path(tmp_path / "gone.jpg")),
    ]
    assert video_from_log(log, tmp_path / "v.mp4") == 0


def near_ink(canvas, uv, ink, reach=2):
    u, v = round(uv[0]), round(uv[1])
    patch = canvas[max(0, v - reach) : v + reach + 1, max(0, u - reach) : u + reach + 1].astype(int)
    return bool((np.abs(patch - np.array(ink)).max(axis=2) < 70).any())


@pytest.mark.parametrize("expected", [False, True])
@pytest.mark.parametrize("rpy", [(0.0, 0.0), (0.08, -0.12)])
def test_the_pad_is_drawn_where_the_estimate_has_it(rpy, expected):
    """Against cv2.projectPoints with the same pose composed by hand; where the frame has its own expectation, by that."""
    yaw, d = 0.7, np.array([0.2, -0.1, 2.0])
    R_level_body = Rotation.from_rpy(rpy[0], rpy[1], 0.0)
    believed = d + np.array([0.15, 0.1, 0.0]) if expected else d
    estimate = RelativeState(ns(1), "ekf", believed, np.zeros(3), yaw, np.eye(7), ns(1), True)
    image = np.full((180, 320, 3), 60, np.uint8)
    shown = Overlay(1.0, Verdict.FUSED, "descend", (), estimate, R_level_body, d if expected else None)
    canvas = annotate(image, shown, CAMERA, PAD)
    corners = np.array([[0.3, 0, 0], [0.14, 0.1, 0], [-0.14, -0.1, 0], [0.39, 0, 0], [0, -0.39, 0]])
    p_body = (Rotation.from_rpy(0, 0, -yaw) @ corners + d) @ R_level_body.matrix
    p_cam = (p_body - CAMERA.T_body_cam.t) @ CAMERA.T_body_cam.R.matrix
    uv = cv2.projectPoints(p_cam, np.zeros(3), np.zeros(3), CAMERA.K, CAMERA.distortion)[0][:, 0]
    assert all(near_ink(canvas, p, bgr(OUTLINE)) for p in uv)
    assert not near_ink(canvas, (5, 5), bgr(OUTLINE))


def test_features_are_drawn_in_their_methods_colour_and_far_points_do_no_harm():
    wild = Feature("line", "edge", np.array([[math.nan, 1.0], [1e9, -1e9], [50.0, 40.0], [90.0, 40.0]]))
    point = Feature("point", "tip", np.array([[200.0, 100.0]]))
    stamp = Stamp(ns(1), ns(1), 0.001, "sim")
    sighting = Sighting(stamp, 0, "arrow", np.array([0, 0, 2.0]), 0.0, False, np.eye(4), 0.5, features=(wild, point))
    canvas = annotate(np.full((180, 320, 3), 60, np.uint8), Overlay(0.0, None, "", (sighting,)), CAMERA, PAD)
    assert near_ink(canvas, (70, 40), bgr(colour("arrow")))
    assert near_ink(canvas, (200, 100), bgr(colour("arrow")))


def test_an_estimate_behind_or_beside_the_lens_draws_nothing():
    for d in ([0, 0, -1.0], [0, 0, 0.0], [500.0, 0, 0.1]):
        estimate = RelativeState(ns(1), "ekf", np.array(d), np.zeros(3), 0.0, np.eye(7), ns(1), True)
        canvas = annotate(np.full((180, 320, 3), 60, np.uint8), Overlay(0.0, None, "", (), estimate), CAMERA, PAD)
        assert (canvas[:180] == 60).mean() > 0.9
