"""The report of a flight, the scene and drawings in it, and the command that writes it of one recording or two."""

import base64
import io
import json
import math
import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from msgspec import structs
from msgspec.structs import replace

from companion.base.mission import Event, Reason, ReasonCause, State, StateChange
from companion.cli import main as cli
from companion.recording.foxglove import SIGMAS, error_ellipsoid, filled
from companion.recording.palette import OUTLINE, bgr, colour
from companion.recording.reading import open_recording
from companion.settings.load import shipped
from companion.tools.replay.recorded_log import log_of
from companion.tools.report.figures import TruthTrack, all_series, deck_rows, error_rows
from companion.tools.report.flight_log import (
    CommandRecord,
    DeckSample,
    FlightLog,
    FrameRecord,
    LoggedContact,
    PhaseChange,
    StageTime,
    TruthSample,
)
from companion.tools.report.overlay import Overlay, annotate, annotated_size
from companion.tools.report.page import landing_began, render, write_report
from companion.tools.report.plots import SPANS, ship, thinned
from companion.tools.report.video import FILM_BYTES, film_of
from estimator.contracts.commands import Hover, Land, Velocity
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Feature, RelativeState, Sighting, Verdict
from estimator.contracts.geometry import Rotation, Transform
from estimator.contracts.time import MonoNs, Stamp, seconds_between
from estimator.vision.camera.camera import Camera
from estimator.vision.detection import Detection, PadCheck, PadThing
from estimator.vision.pad.geometry import outlines_of
from estimator.vision.pad.shapes import PaintedDisc, PaintedRing
from tests.fly import record_to, recorded
from tests.make import ns
from tests.support.kept import KeptFlights
from tests.support.shipped import shipped_pad

CAMERA = Camera(
    320, 180, 187.3, 187.3, 159.5, 89.5, np.zeros(5), Transform(Rotation.from_rpy(0, 0, math.pi / 2), np.array([0.15, 0, 0]))
)
PAD = shipped_pad("thesis")


def truth_at(t):
    """Return a descent from 3 m along a curve, turning through the limit of the heading's range."""
    return np.array([0.6 * math.cos(t), 0.5 - 0.1 * t, 3.0 - 0.6 * t]), math.remainder(3.0 + 0.2 * t, math.tau)


def report_flight(images=True) -> FlightLog:
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
    instants = [ns(100 + 0.04 * i) for i in range(100)]
    log.stages = {
        "decode": [StageTime(at, 0.001) for at in instants],
        "detect": [StageTime(at, 0.004 + 0.00001 * i) for i, at in enumerate(instants)],
    }
    log.delays = [StageTime(at, s) for at, s in zip(instants, (0.1, 0.2, 0.3), strict=False)]
    log.contacts = [
        LoggedContact(ns(101.5), 0.51, 0.9, 0.3, on_pad=False, surface="deck", p_pad_m=(0.5, 0.1), yaw_rad=0.3, phase="commit"),
        LoggedContact(ns(104), 0.0312, 0.27, 0.05, on_pad=True, surface="pad", p_pad_m=(0.03, -0.01), yaw_rad=-0.2),
    ]
    for t, x_m in ((101.0, 0.02), (101.5, 0.05)):
        detection = Detection(None, None, {}, on_pad=PadCheck(ns(t), 1.0, PadThing(0.25, x_m, 0.2)))
        log.add_detection(detection, ns(t))
    left = StateChange(ns(102), State.INTERCEPT, Event.IN_CONE, State.DESCEND, Reason(ReasonCause.LOW_ENOUGH, 0.38))
    log.transitions = [left]
    log.settings = 'title = "<settings>"'
    return log


