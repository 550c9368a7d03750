"""Faults of the picture: what changes in a frame, where, and what acts without a rendered frame."""

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import after
from sitl.faults.fault import Fault
from sitl.faults.kinds import Bystander, FocalLength, Glint, LightFalls, ObjectOnPad, OtherPad, PadCovered, PictureFault, WetLens
from sitl.perception.levels import perceive
from sitl.perception.model import MODELLED
from sitl.scenario.scenario import from_mapping, load, pad_model, shipped_scenarios
from sitl.world.truth import RenderedFrame
from sitl.world.world import World
from tests.fly import fly_for, new_flight
from tests.sitl.test_faults import CALM, at


def frame(*faults: Fault, seconds: float = 0.3) -> RenderedFrame:
    return at(World(msgspec.structs.replace(CALM, faults=faults), 1), seconds).render()


def changed(fault: PictureFault, least: int = 12) -> tuple[float, float, float]:
    """Return the fraction of pixels that a fault changes, and their middle right of and below the pad's centre, in radii."""
    one, other = frame(fault).px, frame().px
    v, u = np.nonzero(np.abs(one.astype(int) - other).max(axis=-1) > least)
    camera = World(CALM, 1).camera
    radius_px = 0.39 * camera.fx / 3.0
    cu, cv = pad_middle(other)
    return len(u) / one[..., 0].size, (float(u.mean()) - cu) / radius_px, (float(v.mean()) - cv) / radius_px


def green(px: NDArray[np.uint8]) -> NDArray[np.bool_]:
    b, g, r = (px[..., i].astype(int) for i in range(3))
    return (g > 50) & (g > 2 * b) & (g > 2 * r)


def pad_middle(px: NDArray[np.uint8]) -> tuple[float, float]:
    v, u = np.nonzero(green(px))
    return float(u.mean()), float(v.mean())


def test_half_of_the_pad_is_hidden_on_the_side_that_it_says() -> None:
    whole = frame().px
    for side, right in ((90.0, True), (-90.0, False)):
        left = green(frame(PadCovered(at_s=0.1, fraction=0.5, from_deg=side)).px)
        assert left.sum() == pytest.approx(0.5 * green(whole).sum(), rel=0.1)
        assert bool(np.nonzero(left)[1].mean() < pad_middle(whole)[0]) is right


@pytest.mark.parametrize(
    ("fault", "right", "down", "share"),
    [
        (ObjectOnPad(at_s=0.1, right_m=0.78, size_m=0.5), 2.0, 0.0, (0.001, 0.03)),
        (ObjectOnPad(at_s=0.1, thing="lifebuoy", forward_m=0.78, size_m=0.5), 0.0, -2.0, (0.001, 0.03)),
        (ObjectOnPad(at_s=0.1, thing="crate", brightness=0.9, right_m=0.39, size_m=0.3), 1.0, 0.0, (0.001, 0.03)),
        (ObjectOnPad(at_s=0.1, thing="wet patch", forward_m=-0.78, size_m=0.4), 0.0, 2.0, (0.001, 0.03)),
        (Bystander(at_s=0.1, thing="box", right_m=0.78, width_m=0.4, height_m=0.1), 2.0, 0.0, (0.001, 0.03)),
        (OtherPad(at_s=0.1, forward_m=1.17), 0.0, -3.0, (0.01, 0.06)),
        (Glint(at_s=0.1, forward_m=0.0, right_m=0.39), 1.0, 0.0, (0.005, 0.1)),
    ],
)
def test_things_lie_where_they_say(fault: PictureFault, right: float, down: float, share: tuple[float, float]) -> None:
    part, u, v = changed(fault)
    assert share[0] < part < share[1]
    assert (u, v) == pytest.approx((right, down), abs=0.2)
    assert np.array_equal(frame(fault, seconds=0.08).px, frame(seconds=0.08).px), "nothing before it begins"


def test_a_pad_in_the_place_of_the_right_one_is_no_true_sight() -> None:
    odd = from_mapping({"title": "x", "faults": [{"kind": "other_pad", "at_s": 1, "instead": True, "file": "theses"}]}, "my.toml")
    with pytest.raises(BadInput, match=r"faults\[0\].file: .*did you mean 'thesis'"):
        pad_model(odd)
    wrong = frame(OtherPad(at_s=0.1, instead=True, size=0.5))
    assert not wrong.true_view
    assert frame(OtherPad(at_s=0.1, forward_m=1.2)).true_view
    assert green(wrong.px).sum() == pytest.approx(0.25 * green(frame().px).sum(), rel=0.15)


