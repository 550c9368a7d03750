"""Search and track a pad in sixty conditions, or time both: `python -m benches.search [--only CONDITIONS | --times | --lost]`.

A row has the percentage of frames in which a search without a belief finds the pad, sure and right; in which one within a
flight's budget does so within three frames; in which a track does whose belief is off by 2 cm or 0.4 % at one sigma; the error of
the tracked range, median and 95th percentile; finds that are right, denied (below 0.5), and finds that are sure and wrong. The
heights are 0.5 to 10 m, those over other pads as their size. The last rows show no pad. The curve has every find of all looks by
its confidence: where that is calibrated, its mean is the share that is right.

`--times` prints the processor time of a whole tracked look by height, in floors (one BGR to HSV conversion and one inRange), the
smallest of 25 of both, the median of six frames; `--lost` that of frames without a pad where one is expected.
"""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from benches.options import described, parsed
from benches.real import SHIPPED, STAMP, Looks, curve_of
from companion.tools.pad_price import view
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.options import TrackerOptions
from estimator.vision.pad.pad import Pad
from estimator.vision.srgb import LINEAR_LIGHT
from estimator.vision.track.config import FRAME_WORK, TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from sitl.camera.light import Light, Sensor
from tests.support.deck_images import CLAIM_RANGE, CLAIM_RANGE_PX
from tests.support.hard_light import HARD, THESIS, U8, compressed, defocused, dusk, grey, haze, shifted
from tests.support.pad_scenes import PadScene, empty_scene, load_camera, load_pad, pad_scene, ring_scene

HEIGHTS_M = (0.5, 1.2, 2.5, 5.0, 10.0)
SIM, EMPTY = load_camera("sim"), ("empty", "rings", "clutter")
BESIDE, CUT = 0.25, 1.1
"""Radii of the disc that the middle of a right find's outline lies from the pad's at most; of a pad that is cut or covered."""
TIMED_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
FRAMES_HZ = 30.0
READ_HZ, LOW_HZ, LOW_M = (3.75, 3.75, 5.0), 10.0, 1.0
"""Readings a second of the pad's surface, its surroundings and what passes, in a stream of `FRAMES_HZ`; of the last one, low."""
SIGMA_ATTITUDE_RAD, SIGMA_DECK_RAD, SIGMA_YAW_RAD = math.radians(1.0), math.radians(2.0), 0.02
TONES: dict[str, Callable[[F64], F64]] = {
    "sRGB": lambda x: np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055),
    "linear": lambda x: x,
    "clipped": lambda x: np.minimum(TONES["sRGB"](1.8 * x), 1.0),
    "gamma 2.2": lambda x: np.asarray(x ** (1 / 2.2)),
    "gamma 1.8": lambda x: np.asarray(x ** (1 / 1.8)),
    "gamma 2.6": lambda x: np.asarray(x ** (1 / 2.6)),
    "BT.709": lambda x: np.where(x < 0.018, 4.5 * x, 1.099 * x**0.45 - 0.099),
    "s-curve": lambda x: TONES["sRGB"](x) + 0.06 * np.sin(math.tau * (TONES["sRGB"](x) - 0.5)),
}
"""Values, 0..1, by light, 0..1, of cameras. Source: IEC 61966-2-1, ITU-R BT.709."""
Change = Callable[[U8, np.random.Generator], U8]


def _same(px: U8, _: np.random.Generator) -> U8:
    return px


@dataclass(frozen=True)
class Condition:
    """Differences of frames, pads and cameras from plain ones."""

    scene: str = "plain"
    change: Change = _same
    pad: Pad = THESIS
    camera: Camera = SIM
    told: Camera | None = None
    """Camera that the tracker takes the frames for; None if it is the true one."""
    light: Light | None = None
    sensor: Sensor | None = None


def lens(width: int, height: int, degrees: float) -> Camera:
    """Return a camera of so many pixels and of so wide a view along the rows."""
    f = 0.5 * width / math.tan(math.radians(0.5 * degrees))
    return replace(SIM, width=width, height=height, fx=f, fy=f, cx=(width - 1) / 2, cy=(height - 1) / 2)


def toned(values: Callable[[F64], F64]) -> Change:
    """Return what a camera of another tone curve shows."""
    curve = np.rint(255.0 * np.clip(values(LINEAR_LIGHT), 0.0, 1.0)).astype(np.uint8)
    return lambda px, _: np.asarray(curve[px], np.uint8)