def test_truth_is_interpolated_across_the_wrap_and_not_beyond_its_record():
    truth = TruthTrack(report_flight().truth)
    got = truth.at([ns(100 + t) for t in (0.005, 0.705, 2.345)])
    for row, t in zip(got, (0.005, 0.705, 2.345), strict=True):
        d, yaw = truth_at(t)
        np.testing.assert_allclose(row[:3], d, atol=1e-4)
        assert abs(math.remainder(row[3] - yaw, math.tau)) < 1e-6
    assert np.all(np.isnan(truth.at([ns(99.9), ns(104.2)])))
    holed = TruthTrack([s for s in report_flight().truth if not 1.0 < (s.at - ns(100)) * 1e-9 < 2.0])
    assert np.all(np.isnan(holed.at([ns(101.5)])))
    assert np.all(np.isfinite(holed.at([ns(100.5), ns(102.5)])))
    assert np.all(np.isnan(TruthTrack([]).at([ns(1)])))


def test_error_statistics_are_those_put_in():
    rows = {r.name: r for r in error_rows(report_flight(), all_series(report_flight()))}
    assert rows["ellipse"].count == 50
    assert rows["ellipse"].fraction == pytest.approx(50 / 125)
    assert rows["ellipse"].lateral_median_m == pytest.approx(0.05 * math.sqrt(2 * math.log(2)), rel=0.3)
    assert math.isnan(rows["ellipse"].yaw_median_rad)
    assert rows["corners"].lateral_median_m < 0.01
    assert rows["corners"].yaw_p95_rad < 1e-3
    assert rows["dead_reckoning"].down_median_m == pytest.approx(0.1, abs=0.01)
    assert rows["dead_reckoning"].fraction is None
    assert rows["dead_reckoning"].nees == pytest.approx((3 * 0.02**2 + 0.1**2) / 1e-4 / 7, rel=0.2)
    assert math.isnan(rows["corners"].nees)


def test_the_decks_tilt_is_compared_with_truth_at_the_instant_that_it_is_forecast_for():
    log = report_flight()
    assert deck_rows(log) == []
    log.truth = [replace(s, R_ned_pad=Rotation.from_rpy(0.01 * k * 1e-2, 0.0, 0.5)) for k, s in enumerate(log.truth)]
    for made_s in (0.0, 0.5, 1.0):
        for ahead_s in (0.0, 1.0, 2.0):
            t = made_s + ahead_s
            wrong = 0.03 if ahead_s else 0.0
            log.decks.append(DeckSample(ns(100 + t), ns(100 + made_s), 0.0, 0.1, 0.01 * t + wrong, 0.03, 0.04 * ahead_s, 0.02))
    log.decks.append(DeckSample(ns(110), ns(109), 0.0, 0.1, 1.0, 0.03, 1.0, 0.02))
    rows = deck_rows(log)
    assert [(row.ahead_s, row.count) for row in rows] == [(0.0, 3), (1.0, 3), (2.0, 3)], "beyond the truth nothing is compared"
    assert [row.tilt_median_rad for row in rows] == pytest.approx([0.0, 0.05, math.hypot(0.03, 0.08)], abs=1e-6)
    assert [row.nees for row in rows] == pytest.approx([0.0, (1 + 4) / 2, (1 + 16) / 2], abs=1e-3)


class _Parts(HTMLParser):
    """References of a page, its ids, and the text of its elements by id."""

    def __init__(self):
        super().__init__()
        self.addresses, self.ids, self.texts, self.inside = [], [], {}, None

    def handle_starttag(self, tag, attrs):
        self.inside = None
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "data", "poster"):
                self.addresses.append(value)
            if name == "id":
                self.ids.append(value)
                self.inside = value

    def handle_data(self, data):
        if self.inside is not None:
            self.texts[self.inside] = self.texts.get(self.inside, "") + data

    def handle_endtag(self, tag):
        self.inside = None


def parts_of(text):
    parser = _Parts()
    parser.feed(text)
    return parser


def column(data, number):
    return np.frombuffer(base64.b64decode(data["columns"][number]), "<f4")


