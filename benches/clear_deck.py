"""Measure what is seen on the pad in rendered approaches.

python -m benches.clear_deck [--runs N] [--clear N] [--bodies N] [--leans]

The camera comes down from 5 m to 0.9 m over the pad in 41 frames, swings, and drifts beside the axis. The tracker has a
prediction that is off by 5 mm at one sigma. Light, exposure, white balance, wear, glare, wet paint and the drone's own shadow are
random. Things are squares of 0.1 to 0.5 m that lie anywhere within the disc. Their luminance differs from the disc's by
`--contrast`; a third is grey, a third of any hue, and a third of the disc's own hue. Seen counts what is there in the last frame;
where the pad is sure in fewer than three of the last ten frames, nobody lands; where a part of it is in glare, the operator is
asked. Bodies are crates of 0.3 to 1 m and people of 0.8 to 1.8 m that stand 0.3 to 0.7 m beside the disc, and people, birds and
drones on their way over the pad and back: seen counts any frame. Half of these approaches and of the clear ones are over a small
deck with waves about it. `--scenarios` comes down on the ships of scenarios. With `--leans` the camera is under an autopilot in
wind: it comes from aside, leans by 6 to 26 degrees and swings beyond that, over the pad at 5 to 7 m for six seconds first.
With `--hovers` it waits for a minute beside and over the empty pad of a ship, two pads in turn, and what counts is how long
something was there at a stretch. Its camera takes 30 frames/s, and those in which the tracker reads the deck are drawn.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from benches.options import described, parsed
from benches.search import SIGMA_YAW_RAD
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detection import PadCheck
from estimator.vision.options import TrackerOptions
from estimator.vision.srgb import LUMA, linear_light
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Sensor
from sitl.camera.picture_effects import PictureEffects
from sitl.camera.surroundings import RGB, Decal, Deck, Surroundings
from sitl.faults.kinds import Bystander
from sitl.scenario.scenario import Scenario, camera_model, pad_model
from sitl.scenario.scenario import load as load_scenario
from sitl.sea.sea import SEA_STATES, Waves
from sitl.vessel.vessel import Vessel
from sitl.world.stage import renderer as renderer_of
from sitl.world.stage import sea_and_vessel
from tests.support.pad_scenes import DECK_PAINTS, load_camera, load_pad, random_light, truth_of

LIGHTS = ("light", "plain", "wet", "shadow", "glare", "mast", "dusk")
BODIES = ("crate", "stands", "walks", "bird", "drone")
HUES = ("grey", "any hue", "disc's hue")
HIGH_M, LOW_M, FRAMES, PERIOD_S = 5.0, 0.9, 41, 0.1
HOVER_SEAS = (
    *("demo", "ferry", "patrol_boat", "glint", "dusk", "rain", "weather_4", "weather_6"),
    *(f"sea_state_{k}" for k in range(7)),
)
HOVER_PADS, BARS_S = ("thesis", "printed"), 5.0
LAST, LAST_SURE = 10, 3


@dataclass(frozen=True, slots=True)
class Approached:
    """Findings of an approach."""

    check: PadCheck | None
    """The check in the last frame."""
    first_m: float
    """Greatest height at which something was seen on the pad, 0 for none."""
    near_m: float
    """The same about it."""
    lands: bool
    """True if the pad is sure in the last frames."""
    held_s: float
    """Longest time at a stretch for which something was there, on it or about it."""

    @property
    def asks(self) -> bool:
        """True if glare hides a part of the pad in the last frame."""
        return self.check is not None and self.check.glare > 0.0


def paint(rng: np.random.Generator, hue: str, contrast: float, disc: RGB) -> RGB:
    """Return a colour whose luminance differs from the disc's by a factor 1 +- contrast or a little more."""
    base = linear_light(disc)
    rgb = np.ones(3) if hue == "grey" else base if hue == "disc's hue" else rng.uniform(0.05, 1.0, 3)
    want = float(base @ LUMA) * (1.0 + contrast * float(rng.choice([-1.0, 1.0])))
    light = np.clip(rgb * want / float(rgb @ LUMA), 0.0, 1.0)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055) * 255.0
    r, g, b = np.rint(srgb).astype(int).tolist()
    return r, g, b


