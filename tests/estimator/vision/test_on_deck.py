"""Things on the pad, about it and passing over it are seen, and light and what is painted are not."""

import dataclasses
import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import pytest
from msgspec.structs import replace

from benches.clear_deck import HOVER, LEANS, approach, over_ship
from companion.base.mission import State
from companion.guidance.pilot import Pilot
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.options import EstimatorOptions
from estimator.vision.camera.pose import PadPose
from estimator.vision.deck import around
from estimator.vision.deck.above import MOVED_LASTS_S, STANDING_LASTS_S
from estimator.vision.deck.around import AroundMemory, watch_around
from estimator.vision.deck.clear_deck import LASTS_S, SurfaceMemory, check_surface
from estimator.vision.deck.heights import heights_of
from estimator.vision.deck.memory import DeckMemory
from estimator.vision.deck.passing import PassMemory, watch_passing
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detection import PadCheck
from estimator.vision.options import TrackerOptions
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Light
from sitl.camera.picture_effects import PictureEffects
from sitl.camera.surroundings import Decal, Deck, Surroundings
from sitl.faults.kinds import Bystander, Glint
from sitl.scenario.scenario import load as load_scenario
from sitl.sea.sea import SEA_STATES, Waves
from tests.support.pad_scenes import load_camera, load_pad, truth_of

CAMERA, PAD = load_camera("sim"), load_pad("thesis")
BRIGHT, USUAL = Light(drone_shadow=0.0), Light()


def shown(
    light: Light, *things: Decal, frames: int = 8, height_m: float = 1.4, memory: SurfaceMemory | None = None
) -> SurfaceMemory:
    renderer = Renderer(CAMERA, PAD, Surroundings(decals=things), light)
    first = 0 if memory is None else round((memory.at - 1_000_000_000) * 5e-9) + 1
    for k in range(first, first + frames):
        R = Rotation.from_rpy(0.02 * math.sin(k), 0.0, 0.4)
        pad = np.array([0.0, 0.0, -0.6])
        shot = Exposure(0.2 * k, R, pad + np.array([0.03 * math.cos(k), 0.0, -height_m]), Rotation.identity(), pad)
        view = FrameView(Pyramid(renderer.render(shot, np.random.default_rng(k))), CAMERA, PAD)
        memory = check_surface(memory, view, truth_of(shot, CAMERA), MonoNs(1_000_000_000 + 250_000_000 * k), 0.7, 0.001)
    assert memory is not None
    return memory


@pytest.mark.parametrize("at", [(0.05, -0.08), (0.1, 0.28)], ids=["on the H", "on the disc alone"])
def test_a_grey_crate_is_seen_in_its_place_and_size(at: tuple[float, float]) -> None:
    of = shown(BRIGHT, Decal("crate", at, 0.15, 0.0, "pad", (98, 98, 98))).check
    assert of.seen > 0.9
    assert of.thing.width_m == pytest.approx(0.15, abs=0.04)
    assert math.hypot(of.thing.forward_m - at[0], of.thing.right_m - at[1]) < 0.03
    assert of.thing.from_centre_m == pytest.approx(math.hypot(*at), abs=0.03)


@pytest.mark.parametrize(
    "light",
    [BRIGHT, Light(mast_height_m=3.0, mast_forward_m=1.0, mast_right_m=0.4), Light(drone_shadow=0.0, glare=0.8)],
    ids=["even light", "shadows", "beside glare"],
)
def test_a_thing_of_the_discs_own_colour_is_seen_by_the_ring_that_it_hides(light: Light) -> None:
    of = shown(light, Decal("crate", (0.0, 0.26), 0.15, 0.3, "pad", PAD.markings.colours.disc)).check
    assert math.hypot(of.thing.forward_m, of.thing.right_m - 0.26) < 0.05