def test_the_page_is_one_file_and_says_what_happened(tmp_path):
    page, watched = tmp_path / "report/index.html", list[tuple[int, int, str]]()
    write_report(report_flight(), page.parent, lambda done, of: watched.append((done, of, page.read_text("utf-8"))))
    assert [watched[k][:2] for k in (0, -1)] == [(0, 100), (100, 100)]
    assert {(parts_of(text).texts.get("film-0"), "data:image/jpeg" in text) for *_, text in watched} == {(None, True)}
    text = page.read_text("utf-8")
    assert [p.name for p in page.parent.iterdir()] == ["index.html"]
    assert "http://" not in text
    assert "https://" not in text
    assert "@import" not in text
    parts = parts_of(text)
    assert parts.addresses == [], "everything is in the page"
    assert len(parts.ids) == len(set(parts.ids))
    film = base64.b64decode(parts.texts["film-0"])
    assert film[4:8] == b"ftyp"
    assert "A test &lt;flight&gt; &amp; more" in text
    assert "calm &amp; &lt;b&gt;" in text
    assert "&lt;settings&gt;" in text
    for output in ("3.1 cm", "0.27 m/s", "stands on the pad", "80.0 %", "exposure to belief", "corners", "descend"):
        assert output in text
    assert "0.38 m over the deck" in text, "the cause of a transition"
    assert "something 25 cm wide lies on the pad, 0.21 m from its centre" in text
    assert "contact with the deck" in text
    assert text.count("<canvas") == text.count('role="img"') == len(re.findall(r'<canvas[^>]*aria-label="[^"]{20,}"', text))


def test_the_page_draws_what_was_put_in():
    data = json.loads(parts_of(render(report_flight(), None)).texts["data"])
    forward = next(p for p in data["plots"] if p["title"] == "forward")
    assert {layer["name"] for layer in forward["layers"] if layer["style"] == "band"} == {"dead_reckoning"}, "what steered"
    truth = next(layer for layer in forward["layers"] if layer["name"] == "truth")
    t = column(data, truth["t"])
    np.testing.assert_allclose(t, np.arange(401) * 0.01, atol=1e-6)
    np.testing.assert_allclose(column(data, truth["y"]), 0.6 * np.cos(np.arange(401) * 0.01), atol=1e-6)
    band = next(layer for layer in forward["layers"] if layer["style"] == "band")
    np.testing.assert_allclose(column(data, band["upper"]) - column(data, band["y"]), 4 * 0.01, atol=1e-6)
    near = data["views"][0]
    assert [m["label"] for m in near["marks"]] == ["", "1", "2"]
    crate = near["marks"][0]
    assert (crate["x"], crate["y"], crate["size"]) == (0.2, 0.05, 0.25), "to starboard, along the arrow"
    assert (near["marks"][2]["x"], near["marks"][2]["y"], near["marks"][2]["size"]) == (-0.01, 0.03, None)
    assert len(near["regions"]) == len(PAD.regions)
    assert near["regions"][0]["fill"] == "rgb({},{},{})".format(*PAD.rgb(PAD.regions[0]))
    assert np.abs(near["regions"][0]["points"]).max() == pytest.approx(PAD.disc_radius_m, abs=1e-3)


def test_text_cannot_end_the_data_early():
    log = report_flight(images=False)
    log.phases = [PhaseChange(ns(100), "</script><img src=x>")]
    text = render(log, None)
    assert "</script><img" not in text
    assert json.loads(parts_of(text).texts["data"].replace("<\\/", "</"))["flights"][0]["phases"][0][1] == "</script><img src=x>"


