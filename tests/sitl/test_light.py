"""Light, lamps, weather, sensor and noise: each does to the frame what its setting promises; and a rolling shutter's frames."""

import dataclasses
import math

import numpy as np
import pytest
from msgspec.structs import replace

from companion.guidance.pilot import make_pilot
from companion.settings.load import load
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import BodyMotion
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.camera.rolling import CameraMotion, at_one_instant
from estimator.vision.register.registration import register
from estimator.vision.srgb import linear_light
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from sitl.camera.camera import Drop, Drops, Exposure, Renderer, wet_lens
from sitl.camera.light import FULL_SCALE, Development, Light, Sensor, counts, planck_rgb
from sitl.camera.settings import DropSettings, LampSettings
from sitl.camera.surroundings import Deck, Surroundings
from tests import make
from tests.sitl.images import BENT, PLAIN, WHITE, pad, pad_pose, project, shot
from tests.support.plain_light import FLAT, IDEAL

OVER = shot(2.0)
STEP = 1.0 / FULL_SCALE
"""Light is kept in steps of this."""
BIG = Surroundings(Deck(30.0, 30.0, (0.0, 0.0)))


def light_of(light: Light, lamps: LampSettings | None = None, *, s: Exposure = OVER, black: bool = False) -> F64:
    """(H, W, 3) blue, green, red light of a pad painted in one colour, on a deck that fills the frame."""
    painted = pad("thesis", **({"disc": (0, 0, 0)} if black else {"disc": WHITE, "ring": WHITE, "h": WHITE}))
    return Renderer(PLAIN, painted, BIG, light, IDEAL, lamps).radiance(s).astype(float)


def px_of(p_pad_m: list[tuple[float, float]], s: Exposure = OVER) -> F64:
    return project(PLAIN, s, np.array([(*at, 0.0) for at in p_pad_m]))


def at(image: F64, p_pad_m: tuple[float, float] = (0.0, 0.0)) -> F64:
    """(3,) red, green, blue light at a place on the pad."""
    u, v = np.round(px_of([p_pad_m])[0]).astype(int)
    return np.asarray(image[v, u, ::-1])


def middle(where: F64) -> F64:
    return np.array([axis.mean() for axis in np.nonzero(where)[::-1]])


@pytest.mark.parametrize(
    ("light", "expected", "tolerance"),
    [
        ({}, (0.8, 0.8, 0.8), STEP),
        ({"exposure_ev": -2.0}, (0.2, 0.2, 0.2), STEP),
        ({"exposure_ev": 2.0}, (3.2, 3.2, 3.2), STEP),
        ({"white_balance": (1.2, 1.0, 0.8)}, (0.96, 0.8, 0.64), STEP),
        ({"colour_temperature_k": 3000.0, "balanced_for_k": 3000.0}, (0.8, 0.8, 0.8), STEP),
        ({"daylight_ev": -6.0, "exposure_ev": 5.0}, (0.4, 0.4, 0.4), 2e-3),
        # Haze takes contrast with the distance and adds its own light.
        ({"visibility_m": 20.0}, (0.55 + 0.25 * 0.02**0.1,) * 3, 0.01),
    ],
)
def test_white_paint_has_the_light_that_the_settings_say(light: dict[str, float], expected: F64, tolerance: float) -> None:
    assert at(light_of(replace(FLAT, **light))) == pytest.approx(list(expected), abs=tolerance)


def test_low_colour_temperatures_are_red_and_high_ones_blue() -> None:
    # CIE illuminant A is 2856 K: linear sRGB (1, 0.449, 0.117) of chromaticity (0.4476, 0.4074); D65 is near 6500 K.
    assert planck_rgb(2856.0) == pytest.approx([1.0, 0.449, 0.117], abs=0.02)
    assert planck_rgb(6500.0) == pytest.approx([1.0, 0.98, 0.98], abs=0.04)
    warm, cold = (at(light_of(replace(FLAT, colour_temperature_k=k))) / 0.8 for k in (3000.0, 9000.0))
    assert warm[0] > 1.3 > 0.6 > warm[2]
    assert cold[0] < 0.9 < 1.1 < cold[2]