def lit(px: U8, light: F64) -> U8:
    """Return a frame with so many times the light, (H, W) or (H, W, 3), in every pixel."""
    values = TONES["sRGB"](np.clip(LINEAR_LIGHT[px] * light.reshape(*light.shape[:2], -1), 0.0, 1.0))
    return np.asarray(np.rint(255.0 * values), np.uint8)


def places(px: U8, rng: np.random.Generator) -> tuple[F64, F64]:
    """Return for each pixel its distance along a random direction from a random place near the middle, and from that place."""
    v, u = np.mgrid[: px.shape[0], : px.shape[1]].astype(float)
    a, b, turn = *rng.normal(0.0, 0.08, 2), rng.uniform(0.0, math.pi)
    u, v = u - px.shape[1] * (0.5 + a), v - px.shape[0] * (0.5 + b)
    return u * math.cos(turn) + v * math.sin(turn), np.hypot(u, v)


def mast(px: U8, rng: np.random.Generator) -> U8:
    along, _ = places(px, rng)
    return lit(px, 1.0 - 0.75 / (1.0 + np.exp((np.abs(along) - 0.04 * px.shape[1]) / 1.5)))


def led(px: U8, rng: np.random.Generator) -> U8:
    """Return a frame at night by the vehicle's own lamp, and the noise of a gain of six."""
    _, away = places(px, rng)
    dark = lit(px, np.exp(-((away / (0.3 * px.shape[1])) ** 2)) * 0.5)
    return np.asarray(np.clip(dark + rng.normal(0.0, 8.0, px.shape), 0, 255), np.uint8)


def glints(px: U8, rng: np.random.Generator) -> U8:
    add = np.zeros(px.shape[:2], np.float32)
    for _ in range(12):
        at = tuple((np.array(px.shape[1::-1]) * rng.uniform(0.2, 0.8, 2)).astype(int).tolist())
        cv2.ellipse(add, at, (int(rng.uniform(4, 30)), int(rng.uniform(2, 8))), float(rng.uniform(0, 180)), 0, 360, 1.0, -1)
    return np.asarray(np.clip(px + 255.0 * cv2.GaussianBlur(add, (0, 0), 1.5)[..., None], 0, 255), np.uint8)