@given(st.integers(1, 4 * SPANS), st.lists(st.tuples(st.floats(0, 1), st.sampled_from([1e6, -1e6, math.nan])), max_size=20))
def test_thinning_keeps_every_extreme_and_every_gap(n, odd):
    t, y = 0.02 * np.arange(n), np.sin(0.001 * np.arange(n))
    for k, (where, value) in enumerate(odd):
        y[min(n - 1, int(where * n))] = value + k
    kept = thinned(t, y)
    assert len(kept) <= max(n if n <= 2 * SPANS else 0, 3 * SPANS + 2)
    assert np.all(np.diff(kept) > 0)
    assert (kept[0], kept[-1]) == (0, n - 1)
    known = y[np.isfinite(y)]
    if len(known):
        seen = y[kept][np.isfinite(y[kept])]
        assert (seen.min(), seen.max()) == (known.min(), known.max())
    assert np.isnan(y[kept]).any() == np.isnan(y).any()


def test_a_forecast_stands_where_it_was_made_for():
    log = report_flight(images=False)
    log.decks = [
        DeckSample(ns(101), ns(101), 0.1, 0.01, 0.02, 0.001, 0.03, 0.001),
        DeckSample(ns(102), ns(101), 0.2, 0.05, 0.04, 0.002, 0.05, 0.002),
    ]
    heave = next(plot for plot in ship(log).plots if plot.title == "heave")
    found = {layer.name: (layer.t_s[0], layer.y[0]) for layer in heave.layers if layer.style == "line"}
    assert found == {"filter": (1.0, 0.1), "forecast 1 s ago": (2.0, 0.2)}


def test_an_empty_flight_still_has_a_page(tmp_path):
    page = write_report(FlightLog("nothing", ns(0), PAD, CAMERA), tmp_path)
    text = page.read_text("utf-8")
    absent = ("No touchdown", "No frames", "Neither truth", "Nothing was estimated", "No commands", "No times", "No results")
    assert [words for words in absent if words not in text] == []
    assert [p.name for p in tmp_path.iterdir()] == ["index.html"]
    without_truth = report_flight(images=False)
    without_truth.truth = []
    text = render(without_truth, None)
    assert "No truth was recorded" in text
    assert "minus truth" not in text


def test_the_video_is_what_browsers_play(tmp_path):
    film = film_of(report_flight())
    assert (film.frames, film.began) == (100, ns(100))
    path, data = tmp_path / "flight.mp4", film.data
    path.write_bytes(data)
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
    log = report_flight()
    aside = np.array([0.0, 9.0, 0.0])
    shadow = [structs.replace(e, path="median_mean", d_body_pad_level=e.d_body_pad_level + aside) for e in log.estimates]
    log.sightings = []

    def image(estimates, steering):
        log.estimates, log.steering = estimates, steering
        film = film_of(log)
        with av.open(io.BytesIO(film.data)) as container:
            return next(container.decode(video=0)).to_ndarray(format="bgr24").astype(int)

    steered, none = log.estimates, image([], None)
    mixed = [e for pair in zip(steered, shadow, strict=True) for e in pair]
    drawn = image(steered, None)
    assert np.abs(drawn[:180] - none[:180]).max() > 60
    # The encoder's threads share a limited bit rate, so that two films of the same frames differ by some levels.
    for estimates, steering in ((mixed, None), (list(reversed(mixed)), "dead_reckoning")):
        assert np.abs(image(estimates, steering) - drawn).max() < 30


def test_a_long_film_stays_small_enough_to_be_mailed(monkeypatch):
    """Noise is the hardest picture there is: it takes all the bits that it may have."""
    rng, log = np.random.default_rng(1), report_flight(images=False)
    for k, frame in enumerate(log.frames):
        noise = cv2.imencode(".png", rng.integers(0, 255, (180, 320, 3), dtype=np.uint8))[1].tobytes()
        log.frames[k] = replace(frame, image=noise)
    free = film_of(log)
    monkeypatch.setattr("companion.tools.report.video.FILM_BYTES", 400_000)
    film = film_of(log)
    assert len(film.data) < 1.5 * 400_000 < 0.7 * len(free.data)
    assert 4 / 3 * FILM_BYTES < 8.5e6