@pytest.mark.parametrize(
    "light",
    [
        Light(),
        Light(drone_shadow=0.0, glare=1.0),
        Light(glare=0.6, exposure_ev=1.0, white_balance=(1.2, 1.0, 0.8)),
        Light(drone_shadow=0.6, mast_height_m=3.0, mast_forward_m=1.0, mast_right_m=0.4),
        Light(drone_shadow=0.0, wetness=1.0),
        Light(visibility_m=20.0, colour_temperature_k=3500.0, balanced_for_k=6500.0, wear=0.15),
    ],
    ids=["own shadow", "glare", "clipped glare, wrong white", "shadow of a mast", "puddles", "haze, warm light and worn paint"],
)
def test_light_is_no_thing(light: Light) -> None:
    of = shown(light).check
    # Clipped cells say nothing.
    assert of.seen > (0.8 if light.exposure_ev == 0.0 else 0.5)
    assert (of.glare > 0.1) == (light.exposure_ev > 0.0)
    assert of.thing is None


def test_nothing_old_is_reported_and_on_the_ground_all_is_forgotten() -> None:
    deck = shown(BRIGHT, Decal("crate", (0.1, 0.28), 0.15, 0.0, "pad", (98, 98, 98)))
    pilot = Pilot(TrackerConfig(CAMERA, PAD), EstimatorOptions(), GuidanceOptions())
    blank = np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)

    def looked(later_s: float, state: State) -> PadCheck | None:
        pilot.landing.mission = replace(pilot.landing.mission, state=state)
        at = MonoNs(deck.at + round(later_s * 1e9))
        stamp = Stamp(at, at, 0.001, "sim")
        look = pilot.look_at(Frame(stamp, 0, blank), Attitude(stamp, Rotation.identity(), 1e-5 * np.eye(3)))
        return pilot.search.read_deck(pilot.detect(replace(look, reads_deck=False))).on_pad

    pilot.search._memory = TrackerMemory(deck=DeckMemory(deck))
    check = looked(1.0, State.REFUSED)
    assert check.thing is not None
    assert looked(LASTS_S + 1.0, State.REFUSED) is None
    assert looked(1.0, State.LANDED) is None
    assert looked(2.0, State.READY) is None, "what another flight saw"


def test_what_was_taken_away_is_gone_and_what_left_the_view_still_counts() -> None:
    crate = Decal("crate", (0.1, 0.28), 0.15, 0.0, "pad", (98, 98, 98))
    there = shown(BRIGHT, crate)
    assert shown(BRIGHT, memory=there, frames=30).check.thing is None
    # From 0.3 m the camera sees the middle of the pad alone.
    low = shown(BRIGHT, crate, memory=there, frames=20, height_m=0.3).check
    assert low.thing is not None
    gone = shown(BRIGHT, memory=there, frames=math.ceil(LASTS_S / 0.2) + 5, height_m=0.3).check
    assert gone.thing is None
    assert gone.seen < 0.5


WALKER = Bystander(at_s=0.0, forward_m=-1.0, right_m=0.9, to_forward_m=1.0, to_right_m=0.9, speed_m_s=0.7)
WIDE = Deck(8.0, 5.0, (0.0, 0.0), 0.0, seed=3)
CRATE = Bystander(at_s=0.0, thing="box", forward_m=0.1, right_m=0.75, width_m=0.4, height_m=0.4)
FOOT = Bystander(at_s=0.0, forward_m=0.1, right_m=-0.8, to_forward_m=0.1, to_right_m=0.9, height_m=0.15, speed_m_s=0.8)
CROSSING = {"forward_m": 1.0, "right_m": -1.5, "to_forward_m": -1.0, "to_right_m": 1.5, "speed_m_s": 3.0}
BIRD = Bystander(at_s=0.0, thing="bird", width_m=0.5, height_m=1.5, **CROSSING)
WIDE_DECK = Surroundings(WIDE)
Memory = TypeVar("Memory", AroundMemory, PassMemory)


