"""Paint memory: slow, sure of nothing it did not see often, and with a way back."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from estimator.contracts.samples import Attitude
from estimator.vision.camera import Camera
from estimator.vision.detect.acquire import acquire
from estimator.vision.detect.paint import FRESH, LEARNED_AT, PaintMemory, learn, missed
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.template import AROUND, DISC
from estimator.vision.pad import Pad
from estimator.vision.pose import Orientation
from estimator.vision.register.look import look
from estimator.vision.register.registration import RegistrationOptions
from sitl.camera.light import Light
from tests.support.deck_images import shown
from tests.support.pad_claims import keeps_claim
from tests.support.pad_images import STAMP

Teach = Callable[[PaintMemory], PaintMemory]


def view(camera: Camera, pad: Pad, light: Light, seed: int = 0) -> Teach:
    """Return what one frame makes of a memory."""
    seen = shown(camera, pad, 1.5, light=light, seed=seed)
    pyramid, orientation = Pyramid(seen.px), Orientation.of(Attitude(STAMP, seen.R_level_body, 1e-6 * np.eye(3)))

    def teach(memory: PaintMemory) -> PaintMemory:
        found = look(FrameView(pyramid, camera, pad), seen.truth, orientation, RegistrationOptions(coarse=False), paint=memory)
        assert found is not None
        return found.paint()

    return teach


def taught(frames: int, one: Teach, start: PaintMemory = FRESH) -> PaintMemory:
    for _ in range(frames):
        start = learn(start, one(start), 0.97)
    return start


def test_three_confident_frames_make_it_trusted_and_doubtful_ones_teach_nothing(camera: Camera, pad: Pad) -> None:
    one = view(camera, pad, Light())
    assert learn(FRESH, one(FRESH), LEARNED_AT - 0.01) is FRESH
    assert taught(2, one).dominance(pad) is None
    learned = taught(3, one).dominance(pad)
    assert learned is not None
    disc, around = learned
    assert disc > around + 1.0, "the disc is green and the deck is not"
    assert abs(around) < 0.25


def test_it_follows_the_light_slowly(camera: Camera, pad: Pad) -> None:
    bright, dim = view(camera, pad, Light()), view(camera, pad, Light(exposure_ev=-1.5), 1)
    old = taught(60, bright)
    after_one, after_many = learn(old, dim(old), 0.97), taught(150, dim, old)
    target = taught(1, dim).mean[DISC]
    gap = float(np.abs(old.mean[DISC] - target).max())
    assert gap > 0.3
    assert np.abs(after_one.mean[DISC] - old.mean[DISC]).max() < 0.06 * gap
    assert np.abs(after_many.mean[DISC] - target).max() < 0.15 * gap


def test_without_the_pad_it_fades_back_to_knowing_nothing(camera: Camera, pad: Pad) -> None:
    memory = taught(200, view(camera, pad, Light()))
    trusts = []
    for _ in range(60):
        memory = missed(memory)
        trusts.append(memory.trust)
    assert memory is FRESH
    assert all(a >= b for a, b in itertools.pairwise(trusts))
    used = sum(t >= 0.1 for t in trusts)
    assert 20 < used < 40, "a second or so at 30 frames a second"
    assert missed(FRESH) is FRESH


@pytest.mark.parametrize("height_m", [0.4, 1.5, 6.0])
def test_a_memory_of_the_wrong_colours_hinders_nothing(camera: Camera, pad: Pad, height_m: float) -> None:
    good = taught(50, view(camera, pad, Light()))
    swapped = PaintMemory(good.mean[[3, 1, 0, 2]], good.var, good.trust)
    upside_down = PaintMemory(good.mean[:, [2, 0, 1]] + 2.0, good.var, good.trust)
    seen = shown(camera, pad, height_m, aside=(0.1, -0.1))
    for memory in (FRESH, good, swapped, upside_down):
        best = acquire(seen.px, camera, pad, seen.R_level_body, memory)[0]
        assert best.score > 0.5
        assert keeps_claim(best.pose, seen.truth, camera, pad, best.yaw_ambiguous)


def test_memory_is_a_value(camera: Camera, pad: Pad) -> None:
    one = view(camera, pad, Light())
    before = taught(5, one)
    kept = before.mean.copy(), before.var.copy(), before.trust
    learn(before, one(before), 1.0)
    missed(before)
    assert np.array_equal(before.mean, kept[0])
    assert np.array_equal(before.var, kept[1])
    assert before.trust == kept[2]
    assert np.allclose(taught(5, one).mean, before.mean)
    assert float(before.mean[AROUND].std()) < float(before.mean[DISC].std()), "a grey deck, a green disc"