def test_broken_images_are_passed_over(tmp_path):
    log = report_flight()
    log.frames = [
        FrameRecord(ns(100), 0, Verdict.FAILED, None, image=b"no frame"),
        FrameRecord(ns(100.1), 1, Verdict.FAILED, None, image=Path(tmp_path / "gone.jpg")),
    ]
    assert film_of(log) is None


def near_ink(canvas, uv, ink, reach=2):
    u, v = round(uv[0]), round(uv[1])
    patch = canvas[max(0, v - reach) : v + reach + 1, max(0, u - reach) : u + reach + 1].astype(int)
    return bool((np.abs(patch - np.array(ink)).max(axis=2) < 70).any())


@pytest.mark.parametrize("expected", [False, True])
@pytest.mark.parametrize("rpy", [(0.0, 0.0), (0.08, -0.12)])
def test_the_pad_is_drawn_where_the_estimate_has_it(rpy, expected):
    """The place equals cv2.projectPoints of the same pose composed by hand, or the frame's own expectation if it has one."""
    yaw, d = 0.7, np.array([0.2, -0.1, 2.0])
    R_level_body = Rotation.from_rpy(rpy[0], rpy[1], 0.0)
    believed = d + np.array([0.15, 0.1, 0.0]) if expected else d
    estimate = RelativeState(ns(1), "ekf", believed, np.zeros(3), yaw, np.eye(7), ns(1), True)
    image = np.full((180, 320, 3), 60, np.uint8)
    shown = Overlay((), estimate, R_level_body, d if expected else None)
    canvas = annotate(image, shown, CAMERA, PAD)
    corners = np.array([[0.3, 0, 0], [0.14, 0.1, 0], [-0.14, -0.1, 0], [0.39, 0, 0], [0, -0.39, 0]])
    p_body = (Rotation.from_rpy(0, 0, -yaw) @ corners + d) @ R_level_body.matrix
    p_cam = (p_body - CAMERA.T_body_cam.t) @ CAMERA.T_body_cam.R.matrix
    uv = cv2.projectPoints(p_cam, np.zeros(3), np.zeros(3), CAMERA.K, CAMERA.distortion)[0][:, 0]
    assert all(near_ink(canvas, p, bgr(OUTLINE)) for p in uv)
    assert not near_ink(canvas, (5, 5), bgr(OUTLINE))


def test_features_are_drawn_in_their_methods_colour_and_far_points_do_no_harm():
    wild = Feature("line", "edge", np.array([[math.nan, 1.0], [1e9, -1e9], [50.0, 40.0], [90.0, 40.0]]))
    stamp = Stamp(ns(1), ns(1), 0.001, "sim")
    sighting = Sighting(stamp, 0, "arrow", np.array([0, 0, 2.0]), 0.0, False, np.eye(4), 0.5, features=(wild,))
    canvas = annotate(np.full((180, 320, 3), 60, np.uint8), Overlay((sighting,)), CAMERA, PAD)
    assert near_ink(canvas, (70, 40), bgr(colour("arrow")))


def test_an_estimate_behind_or_beside_the_lens_draws_nothing():
    for d in ([0, 0, -1.0], [0, 0, 0.0], [500.0, 0, 0.1]):
        estimate = RelativeState(ns(1), "ekf", np.array(d), np.zeros(3), 0.0, np.eye(7), ns(1), True)
        canvas = annotate(np.full((180, 320, 3), 60, np.uint8), Overlay((), estimate), CAMERA, PAD)
        assert (canvas[:180] == 60).mean() > 0.9


@pytest.mark.parametrize("name", shipped("pads"))
def test_triangles_fill_each_region_once(name: str) -> None:
    for region in shipped_pad(name).regions:
        points, faces = filled(region)
        a, b, c = (points[[face[k] for face in faces]] for k in range(3))
        areas = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        match region:
            case PaintedDisc():
                want = math.pi * region.radius_m**2
            case PaintedRing():
                want = math.pi * (region.outer_m**2 - region.inner_m**2)
            case _:
                want = sum(cv2.contourArea(line.astype(np.float32)) for line in outlines_of(region))
        assert areas.sum() == pytest.approx(want, rel=0.01)
        assert areas.min() > 0.0