def test_vignetting_takes_its_share_in_the_corners_and_nothing_in_the_middle() -> None:
    ratio = light_of(replace(FLAT, vignetting=0.3)) / light_of(FLAT)
    assert ratio[0, 0] == pytest.approx([0.7] * 3, abs=1e-3)
    assert ratio[180, 320] == pytest.approx([1.0] * 3, abs=1e-3)


def test_glare_covers_a_third_of_the_disc() -> None:
    added = (light_of(replace(FLAT, glare=2.0)) - light_of(FLAT))[..., 1]
    disc = math.pi * np.sum((project(PLAIN, OVER, pad("thesis").circle(0.390, 4))[0] - px_of([(0.0, 0.0)])[0]) ** 2)
    assert (added > 0.8).sum() / disc == pytest.approx(1 / 3, abs=0.05)
    assert added.max() == pytest.approx(1.6, rel=0.01)
    assert np.linalg.norm(middle(added > 0.8) - px_of([(0.12, 0.08)])[0]) < 1.0


def test_shadows_of_drone_and_mast_fall_away_from_the_sun() -> None:
    high = replace(FLAT, drone_shadow=0.5, sun_elevation_deg=75.0, sun_azimuth_deg=57.3)
    dark = 1.0 - (light_of(high) / light_of(replace(high, drone_shadow=0.0)))[..., 1]
    assert dark.max() == pytest.approx(0.5, abs=0.02)
    assert np.all(dark > -1e-3)
    # Along the sun's rays from the body to the pad's plane, by hand.
    n, sun = OVER.R_ned_pad.matrix[:, 2], high.to_sun_ned
    s = n @ (OVER.p_body_ned - OVER.p_pad_ned) / (n @ sun)
    where = OVER.R_ned_pad.matrix.T @ (OVER.p_body_ned - s * sun - OVER.p_pad_ned)
    assert np.linalg.norm(middle(dark > 0.25) - px_of([tuple(where[:2])])[0]) < 4.0
    # The pad's arrow points to 0.7 rad: the sun stands to its right, and the shadow of a mast at (0, 1) crosses the pad.
    low = replace(FLAT, sun_elevation_deg=45.0, sun_azimuth_deg=math.degrees(0.7) + 90.0)
    dark = 1.0 - light_of(replace(low, mast_height_m=3.0, mast_forward_m=0.0, mast_right_m=1.0)) / light_of(low)
    assert at(dark, (0.0, -0.1)) == pytest.approx([0.6] * 3, abs=0.02)
    assert abs(at(dark, (0.5, -0.1))).max() < 0.01


def test_wet_paint_is_darker_has_puddles_that_mirror_the_sky_and_the_sun_where_it_does() -> None:
    near = light_of(replace(FLAT, wetness=0.8), s=shot(1.0), black=True)[120:240, 260:380, 1]
    assert near.min() < 0.01 < 0.03 < near.max()
    assert at(light_of(replace(FLAT, wetness=1.0)))[1] < 0.72
    light = replace(FLAT, sun_elevation_deg=75.0, sun_azimuth_deg=math.degrees(0.7))
    wet = replace(light, wetness=0.5)
    spot = (light_of(replace(wet, glint=2.0)) - light_of(wet))[..., 1]
    to_sun = OVER.R_ned_pad.matrix.T @ light.to_sun_ned
    p_cam = OVER.R_ned_pad.matrix.T @ (OVER.p_body_ned + OVER.R_ned_body @ PLAIN.T_body_cam.t - OVER.p_pad_ned)
    # The ray that comes from the sun and is mirrored in z = 0 reaches the camera from this point.
    mirrored = p_cam + np.array([to_sun[0], to_sun[1], -to_sun[2]]) * (-p_cam[2] / -to_sun[2])
    assert np.linalg.norm(middle(spot > 0.3) - px_of([tuple(mirrored[:2])])[0]) < 12.0
    assert np.array_equal(light_of(replace(light, glint=2.0)), light_of(light)), "a dry deck does not mirror"