def test_less_light_is_darker_and_noisier_and_a_lens_blurs_and_zooms() -> None:
    bright, dark = frame().px.astype(float), frame(LightFalls(at_s=0.1, fraction=0.1)).px.astype(float)
    assert 0.25 < dark.mean() / bright.mean() < 0.4, "a tenth of the light is a third of the value"
    deck = np.s_[100:140, 380:420]
    assert dark[deck].std() / dark[deck].mean() > 1.5 * bright[deck].std() / bright[deck].mean()
    sharp, wet = (np.abs(np.diff(px.astype(float), axis=1)).mean() for px in (frame().px, frame(WetLens(at_s=0.1, drops=80)).px))
    assert wet < 0.85 * sharp
    assert np.array_equal(frame(WetLens(at_s=0.1)).px, frame(WetLens(at_s=0.1)).px)
    assert green(frame(FocalLength(at_s=0.1, scale=1.2)).px).sum() == pytest.approx(1.44 * green(frame().px).sum(), rel=0.03)


def test_what_acts_without_a_rendered_frame_acts_there_too() -> None:
    clear, covered = (fly_for(1.6, CALM, level="truth", faults=f) for f in ((), (PadCovered(at_s=0.4, fraction=1.0),)))
    assert clear.health.frames[Verdict.NO_PAD] < 5 < covered.health.frames[Verdict.NO_PAD]
    dark = fly_for(1.6, CALM, level="truth", faults=(LightFalls(at_s=0.0, fraction=0.0005),))
    scene = next(reversed(dark._perception.scenes._scenes.values()))  # type: ignore[attr-defined]
    assert scene.light_stops == pytest.approx(np.log2(0.0005))
    heights = []
    for faults in ((), (FocalLength(at_s=0.0, scale=1.1),)):
        flight = fly_for(1.6, CALM, level="model", faults=faults)
        belief = flight._pilot.estimator.at(flight._clock.t)
        assert belief is not None
        heights.append(belief.height_m / float(flight.world.truth().d_body_pad_level[2]))
    assert heights[1] / heights[0] == pytest.approx(1.0 / 1.1, rel=0.03)


@pytest.mark.parametrize("kind", sorted(PictureFault.__subclasses__(), key=str))
def test_a_level_that_cannot_show_a_picture_refuses_it_by_name(kind: type[PictureFault]) -> None:
    fault = kind(at_s=1.0, **({"instead": True} if kind is OtherPad else {}))
    if kind in MODELLED:
        perceive("model").refuse([fault])
    else:
        with pytest.raises(BadInput, match=f"the fault {fault.kind} is seen in rendered frames only; use --perception pixels"):
            perceive("model").refuse([fault])
    perceive("pixels").refuse([fault])


def test_each_shipped_fault_of_the_picture_changes_it() -> None:
    beginnings = dict.fromkeys(("below_height_m", "above_height_m", "in_phase", "per_minute"))
    shipped = [(n, f) for n in shipped_scenarios() if n.startswith("faults/") for f in load(n).faults]
    pictures = [(name, fault) for name, fault in shipped if isinstance(fault, PictureFault)]
    assert len(pictures) > 10
    for name, fault in pictures:
        part, _, _ = changed(msgspec.structs.replace(fault, **beginnings, at_s=0.1), least=6)
        assert part > 0.001, name


@pytest.mark.parametrize(("thing", "right_m", "unsafe"), [("crate", 0.2, 1), ("crate", 0.6, 0), ("wet patch", 0.0, 0)])
def test_a_contact_with_a_thing_is_unsafe_and_one_with_water_is_not(thing: str, right_m: float, unsafe: int) -> None:
    lies = {"kind": "object_on_pad", "at_s": 0.0, "thing": thing, "size_m": 0.3, "right_m": right_m}
    scenario = from_mapping({"title": "x", "start": {"height_m": 0.6}, "faults": [lies]}, "mine.toml")
    flight = new_flight(scenario)
    flight.world.vehicle.land()
    while flight.world.truth().touchdown is None:
        flight.world.advance(after(flight.world.now, 0.05))
    flight._grader.step()
    met = [line for line in flight.result().as_json()["unsafe"] if line.startswith(f"touched a {thing} on the pad")]
    assert len(met) == unsafe


@pytest.mark.parametrize(("right_m", "height_m", "unsafe"), [(0.1, 1.7, 1), (1.2, 1.7, 0), (0.1, 0.2, 0)])
def test_to_fly_into_a_person_is_unsafe_and_to_fly_beside_or_above_is_not(right_m: float, height_m: float, unsafe: int) -> None:
    stands = {"kind": "bystander", "at_s": 0.0, "right_m": right_m, "height_m": height_m}
    scenario = from_mapping({"title": "x", "start": {"height_m": 1.0, "pad_right_m": 0.0}, "faults": [stands]}, "mine.toml")
    flight = new_flight(scenario)
    flight.world.advance(after(flight.world.now, 0.05))
    for _ in range(2):
        flight._grader.step()
    assert len([line for line in flight.result().as_json()["unsafe"] if line.startswith("flew into a person")]) == unsafe