def test_the_ellipsoid_has_the_estimates_covariance() -> None:
    R = Rotation.from_rpy(0.3, -0.2, 0.7)
    cov = np.eye(7)
    cov[:3, :3] = R.matrix @ np.diag([0.01, 0.04, 0.0025]) @ R.matrix.T
    state = RelativeState(MonoNs(1), "ekf", np.zeros(3), np.zeros(3), 0.0, cov, MonoNs(1), True)
    (sphere,) = error_ellipsoid(1, state).entities[0].spheres
    q = sphere.pose.orientation
    axes = Rotation.from_quat([q.w, q.x, q.y, q.z]).matrix
    half = np.array([sphere.size.x, sphere.size.y, sphere.size.z]) / 2.0 / SIGMAS
    np.testing.assert_allclose(axes @ np.diag(half**2) @ axes.T, cov[:3, :3], atol=1e-9)


def test_what_never_changes_is_found_within_a_second_of_any_seek(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    record_to(path, seconds=3.2)
    with path.open("rb") as stream:
        times: dict[str, list[int]] = {}
        for _, channel, message in make_reader(stream).iter_messages(topics=["/tf_static", "/scene", "/camera/calibration"]):
            times.setdefault(channel.topic, []).append(message.log_time)
    assert set(times) == {"/tf_static", "/scene", "/camera/calibration"}
    for found in times.values():
        assert len(found) >= 4
        assert max(np.diff(found)) <= 1.1e9


@pytest.fixture(scope="module")
def flights(kept: KeptFlights) -> list[Path]:
    """Two whole landings, the second with another limit."""
    words = ["demo", "--perception", "truth", "--seed"]
    other = [*words, "2", "--set", "guidance.cone.gate_height_m=0.4"]
    return [kept("demo 1", recorded(*words, "1")), kept("demo 2 from another gate", recorded(*other))]


def test_the_log_of_a_recording_is_that_of_the_flight(flights: list[Path]) -> None:
    log = log_of(open_recording([flights[0]]), "one")
    assert log.outcome == "landed"
    assert (log.steering, log.settings.startswith("[")) == ("ekf", True)
    (contact,) = log.contacts
    assert contact.on_pad
    assert np.hypot(*contact.p_pad_m) == pytest.approx(contact.lateral_m, abs=0.02)
    assert contact.lateral_m == log.touchdown.lateral_m
    assert {round(seconds_between(one.made_at, one.at), 3) for one in log.decks} == {0.0, 1.0, 2.0}
    assert all(one.p_pad_ned is not None and one.R_ned_pad is not None for one in log.truth)
    assert seconds_between(log.truth[0].at, log.truth[-1].at) > 5.0
    assert sum(log.verdicts.values()) == len(log.frames)
    assert [change.target.name for change in log.transitions][-1] in ("DOWN", "LANDED")


def test_the_command_writes_one_file_and_says_its_size(flights, tmp_path, capsys):
    capsys.readouterr()
    page = tmp_path / "one.html"
    assert cli.main(["report", str(flights[0]), "--output", str(page)]) == 0
    assert re.fullmatch(rf"report: {page} \(\d+\.\d MB, one file; open it in a browser\)\n", capsys.readouterr().out)
    data = json.loads(parts_of(page.read_text()).texts["data"])
    heave = next(plot for plot in data["plots"] if plot["title"] == "heave")
    assert {layer["name"] for layer in heave["layers"]} == {"truth", "filter", "forecast 1 s ago", "forecast 2 s ago"}


def test_two_flights_are_laid_over_each_other_from_where_their_landings_began(flights: list[Path], tmp_path: Path) -> None:
    page = tmp_path / "both.html"
    assert cli.main(["report", *map(str, flights), "--output", str(page)]) == 0
    text = page.read_text()
    data = json.loads(parts_of(text).texts["data"])
    down = next(plot for plot in data["plots"] if plot["title"] == "down")
    lines = {layer["name"]: layer for layer in down["layers"] if layer["style"] == "line"}
    assert set(lines) == {"A", "B"}
    for path, name in zip(flights, "AB", strict=True):
        log = log_of(open_recording([path]), name)
        began = landing_began(log)
        assert began > log.started
        states = [e for e in log.estimates if e.path == "ekf"]
        t = column(data, lines[name]["t"])
        assert t[0] == pytest.approx(seconds_between(began, states[0].at), abs=1e-3)
        assert column(data, lines[name]["y"])[-1] == pytest.approx(states[-1].height_m, abs=1e-5)
        assert any(abs(when) < 1e-3 for when, _ in data["flights"]["AB".index(name)]["phases"]), "a phase begins at zero"
    assert {mark["label"] for mark in data["views"][0]["marks"]} == {"A1", "B1"}
    assert "A landed, B landed" in text
    (row,) = re.findall(
        r"<tr><td>off centre at touchdown</td><td>([\d.]+) cm</td><td>([\d.]+) cm</td><td>([-+][\d.]+) cm</td>", text
    )
    assert float(row[1]) - float(row[0]) == pytest.approx(float(row[2]), abs=0.011)
    assert "<td>guidance.cone.gate_height_m</td>" in text, "the settings that differ"
    assert text.count("<td>guidance.") == 1


def test_a_part_of_a_flight_and_strange_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "short.mcap"
    record_to(path, seconds=0.8)
    page = tmp_path / "short.html"
    drawn = tmp_path / "short.gif"
    assert cli.main(["report", str(path), "--animation", str(drawn)]) == 0
    with av.open(str(drawn)) as animation:
        first, *_, last = (frame.to_ndarray(format="bgr24").astype(int) for frame in animation.decode(video=0))
    assert first.shape == last.shape
    assert abs(first - last).max() > 50, "the drone moved between the first image and the last"
    assert cli.main(["report", str(path), "--animation", str(tmp_path / "no" / "folder.gif")]) == 2
    assert "no/folder.gif" in capsys.readouterr().err
    assert cli.main(["report", str(path), "--output", str(page), "--no-video"]) == 0
    assert "unfinished" in page.read_text()
    assert "film-0" not in parts_of(page.read_text()).ids
    assert cli.main(["report", str(path), str(tmp_path / "none.mcap"), "--output", str(page)]) == 2
    assert "none.mcap" in capsys.readouterr().err
    assert cli.main(["report", str(path), "--output", str(tmp_path / "no" / "folder.html")]) == 2
    golden = open_recording([Path(__file__).parents[1] / "golden" / "frames.mcap"])
    golden.attachments.pop("pad.toml")
    with pytest.raises(BadInput, match="does not hold its camera and its pad"):
        log_of(golden, "golden")


def test_what_each_method_found_in_a_frame_is_drawn_from_the_recording(recorded_flight) -> None:
    log = log_of(open_recording([recorded_flight[0]]), "features")
    kept = {(one.seq, one.method): one.features for one in log.sightings}
    flown = [one for frame in recorded_flight[1].frames if frame.detection for one in frame.detection.methods.values() if one]
    pairs = [pair for seen in flown for pair in zip(kept[seen.seq, seen.method], seen.features, strict=True)]
    assert len(pairs) > 20
    for ours, theirs in pairs:
        assert (ours.kind, ours.label) == (theirs.kind, theirs.label)
        np.testing.assert_allclose(ours.uv_px, theirs.uv_px[np.isfinite(theirs.uv_px).all(axis=1)], atol=0.051)
