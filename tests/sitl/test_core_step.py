"""Invariants of the core's step over random flights, and the renderer's bits with and without vector instructions."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray

from decklander.place import SHIPPED
from estimator.contracts.geometry import F64, Rotation
from estimator.core.library import Door
from sitl.core import abi
from sitl.core.abi import DL_PAD_EDGE, DL_PAD_PAINTS
from sitl.core.library import SIM
from sitl.sea.sea import SeaState, Waves
from sitl.sensors.sensors import Sensors
from sitl.sensors.settings import SensorSettings
from sitl.vehicle.airframe import Airframe, Avionics, ardrone2, load, rotors
from sitl.vehicle.disturbances import Wind
from sitl.vehicle.vehicle import Vehicle, VehiclePhase
from sitl.vessel.air import AirModel, GustOnce
from sitl.vessel.contact import DeckShape, Ground
from sitl.vessel.seakeeping import Superstructure
from sitl.vessel.vessel import Mounted
from sitl.world.world import Physics, decks_of
from supply import core

DT = 0.004
SHAPES = (DeckShape(3.0, 2.0, 1.4, 1.4), DeckShape(3.0, 2.0, 1.0, 1.5, taper_m=1.0, pad_yaw_rad=0.6))
HEXA = load(SHIPPED / "vehicles/hexa_7kg.toml").airframe()
FRAMES = (
    ardrone2(),
    HEXA,
    replace(ardrone2(), ground_effect="rotors", avionics=Avionics(flow_sees_deck=False)),
    replace(ardrone2(), command_delay_s=0.0, motor_lag_s=0.0),
)
GUST = GustOnce(0.5, 0.4, 0.6, (3.0, -2.0))
AIRS = (
    None,
    AirModel(7.0, 2.0, logarithmic=True, turbulence="dryden", gusts=(GUST, GustOnce(0.2, 0.3, 0.1, (1.0, 1.0)))),
    AirModel(9.0, math.pi, wake=Superstructure(6.0, 4.0, 5.0, 4.0, 0.5), pad_m=(-2.0, 0.3), pad_yaw_rad=0.4),
)


def moving_ground(rng: np.random.Generator, steps: int) -> Mounted:
    """Return a pad that heaves, rolls, pitches, turns and goes ahead."""
    t = DT * np.arange(1, steps + 1)
    w, phase, size = rng.uniform(0.4, 1.6, 4), rng.uniform(0, 6, 4), rng.uniform(0, 1, 4) * [0.5, 0.2, 0.1, 0.3]
    heave, roll, pitch, yaw = (a * np.sin(f * t + b) for a, f, b in zip(size, w, phase, strict=True))
    v_ne = rng.uniform(-1, 1, 2)
    p = np.stack([v_ne[0] * t, v_ne[1] * t, -1.0 + heave], axis=1)
    v = np.gradient(p, DT, axis=0)
    R = np.array([Rotation.from_rpy(*each).matrix for each in zip(roll, pitch, yaw, strict=True)])
    rates = np.gradient(np.stack([roll, pitch, yaw], axis=1), DT, axis=0)
    return Mounted(p[None], v[None], np.zeros_like(v)[None], R[None], rates[None])


def ground(pads: Mounted, i: int, sea_z: float, sea_vz: float) -> Ground:
    return Ground.of(pads.p_ned[0, i], pads.v_ned[0, i], pads.R_ned[0, i], pads.w[0, i], sea_z, sea_vz)


def disturb(v: Vehicle, kind: int, extra: tuple[float, float, float]) -> None:
    """Let a fault begin: of a rotor, of the tilt, of the optical flow, a gust; or end them all."""
    n = len(rotors(v.airframe))
    v.rotor_health = tuple(0.7 if kind == 1 and i == 1 else 1.0 for i in range(n))
    v.tilt_max_rad = 0.05 if kind == 2 else v.airframe.loops.tilt_max_rad
    v.flow_works = kind != 3
    v.extra_wind = extra if kind == 4 else (0.0, 0.0, 0.0)


class Observer(NamedTuple):
    """Observer who writes the same flight down with another north and another origin."""

    R: Rotation
    p: F64

    def air(self, air: AirModel | None, yaw_rad: float) -> AirModel | None:
        if air is None:
            return None
        gusts = [replace(g, v_ned=tuple((self.R @ np.array([*g.v_ned, 0.0]))[:2].tolist())) for g in air.gusts]
        return replace(air, towards_rad=air.towards_rad + yaw_rad, gusts=tuple(gusts))

    def pads(self, pads: Mounted) -> Mounted:
        R = self.R.matrix
        return Mounted(pads.p_ned @ R.T + self.p, pads.v_ned @ R.T, pads.a_ned @ R.T, R @ pads.R_ned, pads.w)


@given(
    seed=st.integers(0, 2**32 - 1), frame=st.sampled_from(FRAMES), shape=st.sampled_from(SHAPES),
    air=st.sampled_from(AIRS), start=st.sampled_from(["air", "low", "deck", "beside", "tumbling"]), yaw_rad=st.floats(-3.0, 3.0),
    moved=st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)),
)  # fmt: skip
@settings(max_examples=14, derandomize=True, phases=[Phase.generate])
def test_a_flight_is_the_same_from_another_place_and_in_another_direction(
    seed: int, frame: Airframe, shape: DeckShape, air: AirModel | None, start: str, yaw_rad: float,
    moved: tuple[float, float],
) -> None:  # fmt: skip
    """WHY: north and the origin are names. WHAT: starts, landings, faults and falls, to a micrometre."""
    # The eddies of a wake are drawn to north, east and down.
    yaw_rad = 0.0 if air is not None and air.wake is not None else yaw_rad
    rng, by = np.random.default_rng(seed), Observer(Rotation.from_rpy(0.0, 0.0, yaw_rad), np.array([*moved, 0.0]))
    steps, wind, current = 500, np.array([*rng.uniform(-3, 3, 2), 0.0]), np.array([*rng.uniform(-1, 1, 2), 0.0])
    pads = moving_ground(rng, steps)
    worlds = (pads, by.pads(pads))
    fleet = [
        Vehicle(frame, shape, DT, np.random.SeedSequence(seed), Wind(tuple(blown.tolist()), 0.0), met)
        for blown, met in ((wind, air), (by.R @ wind, by.air(air, yaw_rad)))
    ]
    aside = {"air": 0.5, "low": 0.3, "beside": 4.0, "tumbling": 0.2}.get(start, 0.0)
    height = {"air": 3.0, "low": 0.2, "beside": 0.6, "tumbling": 1.5, "deck": 0.0}[start]
    p, v, yaw = pads.p_ned[0, 0] + [aside, -aside, -height], pads.v_ned[0, 0] + rng.uniform(-0.5, 0.5, 3), rng.uniform(-3, 3)
    tumbling, w = Rotation.from_rpy(*rng.uniform(-2, 2, 3)), tuple(rng.uniform(-4, 4, 3).tolist())
    for each, there, at, speed, heading, R in (
        (fleet[0], worlds[0], p, v, yaw, tumbling),
        (fleet[1], worlds[1], by.R @ p + by.p, by.R @ v, yaw + yaw_rad, by.R @ tumbling),
    ):
        if start == "deck":
            each.stand(ground(there, 0, 0.0, 0.0), np.array([0.1, 0.2, -frame.feet.below_m]), 0.3)
        else:
            each.place(at, speed, heading)
        if start == "tumbling":
            each.q, each.w = R.quat_wxyz.tolist(), w
    fleet[0].current, fleet[1].current = (tuple(v[:2].tolist()) for v in (current, by.R @ current))
    for i in range(steps):
        if i % 80 == 0:
            sticks = (*rng.uniform(-1.0, 1.0, 2).tolist(), float(rng.choice([0.0, -0.5, 1.0])), 0.3, bool(rng.random() < 0.7))
            kind, extra = int(rng.integers(0, 6)), np.array([*rng.uniform(-4, 4, 2), 0.0])
            for each, gust in zip(fleet, (extra, by.R @ extra), strict=True):
                each.command(*sticks)
                disturb(each, kind, tuple(gust.tolist()))
        for each, there in zip(fleet, worlds, strict=True):
            for at, order in ((120, VehiclePhase.LANDING), (420, VehiclePhase.EMERGENCY)):
                if i == at and each.phase not in (VehiclePhase.LANDED, VehiclePhase.EMERGENCY):
                    each.phase = order
            if i == 40:
                each.take_off()
            each.step(ground(there, i, 0.1 * math.sin(i * DT), 0.1 * math.cos(i * DT)))
    ours, theirs = fleet
    assert by.R @ ours.p_ned + by.p == pytest.approx(theirs.p_ned, abs=1e-6)
    assert by.R @ ours.v_ned == pytest.approx(theirs.v_ned, abs=1e-5)
    assert by.R.matrix @ ours.R_ned_body == pytest.approx(theirs.R_ned_body, abs=1e-6)
    assert (ours.phase, ours.tied, ours.ditched, ours.touched_what) == (
        theirs.phase, theirs.tied, theirs.ditched, theirs.touched_what,
    )  # fmt: skip


@pytest.mark.parametrize("frame", [ardrone2(), HEXA])
def test_the_number_of_steps_of_a_call_changes_nothing(frame: Airframe) -> None:
    """Calls of random length against single steps: no noise is lost where a block ends, and the water is looked at as often."""
    rng, steps, done = np.random.default_rng(5), 900, 0
    waves, pads = Waves.draw(SeaState(1.0, 5.0), 4), moving_ground(rng, 900)
    decks, seed = decks_of(pads), np.random.SeedSequence(9)
    ours = [Vehicle(frame, SHAPES[0], DT, seed) for _ in range(2)]
    sensed = [Sensors(SensorSettings(), v, np.random.SeedSequence(4)) for v in ours]
    for v in ours:
        v.place(pads.p_ned[0, 0] + [0.3, 0.2, -1.0], pads.v_ned[0, 0], 0.3)
        v.land()
    by_one, by_many = (Physics(v, s, waves) for v, s in zip(ours, sensed, strict=True))
    for i in range(steps):
        assert by_one.run(decks, i, 1) == 1
    while done < steps:
        done += by_many.run(decks, done, min(int(rng.integers(1, 400)), steps - done))
    for many, one in ((ours[1].state, ours[0].state), (sensed[1].state, sensed[0].state)):
        assert bytes(SIM.ffi.buffer(many)) == bytes(SIM.ffi.buffer(one))
    assert ours[0].touched_what


H, W, TAPS = 10, 24, np.array([40000, 12000, 768], np.uint16)


def deck_samples(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    """Positions of texels from well outside the drawing on one side to the other, under a mask with every coverage."""
    across, down = np.meshgrid(np.linspace(-20.0, 70.0, W // 8 + 2), np.linspace(-15.0, 50.0, 2 + 2))
    cells = np.stack([across, down + 0.3 * across], axis=-1).astype(np.float32)
    texels = rng.integers(0, 65536, (32, 40, 4)).astype(np.uint16)
    mask = rng.integers(0, 256, (H, W)).astype(np.uint8)
    scene = rng.integers(0, 65536, (H, W, 4)).astype(np.uint16)
    part, drawn = library.new("dl_sim_frame_part", w=W, x1=W, y1=H), library.new("dl_sim_drawing", texels=texels, h=32, w=40)
    where = library.new("dl_sim_plane_cells", at=cells, columns=cells.shape[1])
    library.lib.dl_sim_render_deck(part, where, drawn, library.array("uint8_t", mask), library.array("uint16_t", scene))
    return scene


def lit(library: Door, rng: np.random.Generator) -> Any:
    """Return a scene in a light with a pad's paints and edges on it."""
    kinds, edges = (
        rng.integers(0, DL_PAD_PAINTS, (H, W)).astype(np.uint8),
        np.sort(rng.choice(H * W, 40, replace=False)).astype(np.int32),
    )
    kinds.flat[edges] = DL_PAD_EDGE
    return library.new(
        "dl_sim_lit_scene", h=H, w=W, edges=len(edges), where=edges, kinds=kinds,
        scene=rng.integers(0, 65536, (H, W, 4)).astype(np.uint16), gain=rng.integers(0, 16385, (H, W)).astype(np.int16),
        exposure=np.array([0.3, 0.9, 3.0, 0.0], np.float32),
        pad_scene=rng.integers(0, 65536, (DL_PAD_PAINTS, 4)).astype(np.uint16),
        shares=rng.dirichlet(np.ones(DL_PAD_PAINTS), len(edges)).astype(np.float32),
    )  # fmt: skip