def test_wear_has_its_deviation_and_keeps_the_mean() -> None:
    image = light_of(replace(FLAT, wear=0.1), s=shot(0.3))[..., 1] / 0.8
    assert image.mean() == pytest.approx(1.0, abs=0.08)
    assert 0.04 < image.std() < 0.12


def test_floodlights_add_to_the_sky_s_light_and_small_lamps_shine_where_they_stand() -> None:
    dark = replace(FLAT, daylight_ev=-6.0, exposure_ev=5.0)
    red, green, blue = at(light_of(dark, LampSettings(floods=3, flood_level=2.0**-6)))
    assert green == pytest.approx(0.8, abs=0.01)
    assert red > 1.1 * green > 1.2 * blue, "the light of halogen lamps"
    lamps = LampSettings(pad_lamps=6, pad_lamps_level=2.0)
    added = light_of(replace(FLAT, daylight_ev=-8.0, exposure_ev=8.0), lamps) - light_of(FLAT)
    for u, v in np.round(px_of([(0.55 * math.cos(a), 0.55 * math.sin(a)) for a in np.arange(6) * math.tau / 6])).astype(int):
        assert added[v - 1 : v + 2, u - 1 : u + 2, 1].max() > 1.0
    assert abs(at(added)).max() < 0.05


def test_drops_fall_stay_and_run_off_the_same_whatever_was_requested_before() -> None:
    drops = Drops(DropSettings(rain_per_minute=60.0, spray_per_minute=6.0), 5)
    later = drops.present(33.3, 640, 360)
    numbers = [len(drops.present(float(t), 640, 360)) for t in range(200)]
    assert np.mean(numbers) == pytest.approx((1.0 + 0.1 * 12) * 6.0, rel=0.25)
    assert drops.present(33.3, 640, 360) == later
    assert replace(drops, seed=6).present(33.3, 640, 360) != later
    # A drop stays where it fell, then only goes down.
    tracks: dict[float, list[float]] = {}
    for t in np.arange(0.0, 12.0, 0.1):
        for drop in Drops(DropSettings(rain_per_minute=12.0), 1).present(float(t), 640, 360):
            tracks.setdefault(round(drop.x, 0), []).append(drop.y)
    assert any(len(track) > 10 for track in tracks.values())


def test_a_drop_blurs_its_patch_and_nothing_else() -> None:
    fine = (np.indices((360, 640)).sum(axis=0) % 2 * 4000).astype(np.int16)
    light = np.ascontiguousarray(np.repeat(fine[..., None], 3, axis=2))
    before = light.copy()
    wet_lens(light, [Drop(300.0, 150.0, 20.0), Drop(-500.0, 50.0, 20.0)])
    assert light[145:155, 295:305].std() < 0.2 * before[145:155, 295:305].std()
    away = np.hypot(*(np.indices((360, 640)) - np.array([150, 300])[:, None, None])) > 30
    assert np.array_equal(light[away], before[away])
    assert 0 <= light.min() <= light.max() <= 4 * FULL_SCALE


def test_noise_has_shot_and_read_parts_and_no_bias() -> None:
    development = Development(FLAT, Sensor(psf_sigma_px=0.0, full_well_e=5000.0, read_noise_e=10.0))
    rng = np.random.default_rng(3)
    for level in (0.05, 0.2, 0.6):
        images = [development.sensor_image(counts(np.full((360, 640, 3), level, np.float32)), rng) for _ in range(6)]
        values = linear_light(np.stack(images))
        expected = math.sqrt(level / 5000.0 + (10.0 / 5000.0) ** 2)
        assert values.std() == pytest.approx(expected, rel=0.06)
        assert values.mean() == pytest.approx(level, rel=0.01)
        # Frames are independent of each other.
        a, b = (v - v.mean() for v in values[:2])
        assert abs((a * b).mean()) < 0.02 * expected**2