def drawn_by(seed: int, light: str, things: tuple[Decal, ...], tracker: TrackerConfig, rng: np.random.Generator) -> Renderer:
    """Return what renders an approach; about every other seed has a small deck on waves."""
    lit = random_light(rng, "shadow" if light == "mast" else light)
    if light == "dusk":
        lit = replace(lit, colour_temperature_k=9000.0, drone_shadow=0.0, visibility_m=400.0)
    if light == "mast":
        lit = replace(lit, mast_height_m=3.0, mast_forward_m=1.0, mast_right_m=float(rng.uniform(-1, 1)))
    small = seed // 6 % 2 == 1
    deck = Deck(5.0, 2.8, (0.6, 0.0), 0.0) if small else Deck(8.0, 5.0, (0.0, 0.0), 0.0)
    waves = Waves.draw(SEA_STATES[4], seed % 6) if small else None
    # Twelve approaches share a deck, whose wear takes as long to draw as half an approach.
    around = Surroundings(replace(deck, paint=DECK_PAINTS[seed // 12 % 4], seed=seed // 12 % 7), waves, things)
    sensor = Sensor(
        float(rng.choice([0.002, 0.008])), float(rng.uniform(0.5, 1.0)), full_well_e=500.0 if light == "dusk" else 8000.0
    )
    return Renderer(tracker.camera, tracker.pad, around, lit, sensor)


class Flown(NamedTuple):
    """The camera's vehicle at an instant, from the pad and against the level."""

    place_m: NDArray[np.float64]
    v_m_s: NDArray[np.float64]
    roll: float
    pitch: float
    w_rad_s: NDArray[np.float64] | None = None
    """None for one that is drawn."""


Way = Callable[[float], Flown]


def swinging(rng: np.random.Generator) -> Way:
    """Return a way straight down that swings a little."""
    phase = rng.uniform(0, math.tau, 4)

    def at(t: float) -> Flown:
        height_m = HIGH_M + (LOW_M - HIGH_M) * t / (PERIOD_S * (FRAMES - 1))
        roll, pitch = (0.05 * math.sin(1.3 * t + p) for p in phase[:2])
        x, y = (0.06 * height_m * math.sin(0.9 * t + p) for p in phase[2:])
        v = np.array([0.05 * height_m * math.cos(0.9 * t + phase[2]), 0.05 * height_m * math.cos(0.9 * t + phase[3]), 0.9])
        return Flown(np.array([x, y, -height_m]), v, roll, pitch)

    return at


def leaning(rng: np.random.Generator) -> Way:
    """Return a way over the pad from aside, and then down, of a vehicle that leans against the wind."""
    lean, lee, from_m, bearing, high_m = rng.uniform((0.1, -math.pi, 0.5, -math.pi, 5.0), (0.45, math.pi, 2.5, math.pi, 7.0))
    phase, aside = rng.uniform(0, math.tau, 6), from_m * np.array([math.cos(bearing), math.sin(bearing)])
    slow, quick, wander = np.array([1.5, 1.4]), np.array([4.0, 3.7]), np.array([0.8, 0.9])

    def at(t: float) -> Flown:
        left, down_s = math.exp(-t / 3.0), max(0.0, t - 6.0)
        turns = slow * t + phase[:2], quick * t + phase[2:4], wander * t + phase[4:]
        roll, pitch = (
            lean * np.array([math.sin(lee), math.cos(lee)]) + 0.12 * np.sin(turns[0]) + 0.05 * np.sin(turns[1])
        ).tolist()
        w = np.array([*(0.12 * slow * np.cos(turns[0]) + 0.05 * quick * np.cos(turns[1])), 0.0])
        place, v = aside * left + 0.35 * np.sin(turns[2]), -aside * left / 3.0 + 0.35 * wander * np.cos(turns[2])
        return Flown(np.array([*place, 0.6 * down_s - high_m]), np.array([*v, 0.6 if down_s else 0.0]), roll, pitch, w)

    return at


def hovering(rng: np.random.Generator) -> Way:
    """Return a way of a vehicle that waits beside the pad, over it or between, and sways in the wind."""
    high_m, aside_m, bearing, lean, lee = rng.uniform((2.0, 0.0, -math.pi, 0.0, -math.pi), (5.5, 1.5, math.pi, 0.15, math.pi))
    phase, aside = rng.uniform(0, math.tau, 7), aside_m * np.array([math.cos(bearing), math.sin(bearing)])
    slow, wander, rise = np.array([1.5, 1.4]), np.array([0.5, 0.6]), 0.7

    def at(t: float) -> Flown:
        turns, ways = slow * t + phase[:2], wander * t + phase[2:4]
        roll, pitch = (lean * np.array([math.sin(lee), math.cos(lee)]) + 0.08 * np.sin(turns)).tolist()
        w = np.array([*(0.08 * slow * np.cos(turns)), 0.0])
        place, v = aside + 0.25 * np.sin(ways), 0.25 * wander * np.cos(ways)
        up, climb = 0.3 * math.sin(rise * t + phase[4]), 0.3 * rise * math.cos(rise * t + phase[4])
        return Flown(np.array([*place, up - high_m]), np.array([*v, climb]), roll, pitch, w)

    return at


class Course(NamedTuple):
    """A kind of way, and the frames that are taken on it."""

    way: Callable[[np.random.Generator], Way]
    frames: int
    period_s: float = PERIOD_S
    reads_alone: bool = False
    """True to draw none but the frames in which the tracker reads the deck."""


DOWN, LEANS, HOVER = Course(swinging, FRAMES), Course(leaning, 110), Course(hovering, 1800, 1 / 30, reads_alone=True)


def hovers(runs: range) -> None:
    """Print the hovers over an empty deck in which something was there for so long that it holds a landing."""
    barred = 0
    for n, seed in enumerate(runs):
        name, pad = HOVER_SEAS[seed % len(HOVER_SEAS)], HOVER_PADS[seed // len(HOVER_SEAS) % len(HOVER_PADS)]
        scenario = load_scenario(name)
        of = over_ship(seed, replace(scenario, pad=replace(scenario.pad, file=pad)), HOVER)
        barred += of.held_s >= BARS_S
        if of.held_s or of.asks:
            print(f"  hover {n + 1}, seed {seed}, {name}, {pad}: something for {of.held_s:.1f} s, {of.check}", flush=True)
    print(f"hovers: {barred} of {len(runs)} barred for {BARS_S:g} s and more", flush=True)


def over_ship(seed: int, scenario: Scenario, course: Course = DOWN) -> Approached:
    """Return what an approach to the clear pad of a scenario's ship shows, in its sea and light."""
    waves, vessel = sea_and_vessel(scenario, [seed])
    film = renderer_of(scenario, waves, vessel, seed)
    tracker = TrackerConfig(camera_model(scenario), pad_model(scenario), TrackerOptions())
    return followed(tracker, vessel, film.render, np.random.default_rng([50, seed]), course)


def approach(
    seed: int,
    light: str,
    things: tuple[Decal, ...],
    tracker: TrackerConfig,
    bodies: tuple[Bystander, ...] = (),
    course: Course = DOWN,
) -> Approached:
    """Return what an approach to a pad at rest shows."""
    rng = np.random.default_rng([50, seed])
    renderer = drawn_by(seed, light, things, tracker, rng)
    effects = PictureEffects(tracker.camera, tracker.pad, renderer.light, seed)

    def image(shot: Exposure, rng: np.random.Generator) -> NDArray[np.uint8]:
        return effects.drawn(renderer.render(shot, rng), bodies, shot, rng)

    return followed(tracker, None, image, rng, course)


def followed(
    tracker: TrackerConfig,
    vessel: Vessel | None,
    image: Callable[[Exposure, np.random.Generator], NDArray[np.uint8]],
    rng: np.random.Generator,
    course: Course,
) -> Approached:
    """Return what the tracker makes of an approach to the pad of a vessel, or to one at rest."""
    memory, check, first_m, near_m, sure, clear_s, held_s = TrackerMemory(), None, 0.0, 0.0, 0, 0.0, 0.0
    yaw, flown, view = float(rng.uniform(-math.pi, math.pi)), course.way(rng), None
    p_pad, v_pad, w_pad, R_pad = np.array([0.0, 0.0, -0.6]), np.zeros(3), np.zeros(3), Rotation.identity()
    for k in range(course.frames):
        t = k * course.period_s
        if vessel is not None:
            pad = vessel.pad_at(t)
            p_pad, v_pad, w_pad, R_pad = pad.p_ned, pad.v_ned, pad.w, Rotation(pad.R_ned)
        is_at = flown(t)
        R, p_body = Rotation.from_rpy(is_at.roll, is_at.pitch, yaw), p_pad + is_at.place_m
        w = rng.normal(0, 0.1, 3) if is_at.w_rad_s is None else is_at.w_rad_s
        shot = Exposure(t, R, p_body, R_pad, p_pad, is_at.v_m_s + v_pad, w, v_pad, w_pad)
        stamp = Stamp(MonoNs(round(1e9 * (1.0 + t))), MonoNs(round(1e9 * (1.0 + t))), 0.0, "sim")
        if view is not None and not memory.deck.is_due(stamp.measured_at, view, truth_of(shot, tracker.camera)):
            continue
        px = image(shot, rng)
        view = FrameView(Pyramid(px), tracker.camera, tracker.pad) if course.reads_alone else None
        d_level = Rotation.from_rpy(0.0, 0.0, yaw).inv @ (p_pad - p_body) + rng.normal(0.0, 0.005, 3)
        belief = RelativeState(
            stamp.measured_at, "ekf", d_level, np.zeros(3), wrap_pi(yaw - R_pad.rpy_rad[2] + float(rng.normal(0, 0.005))),
            np.diag([0.005**2] * 3 + [0.01] * 3 + [SIGMA_YAW_RAD**2]), stamp.measured_at, True,
        )  # fmt: skip
        attitude = Attitude(stamp, Rotation.from_rotvec(rng.normal(0, 0.005, 3)) @ R, np.eye(3) * 0.006**2)
        seen, memory = track(tracker, memory, Frame(stamp, k, px), attitude, belief if k else None)
        sure += k >= course.frames - LAST and seen.selected is not None and seen.selected.confidence >= 0.5
        on, about = (None, None) if seen.on_pad is None else (seen.on_pad.thing, seen.on_pad.near)
        check = seen.on_pad or check
        first_m = first_m or (0.0 if on is None else -is_at.place_m[2])
        near_m = near_m or (0.0 if about is None else -is_at.place_m[2])
        clear_s = t if on is None and about is None else clear_s
        held_s = max(held_s, t - clear_s)
    return Approached(check, first_m, near_m, sure >= LAST_SURE, held_s)


def with_things(runs: range, contrast: float, lights: tuple[str, ...], tracker: TrackerConfig) -> None:
    """Print the share of things that were seen, by size and hue."""
    if not runs:
        return
    seen: dict[tuple[str, str], list[tuple[bool, bool, bool]]] = defaultdict(list)
    heights: list[float] = []
    for seed in runs:
        rng = np.random.default_rng([51, seed])
        size_m, hue = float(rng.uniform(0.1, 0.5)), HUES[seed % 3]
        light = lights[int(rng.integers(len(lights)))]
        a, r = rng.uniform(0, math.tau), (tracker.pad.disc_radius_m - 0.5 * size_m) * math.sqrt(rng.uniform())
        colour = paint(rng, hue, contrast, tracker.pad.markings.colours.disc)
        thing = Decal("crate", (r * math.cos(a), r * math.sin(a)), size_m, float(rng.uniform(0, math.pi)), "pad", colour)
        of = approach(seed, light, (thing,), tracker)
        check, found = of.check, of.check is not None and of.check.thing is not None
        heights += [of.first_m] if found else []
        for key in ((hue, "15 cm and more" if size_m >= 0.15 else "less"), ("all", light)):
            seen[key].append((found, of.asks and not found, of.lands and not found and not of.asks))
        if not found:
            why = "no pad" if not of.lands else "asked" if of.asks else "not seen"
            print(f"  {why}: seed {seed}, {100 * size_m:.0f} cm, {hue}, {light}, {100 * r:.0f} cm off, {check}", flush=True)
    for key, each in sorted(seen.items()):
        found_n, asked_n, missed_n = np.sum(each, axis=0)
        print(f"{', '.join(key)}: {found_n} of {len(each)} seen, {asked_n} more asked about, {missed_n} landed upon", flush=True)
    print(f"first seen at {np.median(heights or [0.0]):.1f} m in the median", flush=True)


def without(runs: range, lights: Sequence[str], tracker: TrackerConfig | None, course: Course) -> None:
    """Print the number of clear approaches in which something is seen at any time; None flies in scenarios of these names."""
    wrong: dict[str, list[tuple[bool, bool, bool]]] = defaultdict(list)
    for seed in runs:
        light = lights[seed % len(lights)]
        if tracker is None:
            of = over_ship(seed, load_scenario(light), course)
        else:
            of = approach(10_000 + seed, light, (), tracker, course=course)
        wrong[light].append((of.first_m > 0.0, of.near_m > 0.0, of.asks))
        if of.first_m or of.near_m:
            where = f"on it from {of.first_m:.1f} m, about it from {of.near_m:.1f} m"
            print(f"  false: seed {seed}, {light}, {where}, {of.check}", flush=True)
    for light, each in wrong.items():
        on, about, asked = np.sum(each, axis=0)
        print(f"clear, {light}: {on} of {len(each)} with something seen on the pad, {about} about it, {asked} asked", flush=True)


def with_bodies(runs: range, tracker: TrackerConfig, course: Course) -> None:
    """Print the share of bodies about the pad that were seen, by kind."""
    seen: dict[str, list[tuple[bool, bool]]] = defaultdict(list)
    for seed in runs:
        rng, kind = np.random.default_rng([52, seed]), BODIES[seed % len(BODIES)]
        light = LIGHTS[int(rng.integers(len(LIGHTS)))]
        a, r = rng.uniform(0, math.tau), tracker.pad.disc_radius_m + float(rng.uniform(0.3, 0.7))
        x, y = r * math.cos(a), r * math.sin(a)
        stands = Bystander(at_s=0.0, forward_m=x, right_m=y)
        walks = replace(stands, to_forward_m=-x, to_right_m=-y, speed_m_s=float(rng.uniform(0.6, 1.4)))
        body = {
            "crate": replace(stands, thing="box", width_m=float(rng.uniform(0.2, 0.6)), height_m=float(rng.uniform(0.3, 1.0))),
            "stands": replace(stands, height_m=float(rng.uniform(0.8, 1.8))),
            "walks": walks,
            "bird": replace(walks, thing="bird", height_m=1.2, speed_m_s=float(rng.uniform(0.5, 2.0))),
            "drone": replace(walks, thing="drone", height_m=1.0, speed_m_s=float(rng.uniform(0.2, 0.8))),
        }[kind]
        of = approach(20_000 + seed, light, (), tracker, (body,), course)
        kept = of.check is not None and (of.check.thing is not None or of.check.near is not None)
        seen[kind].append((max(of.first_m, of.near_m) > 0.0, kept))
        where = f"{seed}, {kind}, {light}, {body.height_m:.1f} m high, {r:.2f} m off"
        print(f"  {where}: on the pad from {of.first_m:.1f} m, about it from {of.near_m:.1f} m, {of.check}", flush=True)
    for kind, each in seen.items():
        found, kept = np.sum(each, axis=0)
        print(f"{kind}: {found} of {len(each)} seen, {kept} in the last frame", flush=True)


def main() -> None:
    parser = described(__doc__)
    parser.add_argument("--runs", type=int, default=60, help="approaches with a thing")
    parser.add_argument("--clear", type=int, default=60, help="approaches without one")
    parser.add_argument("--bodies", type=int, default=0, help="approaches with a body about the pad")
    parser.add_argument("--hovers", type=int, default=0, help="hovers of a minute over an empty deck")
    parser.add_argument("--first", type=int, default=0, help="number of the first of both")
    parser.add_argument("--contrast", type=float, default=0.1, help="difference of luminance from the disc's")
    parser.add_argument("--scenarios", help="clear approaches over the ships of these scenarios, with commas")
    parser.add_argument("--light", choices=LIGHTS, help="fly in this light alone")
    parser.add_argument("--leans", action="store_true", help="clear approaches and those with a body lean against the wind")
    args = parsed(parser, "--runs 1 --clear 0")
    lights = LIGHTS if args.light is None else (args.light,)
    cv2.setNumThreads(1)
    tracker = TrackerConfig(load_camera("sim"), load_pad("thesis"), TrackerOptions())
    clear, course = range(args.first, args.first + args.clear), LEANS if args.leans else DOWN
    ships = args.scenarios.split(",") if args.scenarios else ()
    without(clear, ships or lights, None if ships else tracker, course)
    with_things(range(args.first, args.first + args.runs), args.contrast, lights, tracker)
    with_bodies(range(args.first, args.first + args.bodies), tracker, course)
    if args.hovers:
        hovers(range(args.first, args.first + args.hovers))


if __name__ == "__main__":
    main()