def exposed(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    light = np.zeros(H * W * 3, np.int16)
    library.lib.dl_sim_render_expose(lit(library, rng), library.array("int16_t", light))
    return light


def imaged(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    """Return a frame by `dl_sim_render_image`, which the frame of the light by `dl_sim_render_expose` equals."""
    seen, light = lit(library, rng), library.array("int16_t", np.zeros(H * W * 3, np.int16))
    blur = library.new(
        "dl_sim_lens_blur", radius=2, numbers=20 * 3 * W, taps=TAPS, scratch=np.zeros(20 * 3 * W, np.uint16),
        window=np.array([3, 2, 20, 5], np.int32), added=rng.integers(-400, 400, (5, 3, 20)).astype(np.int16),
    )  # fmt: skip
    noise, codes = rng.integers(0, 32, (H, W, 3)).astype(np.uint8), rng.integers(0, 256, 65536).astype(np.uint8)
    tone = library.new("dl_sim_sensor_tone", noise=noise, codes=codes)
    frame, again = np.zeros((H, W, 3), np.uint8), np.zeros((H, W, 3), np.uint8)
    assert library.lib.dl_sim_render_image(seen, blur, tone, library.array("uint8_t", frame))
    library.lib.dl_sim_render_expose(seen, light)
    library.lib.dl_sim_render_mix(seen, light)
    assert library.lib.dl_sim_render_frame(H, W, light, blur, tone, library.array("uint8_t", again))
    assert np.array_equal(frame, again)
    blur.numbers = 3 * W
    assert not library.lib.dl_sim_render_image(seen, blur, tone, library.array("uint8_t", frame))
    return frame


def smeared(library: Door, rng: np.random.Generator) -> NDArray[Any]:
    scene, out = rng.integers(0, 65000, (H, W, 4)).astype(np.uint16), np.zeros((2, H, W, 4), np.uint16)
    shifts, weights = np.array([(-2, 1), (0, 0), (2, -1)], np.int32), np.array([20000, 25000, 20000], np.uint16)
    weighed = library.array("int32_t", shifts), library.array("uint16_t", weights)
    seen, (first, second) = library.array("uint16_t", scene), (library.array("uint16_t", each) for each in out)
    library.lib.dl_sim_render_smear(H, W, seen, 3, *weighed, first)
    library.lib.dl_sim_render_average(H, W, seen, weighed[0], second)
    return out


@pytest.fixture(scope="module")
def one_by_one(tmp_path_factory: pytest.TempPathFactory) -> Door:
    folder: Path = tmp_path_factory.mktemp("core")
    renderer = core.SIMULATED.part("base/digest.c", "render/*.c", "sea/*.c")
    return Door(abi, str(core.build(renderer, folder / "one_by_one.so", ("-DLANES_ONE_BY_ONE", "-O0"))))


@pytest.mark.parametrize("step", [deck_samples, exposed, imaged, smeared])
def test_a_machine_without_vector_instructions_renders_the_same_bits(one_by_one, step):
    here, there = step(SIM, np.random.default_rng(5)), step(one_by_one, np.random.default_rng(5))
    assert np.array_equal(here, there)
    assert np.ptp(here) > 100