READOUT_S = 0.03
SENSOR = replace(IDEAL, psf_sigma_px=0.7, read_noise_e=10.0, full_well_e=8000.0)


def motion_of(view: Exposure, camera: Camera) -> CameraMotion:
    """Return the true motion of the camera against a pad at rest."""
    R_ned_cam = view.R_ned_body @ camera.T_body_cam.R
    arm = view.R_ned_body @ np.cross(view.w_body, camera.T_body_cam.t)
    return CameraMotion(camera.T_body_cam.R.inv @ view.w_body, R_ned_cam.inv @ (-view.v_body_ned - arm))


def errors(view: Exposure, camera: Camera, readout_s: float) -> tuple[F64, F64]:
    """Error of the registered pose, [m (3), rad (3)] in `cam`, as it is and corrected."""
    painted = pad("thesis")
    renderer = Renderer(camera, painted, Surroundings(), FLAT, replace(SENSOR, readout_s=readout_s))
    px = renderer.render(view, np.random.default_rng(3))
    true = pad_pose(view, camera)
    about = PadPose(Rotation.from_rotvec(np.array([0.01, -0.01, 0.02])) @ true.R_cam_pad, 1.02 * true.t_cam_pad)
    mended = at_one_instant(px, dataclasses.replace(camera, readout_s=readout_s), about, motion_of(view, camera))
    roll, pitch, _ = view.R_ned_body.rpy_rad
    tilt = Orientation(roll, pitch, math.radians(0.5) ** 2 * np.eye(2), math.radians(3.0), True)
    out = []
    for image in (px, mended):
        found = register(image, camera, painted, true, tilt)
        turned: Rotation = found.pose.R_cam_pad @ true.R_cam_pad.inv
        out.append(np.r_[found.pose.t_cam_pad - true.t_cam_pad, turned.rotvec_rad])
    return out[0], out[1]


@pytest.mark.parametrize("camera", [PLAIN, BENT], ids=["straight", "distorted"])
@pytest.mark.parametrize("height_m", [0.7, 1.5, 3.0])
def test_the_readout_is_taken_out_of_the_pose(camera: Camera, height_m: float) -> None:
    rng = np.random.default_rng(round(100 * height_m))
    before, after = [], []
    for _ in range(4):
        view = replace(
            shot(height_m, tuple(rng.uniform(-0.15, 0.15, 2)), tuple(rng.uniform(-0.08, 0.08, 3))),
            v_body_ned=rng.uniform(-0.5, 0.5, 3) * height_m / 2.0,
            w_body=rng.uniform(-0.6, 0.6, 3),
        )
        as_it_is, mended = errors(view, camera, READOUT_S)
        before.append(as_it_is / np.r_[np.full(3, height_m), np.ones(3)])
        after.append(mended / np.r_[np.full(3, height_m), np.ones(3)])
    assert np.linalg.norm(after) < 0.06 * np.linalg.norm(before)
    assert float(np.abs(before).max()) > 0.005


def test_a_frame_in_which_nothing_moves_is_left_as_it_is() -> None:
    px = np.zeros((360, 640, 3), np.uint8)
    still = CameraMotion(np.zeros(3), np.zeros(3))
    assert at_one_instant(px, dataclasses.replace(PLAIN, readout_s=0.03), pad_pose(shot(1.0), PLAIN), still) is px