def came_down(
    watch: Callable[[Memory | None, FrameView, PadPose, MonoNs], Memory],
    from_m: float,
    to_m: float,
    *faults: Bystander | Glint,
    scene: Surroundings = WIDE_DECK,
    light: Light = BRIGHT,
    gain: float = 1.0,
    memory: Memory | None = None,
    readings: range = range(14),
) -> Memory:
    """Return what is known after a way down of 13 readings, and a wait there.

    It has swings, errors of registration, and an exposure that rises.
    """
    renderer, effects = Renderer(CAMERA, PAD, scene, light), PictureEffects(CAMERA, PAD, light, 1)
    rng, (period_s, turn, off) = np.random.default_rng(5), (0.25, 1.0, 0.0) if watch is watch_around else (0.1, 0.25, 0.002)
    for k in readings:
        height_m = from_m + (to_m - from_m) * min(k, 13) / 13
        R = Rotation.from_rpy(0.04 * math.sin(turn * k), 0.03 * math.cos(turn * k), 0.4)
        pad = np.array([0.0, 0.0, -0.6])
        aside = np.array([0.06 * math.cos(turn * k), 0.05 * math.sin(turn * k), -1.0]) * height_m
        shot = Exposure(period_s * k, R, pad + aside, Rotation.identity(), pad)
        px = effects.drawn(renderer.render(shot, rng), faults, shot, rng)
        px = np.clip(px * gain ** (k / 12), 0, 255).astype(np.uint8)
        true = truth_of(shot, CAMERA)
        pose = PadPose(true.R_cam_pad @ Rotation.from_rotvec(rng.normal(0, off, 3)), true.t_cam_pad + rng.normal(0, off, 3))
        memory = watch(memory, FrameView(Pyramid(px), CAMERA, PAD), pose, MonoNs(10**9 + round(1e9 * period_s * k)))
    assert memory is not None
    return memory


@pytest.mark.parametrize(
    ("surroundings", "light"),
    [
        (Surroundings(WIDE, decals=(Decal("crate", (0.1, 0.75), 0.4, 0.3, "deck"),)), Light(drone_shadow=0.0)),
        (WIDE_DECK, Light(drone_shadow=0.7, sun_elevation_deg=69.0)),
        (Surroundings(Deck(seed=2), Waves.draw(SEA_STATES[4], 3)), Light(drone_shadow=0.0)),
    ],
    ids=["something flat", "the drone's own shadow", "a small deck over waves"],
)
def test_what_lies_flat_and_what_is_light_or_sea_is_nothing(surroundings: Surroundings, light: Light) -> None:
    memory = came_down(watch_around, 4.5, 1.5, scene=surroundings, light=light)
    assert memory.began > 5
    assert memory.finding.near(memory.at) is None
    blank, far = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8), PadPose(Rotation.identity(), np.array([0.0, 0.0, 40.0]))
    view, at = FrameView(Pyramid(blank), CAMERA, PAD), MonoNs(memory.at + 1)
    assert not DeckMemory(None, memory, watch_passing(None, view, far, memory.at)).is_due(at, view, far), "too far to read"


@pytest.mark.parametrize(
    ("body", "height_m", "lasts_s"),
    [
        (CRATE, (0.3, 0.5), STANDING_LASTS_S),
        (Bystander(at_s=0.0, forward_m=-0.3, right_m=0.8), (0.4, 2.0), STANDING_LASTS_S),
        (WALKER, (0.0, 2.0), MOVED_LASTS_S),
    ],
    ids=["a crate", "a person stands", "a person walks"],
)
def test_what_is_about_the_pad_is_seen_with_its_height_for_a_time(body, height_m, lasts_s) -> None:
    memory = came_down(watch_around, 4.5, 1.5, body, light=USUAL)
    near, at = memory.finding.near(memory.at), memory.finding.at
    assert at is not None
    assert height_m[0] <= near.height_m <= height_m[1]
    if not body.speed_m_s:
        assert math.hypot(near.forward_m - body.forward_m, near.right_m - body.right_m) < 0.25
    assert memory.finding.near(MonoNs(at + round(1e9 * (lasts_s - 0.1)))) is not None
    assert memory.finding.near(MonoNs(at + round(1e9 * (lasts_s + 0.1)))) is None


@pytest.mark.parametrize(
    ("watch", "way", "body", "times", "is_kept"),
    [(watch_around, (4.5, 1.5), CRATE, n, n > 5) for n in (1, 3, 12)]
    + [(watch_passing, (2.6, 1.8), BIRD, n, n > 2) for n in (2, 3)],
)
def test_what_later_looks_at_its_place_do_not_confirm_fades_unless_many_did_before(watch, way, body, times, is_kept) -> None:
    """Corners that were followed wrongly agree once, and light flashes; what was often seen counts for a drone that waits."""
    memory = came_down(watch, *way, body)
    memory = dataclasses.replace(memory, finding=dataclasses.replace(memory.finding, shown=times))
    memory = came_down(watch, *way, memory=memory, readings=range(14, 44))
    assert (memory.finding.near(memory.at) is not None) is is_kept