def rolled(px: U8, rng: np.random.Generator) -> U8:
    """Return what a rolling shutter makes of a frame in which everything moves by up to twelve pixels meanwhile."""
    v, u = np.mgrid[: px.shape[0], : px.shape[1]].astype(np.float32)
    du, dv = rng.uniform(-12.0, 12.0, 2)
    share = v / px.shape[0] - 0.5
    moved_u, moved_v = (u + du * share).astype(np.float32), (v + dv * share).astype(np.float32)
    return np.asarray(cv2.remap(px, moved_u, moved_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def noisy(sigma: float) -> Change:
    return lambda px, rng: np.asarray(np.clip(px + rng.normal(0.0, sigma, px.shape), 0, 255), np.uint8)


def both(first: Change, then: Change) -> Change:
    return lambda px, rng: then(first(px, rng), rng)


def painted(**rgb: tuple[int, int, int]) -> Pad:
    return replace(THESIS, paints=tuple((name, rgb.get(name, own)) for name, own in THESIS.paints))


def white_balance(px: U8, _: np.random.Generator) -> U8:
    return lit(px, np.broadcast_to(np.array([1.25, 1.0, 0.8]), px.shape))


def daylight(stops: float) -> Condition:
    return Condition(light=Light(daylight_ev=stops, exposure_ev=-stops - 0.5))


OTHER_F = replace(SIM, fx=1.02 * SIM.fx, fy=1.02 * SIM.fy)
FISHEYE = replace(SIM, fx=0.8 * SIM.fx, fy=0.8 * SIM.fy, distortion=np.array([0.01, -0.004, 0.001, 0.0]), lens="fisheye")
CONDITIONS: Mapping[str, Condition] = {
    **{name: Condition(of.scene, of.change, of.pad) for name, of in HARD.items()},
    **{name: Condition(name) for name in ("half covered", "half cut", "half shaded")},
    "haze 50": Condition(change=haze(0.5)), "haze 90": Condition(change=haze(0.1)),
    "grey haze 40": Condition(change=both(grey, haze(0.4))), "dusk 3 %": Condition(change=dusk(0.03, 12.0)),
    "night by own lamp": Condition(change=led), "tenth of light": daylight(-3.3), "mast shadow": Condition(change=mast),
    "worn 15": Condition(light=Light(wear=0.15)), "worn 30": Condition(light=Light(wear=0.3)),
    "glints": Condition(change=glints), "sea glint": Condition(light=Light(glint=1.0)),
    "fog 20 m": Condition(light=Light(visibility_m=20.0)), "white balance": Condition(change=white_balance),
    "noise 25": Condition(change=noisy(25.0)), "motion 5 px": Condition(change=shifted(5)),
    "exposure 30 ms": Condition(sensor=Sensor(exposure_s=0.03)), "defocus 1.5 px": Condition(change=defocused(1.5)),
    "lens 1.2 px": Condition(sensor=Sensor(psf_sigma_px=1.2)), "rolling": Condition(change=rolled),
    "jpeg 20": Condition(change=compressed(20)), "jpeg 8 grey": Condition(change=both(grey, compressed(8))),
    "linear camera": Condition(change=toned(TONES["linear"])), "clipped camera": Condition(change=toned(TONES["clipped"])),
    "BT.709 camera": Condition(change=toned(TONES["BT.709"])), "s-curve camera": Condition(change=toned(TONES["s-curve"])),
    "160x120": Condition(camera=lens(160, 120, 80.0)), "320x240": Condition(camera=lens(320, 240, 80.0)),
    "1280x720": Condition(camera=lens(1280, 720, 80.0)), "90 degrees": Condition(camera=lens(640, 360, 90.0)),
    "110 degrees": Condition(camera=lens(640, 360, 110.0)), "fisheye": Condition(camera=FISHEYE),
    "focal 2 % wrong": Condition(told=OTHER_F), "red pad": Condition(pad=painted(green=(150, 20, 20))),
    "blue on yellow": Condition(pad=painted(green=(240, 200, 20), white=(10, 40, 150))),
    "H on grey deck": Condition(pad=painted(green=(112, 118, 122))),
    **{name: Condition("light", pad=load_pad(name)) for name in SHIPPED if name != "thesis"},
    **{name: Condition() for name in EMPTY},
}  # fmt: skip


def scene_of(name: str, of: Condition, height_m: float, rng: np.random.Generator) -> PadScene:
    """Return a random frame in a condition; where there is a pad the vehicle sends its attitude."""
    if name == "clutter":
        size = of.camera.width, of.camera.height
        seen = np.asarray(cv2.resize(view(int(rng.integers(10**6, 10**7))), size, interpolation=cv2.INTER_CUBIC), np.uint8)
        return PadScene(seen, None, Rotation.identity(), height_m, 0.0, name)
    if name in EMPTY:
        return (empty_scene if name == "empty" else ring_scene)(rng, of.camera, height_m)
    while True:
        made = pad_scene(
            rng, of.camera, of.pad, height_m * of.pad.disc_radius_m / THESIS.disc_radius_m, of.scene, None, of.light, of.sensor
        )
        if made.R_level_body is not None:
            return replace(made, px=of.change(made.px, rng))


def range_error(found: Sighting, truth: PadPose, camera: Camera) -> float:
    """Return the error of the distance between body and pad, as a fraction."""
    from_body = camera.T_body_cam.R @ truth.t_cam_pad + camera.T_body_cam.t
    return float(np.linalg.norm(found.d_body_pad_level)) / float(np.linalg.norm(from_body)) - 1.0


def is_right(found: Sighting, scene: PadScene, truth: PadPose, camera: Camera, pad: Pad) -> bool:
    """Return whether a find has the pad's range, and its outline lies about the pad's place in the frame."""
    radius_px = camera.fx * pad.disc_radius_m / float(truth.t_cam_pad[2])
    points = np.concatenate([line.uv_px for line in found.features if len(line.uv_px)])
    points = points[np.isfinite(points).all(axis=1)]
    beside_px = float(np.linalg.norm(points.mean(axis=0) - camera.project(truth.t_cam_pad[None])[0]))
    near_px = (BESIDE if scene.visible > 0.98 else CUT) * radius_px + 2.0
    off = abs(range_error(found, truth, camera))
    return beside_px < near_px and off < CLAIM_RANGE + CLAIM_RANGE_PX / radius_px


def expected(
    scene: PadScene, R_level_body: Rotation, tracker: TrackerConfig, rng: np.random.Generator, sigma_m: float
) -> tuple[RelativeState, Attitude, F64]:
    """Return a belief, the attitude, and the true vector from body to pad in `level`, (3,) m."""
    assert scene.truth is not None
    mount = tracker.camera.T_body_cam
    d_level = R_level_body @ (mount.R @ scene.truth.t_cam_pad + mount.t)
    arrow = (R_level_body @ mount.R @ scene.truth.R_cam_pad).matrix[:, 0]
    belief = RelativeState(
        STAMP.measured_at, "ekf", d_level + rng.normal(0.0, sigma_m, 3), np.zeros(3),
        -math.atan2(arrow[1], arrow[0]) + rng.normal(0.0, SIGMA_YAW_RAD),
        np.diag([sigma_m**2] * 3 + [0.01] * 3 + [SIGMA_YAW_RAD**2]), STAMP.measured_at, True,
    )  # fmt: skip
    return belief, Attitude(STAMP, R_level_body, np.eye(3) * SIGMA_ATTITUDE_RAD**2), d_level


@dataclass
class Counts:
    """Finds in one condition, by kind of look."""

    searched: Looks = field(default_factory=Looks)
    in_three: Looks = field(default_factory=Looks)
    tracked: Looks = field(default_factory=Looks)
    off: list[float] = field(default_factory=list)
    denied: int = 0

    def looks(self) -> list[Looks]:
        return [self.searched, self.in_three, self.tracked]


def look(scene: PadScene, of: Condition, rng: np.random.Generator, counts: Counts) -> None:
    """Search and track one frame, and count what is found."""
    camera, pad, truth = of.told or of.camera, of.pad, scene.truth
    R = scene.R_level_body or Rotation.identity()
    attitude = Attitude(STAMP, R, np.eye(3) * SIGMA_ATTITUDE_RAD**2)
    whole, flown = TrackerConfig(camera, pad, search_work=math.inf), TrackerConfig(camera, pad, search_work=FRAME_WORK)

    def right(found: Sighting) -> bool:
        return truth is not None and is_right(found, scene, truth, of.camera, pad)

    def add(found: Sighting | None, to: Looks) -> None:
        good = to.add(found, right)
        counts.denied += found is not None and not good and found.confidence < 0.5 and right(found)
        if good and to is counts.tracked and found is not None and truth is not None:
            counts.off.append(100.0 * abs(range_error(found, truth, of.camera)))

    add(track(whole, TrackerMemory(), Frame(STAMP, 0, scene.px), attitude)[0].selected, counts.searched)
    memory, found = TrackerMemory(), None
    for number in range(3):
        seen, memory = track(flown, memory, Frame(STAMP, number, scene.px), attitude)
        found = seen.selected
        if found is not None and found.confidence >= 0.5:
            break
    add(found, counts.in_three)
    sigma_m = max(0.02, 0.004 * scene.height_m)
    about = scene if truth is not None else replace(scene, truth=below(scene, camera), R_level_body=R)
    belief, attitude, _ = expected(about, R, flown, rng, sigma_m)
    add(track(flown, TrackerMemory(), Frame(STAMP, 0, scene.px), attitude, belief)[0].selected, counts.tracked)


def below(scene: PadScene, camera: Camera) -> PadPose:
    """Return where a pad would be in the middle of a frame without one."""
    return PadPose(camera.T_body_cam.R.inv, np.array([0.0, 0.0, scene.height_m]))


def floor_ms(px: np.ndarray) -> float:
    """Return the time of one conversion to HSV and one mask, ms."""
    began = time.process_time_ns()
    cv2.inRange(cv2.cvtColor(px, cv2.COLOR_BGR2HSV), (52, 217, 38), (68, 255, 153))
    return (time.process_time_ns() - began) * 1e-6


def times(tracker: TrackerConfig) -> None:
    """Print what a whole look costs, with a belief off by 0.08 % of the range at one sigma, 2 mm at least.

    The pad's surface, its surroundings and what passes are read in different frames: looks without any and with each are timed
    apart, and averaged over `FRAMES_HZ`. The surroundings are timed with new corners, which cost most.
    """
    for height_m in TIMED_M:
        ratios: list[list[float]] = []
        k = 0
        while len(ratios) < 6:
            rng = np.random.default_rng([77, k, round(10 * height_m)])
            k += 1
            scene = pad_scene(rng, tracker.camera, tracker.pad, height_m, "light", 0.1)
            if scene.R_level_body is None:
                continue
            belief, attitude, _ = expected(scene, scene.R_level_body, tracker, rng, max(0.002, 0.0008 * height_m))
            frame, rests = Frame(STAMP, 0, scene.px), TrackerMemory()
            for _ in range(4):
                _, rests = track(tracker, rests, frame, attitude, belief)
            before = MonoNs(STAMP.measured_at - round(1e9 / READ_HZ[0]))
            deck, about, passing = rests.deck, rests.deck.around, rests.deck.passing
            key = None if about is None else replace(about, at=before, key_at=MonoNs(before - 10**10))
            was = None if passing is None else tuple(replace(each, at=before) for each in passing.readings)
            all_of = [rests] + [
                replace(rests, deck=of) for of in (
                    replace(deck, surface=None), replace(deck, around=key),
                    replace(deck, passing=None if passing is None or was is None else replace(passing, readings=was)),
                )
            ]  # fmt: skip
            least, floor = [math.inf] * len(all_of), math.inf
            for _ in range(25):
                for which, memory in enumerate(all_of):
                    began = time.process_time_ns()
                    track(tracker, memory, frame, attitude, belief)
                    least[which] = min(least[which], (time.process_time_ns() - began) * 1e-6)
                floor = min(floor, floor_ms(scene.px))
            ratios.append([ms / floor for ms in least])
        look, *reads = np.median(np.array(ratios), axis=0).tolist()
        more = [each - look for each in reads]
        mean = (
            sum(each * hz for each, hz in zip(more, (*READ_HZ[:2], LOW_HZ if height_m < LOW_M else READ_HZ[2]), strict=True))
            / FRAMES_HZ
        )
        print(
            f"{height_m:g} m: {look:.1f} floors; more for the pad's surface {more[0]:.1f}, its surroundings {more[1]:.1f}, "
            f"what passes {more[2]:.1f}, on average {mean:.2f}",
            flush=True,
        )


def lost(tracker: TrackerConfig, frames: int) -> None:
    """Print what whole looks cost, within a flight's budget of a search, where a pad is expected and none is there."""
    attitude = Attitude(STAMP, Rotation.from_rpy(0.02, -0.03, 0.4), np.eye(3) * SIGMA_ATTITUDE_RAD**2)
    for height_m in TIMED_M:
        sigma_m = max(0.02, 0.004 * height_m)
        belief = RelativeState(
            STAMP.measured_at, "ekf", np.array([0.0, 0.0, height_m]), np.zeros(3), 0.2,
            np.diag([sigma_m**2] * 3 + [0.01] * 3 + [SIGMA_YAW_RAD**2]), STAMP.measured_at, True,
        )  # fmt: skip
        ratios: list[float] = []
        for k in range(-1, frames):
            scene = empty_scene(np.random.default_rng([78, k + 1, round(10 * height_m)]), tracker.camera, height_m)
            memory = TrackerMemory()
            for _ in range(3):
                began = time.process_time_ns()
                _, memory = track(tracker, memory, Frame(STAMP, 0, scene.px), attitude, belief)
                took = (time.process_time_ns() - began) * 1e-6
                if k >= 0:  # the first frame builds what later ones have
                    ratios.append(took / floor_ms(scene.px))
        print(f"{height_m:g} m: {np.median(ratios):.0f} floors, at most {max(ratios):.0f}", flush=True)


def main() -> None:
    parser = described(__doc__)
    parser.add_argument("--frames", type=int, default=20, help="in each condition")
    parser.add_argument("--seed", type=int, default=0)
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument("--only", help="conditions, with commas in between")
    instead.add_argument("--times", action="store_true", help="time tracked looks")
    instead.add_argument("--lost", action="store_true", help="time looks where a pad is expected and none is there")
    parser.add_argument("--pad", default="thesis", help="shipped pad of the timed looks (default: %(default)s)")
    args = parsed(parser, "--frames 1 --only 'worn 15'")
    cv2.setNumThreads(1)
    tracker = TrackerConfig(load_camera("sim"), load_pad(args.pad), TrackerOptions(colours="simulator"))
    if args.times:
        times(tracker)
        return
    if args.lost:
        lost(replace(tracker, search_work=FRAME_WORK), args.frames)
        return
    every: list[Looks] = []
    print(f"{'':16s} search  three  track   range error %   denied  sure and wrong")
    for name in args.only.split(",") if args.only else CONDITIONS:
        of, counts, counted = CONDITIONS[name], Counts(), list(CONDITIONS).index(name)
        for k in range(args.frames):
            rng = np.random.default_rng([args.seed, counted, k])
            look(scene_of(name, of, HEIGHTS_M[k % len(HEIGHTS_M)], rng), of, rng, counts)
        shares = "".join(f"{100 * looks.right / looks.frames:6.0f} " for looks in counts.looks())
        off = "/".join(f"{q:.2f}" for q in np.percentile(counts.off, (50, 95))) if counts.off else "-"
        wrong = "/".join(str(looks.wrong) for looks in counts.looks())
        print(f"{name:16s}{shares}{off:>16s}{counts.denied:9d}{wrong:>12s}", flush=True)
        every += counts.looks()
    frames, false = sum(each.frames for each in every), sum(each.wrong for each in every)
    print(f"{frames} looks, {false} sure and wrong; said: right of finds: {curve_of(every)}")


if __name__ == "__main__":
    main()