@pytest.mark.parametrize("noise_rad", [0.0, 2e-3])
def test_the_camera_s_motion_is_that_of_the_attitude_and_the_belief_or_of_the_gyro(noise_rad, monkeypatch):
    """A body that turns about all axes and flies over a pad, its camera at the nose.

    The difference of two reported attitudes over 30 ms is noise: 0.1 rad/s for 2 mrad each.
    """
    w_body, v_body_ned, rng = np.array([0.5, -0.3, 0.2]), np.array([0.4, -0.2, 0.1]), np.random.default_rng(4)
    pilot = make_pilot(load("sim"))
    for k in range(120):
        turned = Rotation.from_rotvec(w_body * 0.01 * k) @ Rotation.from_rotvec(noise_rad * rng.standard_normal(3))
        pilot.on_sample(Attitude(make.stamp(1.0 + 0.01 * k), turned, (1e-6 + noise_rad**2) * np.eye(3)))
    stamp, R = make.stamp(2.0), Rotation.from_rotvec(w_body)
    at, v_level = stamp.measured_at, Rotation.from_rpy(0.0, 0.0, -R.rpy_rad[2]) @ -v_body_ned
    belief = RelativeState(at, "ekf", np.array([0.1, 0.2, 1.5]), v_level, 0.0, 1e-4 * np.eye(7), at, True)
    rolling = dataclasses.replace(PLAIN, readout_s=READOUT_S)
    true = motion_of(replace(shot(1.0), R_ned_body=R, v_body_ned=v_body_ned, w_body=w_body), PLAIN)
    by_attitude = pilot.estimator.camera_motion(stamp, rolling, belief)
    assert by_attitude is not None
    assert pilot.estimator.camera_motion(make.stamp(9.0), rolling, belief) is None
    if not noise_rad:
        assert by_attitude.w_cam == pytest.approx(true.w_cam, abs=1e-3)
        assert by_attitude.v_pad_cam == pytest.approx(true.v_pad_cam, abs=5e-3)
        return
    moves = BodyMotion(at, 0.0, np.zeros(3), np.eye(3), w_body, R, np.eye(3))
    # The gyro's rate is that of the exposure's instant, not of now.
    monkeypatch.setattr(pilot.estimator, "motion", lambda then: (moves, None) if then == at else None)
    by_gyro = pilot.estimator.camera_motion(stamp, rolling, belief)
    assert by_gyro.w_cam == pytest.approx(true.w_cam, abs=1e-9)
    assert np.linalg.norm(by_attitude.w_cam - true.w_cam) > 0.03


def test_a_camera_file_with_a_readout_time_changes_what_a_flight_sees() -> None:
    """The same rolling frames, tracked by a camera that knows its shutter and by one that does not."""
    still, painted, stamp = shot(1.5, (0.1, 0.05), (0.04, -0.03, 0.4)), pad("thesis"), make.stamp(2.0)
    view = replace(still, v_body_ned=np.array([0.3, -0.2, 0.1]), w_body=np.array([0.5, -0.6, 0.3]))
    renderer = Renderer(PLAIN, painted, Surroundings(), FLAT, replace(SENSOR, readout_s=READOUT_S))
    frame = Frame(stamp, 1, renderer.render(view, np.random.default_rng(1)))
    attitude = Attitude(stamp, view.R_ned_body, math.radians(0.2) ** 2 * np.eye(3))
    level = Rotation.from_rpy(0.0, 0.0, -view.R_ned_body.rpy_rad[2])
    d, heading = level @ (view.p_pad_ned - view.p_body_ned), (level @ view.R_ned_pad).rpy_rad[2]
    at, v = stamp.measured_at, level @ -view.v_body_ned
    belief, off = RelativeState(at, "ekf", d, v, -heading, 1e-4 * np.eye(7), at, True), {}
    for known_s in (0.0, READOUT_S):
        motion = motion_of(view, PLAIN) if known_s else None
        tracker = TrackerConfig(dataclasses.replace(PLAIN, readout_s=known_s), painted, motion=motion)
        seen, _ = track(tracker, TrackerMemory(), frame, attitude, belief)
        off[known_s] = float(np.linalg.norm(seen.selected.d_body_pad_level - d))
    assert off[READOUT_S] < 0.003 < 0.008 < off[0.0]