@pytest.mark.parametrize(("apart_m", "spread", "times"), [(0.0, 1.0, 4), (0.4, 1.0, 4), (0.6, 1.0, 1), (0.0, 2.5, 3)])
def test_a_picture_confirms_a_finding_in_its_place_alone_and_not_if_it_is_registered_wrongly(
    apart_m: float, spread: float, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = came_down(watch_around, 4.5, 1.5, CRATE)
    assert memory.finding.thing is not None
    thing = replace(memory.finding.thing, forward_m=memory.finding.thing.forward_m + apart_m)
    monkeypatch.setattr(around, "heights_of", lambda *of: dataclasses.replace(heights_of(*of), flat=spread))
    memory = dataclasses.replace(memory, finding=dataclasses.replace(memory.finding, thing=thing, shown=3))
    assert came_down(watch_around, 4.5, 1.5, CRATE, memory=memory, readings=range(14, 15)).finding.shown == times


@pytest.mark.parametrize(
    ("seed", "over", "course"),
    [(24, "weather_4", LEANS), (40, "weather_4", LEANS), (900003, "glint", HOVER._replace(frames=330))],
)
def test_a_camera_that_leans_and_swings_or_waits_over_glitter_sees_nothing_about_a_clear_pad(seed, over, course) -> None:
    """Corners that were followed wrongly stand near each other there, each with a height of its own, or go their own way."""
    assert over_ship(seed, load_scenario(over), course).near_m == 0.0


def test_a_camera_that_leans_and_swings_sees_a_crate_beside_the_pad() -> None:
    assert approach(0, "plain", (), TrackerConfig(CAMERA, PAD, TrackerOptions()), (CRATE,), LEANS).near_m > 4.0


@pytest.mark.parametrize(
    ("from_m", "to_m", "body"),
    [
        (4.8, 3.8, BIRD),
        (2.6, 1.8, BIRD),
        (3.0, 2.2, Bystander(at_s=0.0, forward_m=0.2, right_m=-0.9, to_forward_m=0.0, to_right_m=0.9, speed_m_s=0.8)),
        (0.5, 0.2, FOOT),
    ],
    ids=["a bird far below", "a bird close below", "a person", "a foot that comes in below during the commit"],
)
def test_what_crosses_the_pad_once_is_seen_where_it_is_and_for_a_time(from_m: float, to_m: float, body: Bystander) -> None:
    memory = came_down(watch_passing, from_m, to_m, body)
    near, at = memory.finding.near(memory.at), memory.finding.at
    assert near.from_centre_m < PAD.disc_radius_m + 1.2
    assert memory.finding.shown >= 3 or from_m > 1.0, "low over the pad one look is enough"
    assert memory.finding.near(MonoNs(at + round(1e9 * (MOVED_LASTS_S - 0.1)))) == near
    assert memory.finding.near(MonoNs(at + round(1e9 * (MOVED_LASTS_S + 0.1)))) is None


@pytest.mark.parametrize("heights", [(4.8, 3.6), (2.4, 1.2), (0.7, 0.2)])
@pytest.mark.parametrize(
    ("scene", "light", "gain"),
    [
        (WIDE_DECK, Light(drone_shadow=0.7, sun_elevation_deg=69.0), 1.0),
        (WIDE_DECK, Light(drone_shadow=0.7, sun_elevation_deg=46.0), 1.0),
        (WIDE_DECK, BRIGHT, 1.6),
        (Surroundings(Deck(seed=2), Waves.draw(SEA_STATES[4], 3)), BRIGHT, 1.0),
    ],
    ids=["the drone's own shadow", "its shadow in low sun", "a changing exposure", "a small deck over waves"],
)
def test_light_and_waves_do_not_pass(scene: Surroundings, light: Light, gain: float, heights: tuple[float, float]) -> None:
    memory = came_down(watch_passing, *heights, scene=scene, light=light, gain=gain)
    assert memory.finding.near(memory.at) is None
    assert (memory.known > 0).any()
