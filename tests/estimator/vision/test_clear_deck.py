"""Things on the pad are seen, and light is not."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import State
from companion.guidance.pilot import Pilot
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.options import EstimatorOptions
from estimator.vision.clear_deck import LASTS_S, DeckMemory, checked_deck
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detection import PadCheck
from estimator.vision.tracker import TrackerConfig, TrackerMemory
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Light, Mast
from sitl.camera.surroundings import Decal, Surroundings
from tests.support.pad_scenes import load_camera, load_pad, truth_of

CAMERA, PAD = load_camera("sim"), load_pad("thesis")
BRIGHT = Light(drone_shadow=0.0)


def shown(light: Light, *things: Decal, frames: int = 8, height_m: float = 1.4, memory: DeckMemory | None = None) -> DeckMemory:
    renderer = Renderer(CAMERA, PAD, Surroundings(decals=things), light)
    first = 0 if memory is None else round((memory.at - 1_000_000_000) * 5e-9) + 1
    for k in range(first, first + frames):
        R = Rotation.from_rpy(0.02 * math.sin(k), 0.0, 0.4)
        pad = np.array([0.0, 0.0, -0.6])
        shot = Exposure(0.2 * k, R, pad + np.array([0.03 * math.cos(k), 0.0, -height_m]), Rotation.identity(), pad)
        view = FrameView(Pyramid(renderer.render(shot, np.random.default_rng(k))), CAMERA, PAD)
        memory = checked_deck(memory, view, truth_of(shot, CAMERA), MonoNs(1_000_000_000 + 250_000_000 * k), 0.7, 0.001)
    assert memory is not None
    return memory


def check(light: Light, *things: Decal) -> PadCheck:
    return shown(light, *things).check


@pytest.mark.parametrize("at", [(0.05, -0.08), (0.1, 0.28)], ids=["on the H", "on the disc alone"])
def test_a_grey_crate_is_seen_in_its_place_and_size(at: tuple[float, float]) -> None:
    of = check(BRIGHT, Decal("crate", at, 0.15, 0.0, "pad", (98, 98, 98)))
    assert of.seen > 0.9
    assert of.thing is not None
    assert of.thing.width_m == pytest.approx(0.15, abs=0.04)
    assert math.hypot(of.thing.forward_m - at[0], of.thing.right_m - at[1]) < 0.03
    assert of.thing.from_centre_m == pytest.approx(math.hypot(*at), abs=0.03)


@pytest.mark.parametrize(
    "light",
    [BRIGHT, Light(mast=Mast(3.0, (1.0, 0.4), 0.6)), Light(drone_shadow=0.0, glare=0.8)],
    ids=["even light", "shadows", "beside glare"],
)
def test_a_thing_of_the_discs_own_colour_is_seen_by_the_ring_that_it_hides(light: Light) -> None:
    of = check(light, Decal("crate", (0.0, 0.26), 0.15, 0.3, "pad", PAD.markings.colours.disc))
    assert of.thing is not None
    assert math.hypot(of.thing.forward_m, of.thing.right_m - 0.26) < 0.05


def test_a_thing_that_hides_all_of_the_lettering_is_seen() -> None:
    of = check(BRIGHT, Decal("crate", (0.0, 0.0), 0.4, 0.0, "pad", (65, 88, 72)))
    assert of.thing is not None
    assert of.thing.width_m == pytest.approx(0.4, abs=0.1)


@pytest.mark.parametrize(
    "light",
    [
        Light(),
        Light(drone_shadow=0.0, glare=1.0),
        Light(glare=0.6, exposure_ev=1.0, white_balance=(1.2, 1.0, 0.8)),
        Light(drone_shadow=0.6, mast=Mast(3.0, (1.0, 0.4), 0.6)),
        Light(drone_shadow=0.0, wetness=1.0),
        Light(visibility_m=20.0, colour_temperature_k=3500.0, balanced_for_k=6500.0, wear=0.15),
    ],
    ids=["own shadow", "glare", "clipped glare, wrong white", "shadow of a mast", "puddles", "haze, warm light and worn paint"],
)
def test_light_is_no_thing(light: Light) -> None:
    of = check(light)
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
        level = Attitude(stamp, Rotation.identity(), 1e-5 * np.eye(3))
        return pilot.detect(Frame(stamp, 0, blank), level).on_pad

    pilot.search._memory = TrackerMemory(deck=deck)
    check = looked(1.0, State.REFUSED)
    assert check is not None
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
