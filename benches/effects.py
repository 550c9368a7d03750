"""Measure what each effect of camera, weather and link costs the eyes: `python -m benches.effects [--frames N] [--sheet FILE]`.

A camera descends over the pad of a 5 m ferry under way from 8 to 0.25 m, swaying by a tenth of its height. The tracker processes
every frame with a prediction that is off by 0.4 % of the range, 2 cm at least. The output is a Markdown table: frames with a
confidence of 0.5 or more above and below 2 m, frames among them that are off by more than a tenth of the height, the median error
of the position, and the time to render a frame in floors: one BGR to HSV and one inRange of the same frame. `--sheet` writes one
frame of each effect as a contact sheet.
"""

import argparse
import math
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp
from estimator.vision.options import TrackerOptions
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track
from sitl.camera.camera import Exposure
from sitl.scenario.scenario import Scenario, camera_model, load, pad_model
from sitl.vessel.vessel import Vessel
from sitl.world.stage import flight_seeds, renderer, sea_and_vessel

U8 = NDArray[np.uint8]

BASE, SEED, FRAMES_PER_S = "ferry", 7, 30.0
HIGH_M, LOW_M, SPLIT_M = 8.0, 0.25, 2.0
AUTOMATIC = {"exposure_lag_s": 0.4, "white_balance_lag_s": 1.5}
EFFECTS: dict[str, dict[str, dict[str, Any]]] = {
    "none": {},
    "rolling shutter, 25 ms": {"camera": {"readout_s": 0.025}},
    "automatic exposure and balance": {"camera": AUTOMATIC},
    "rain": {"drops": {"rain_per_minute": 60.0}},
    "spray": {"drops": {"spray_per_minute": 12.0, "spray_drops": 16}},
    "glint": {"light": {"glint": 6.0, "wetness": 0.35, "sun_elevation_deg": 62.0, "sun_azimuth_deg": 100.0}, "camera": AUTOMATIC},
    "the mast's shadow": {"light": {"mast_height_m": 3.0, "mast_forward_m": 0.8, "mast_right_m": 1.3, "sun_azimuth_deg": 60.0}},
    "fog, visibility 30 m": {"light": {"visibility_m": 30.0, "drone_shadow": 0.0}},
    "dusk": {"light": {"daylight_ev": -6.0, "colour_temperature_k": 9000.0, "drone_shadow": 0.0}, "camera": AUTOMATIC},
    "night, lamps": {
        "light": {"daylight_ev": -9.0, "colour_temperature_k": 9000.0, "drone_shadow": 0.0},
        "lamps": {"floods": 3, "flood_level": 0.02, "pad_lamps": 12, "pad_lamps_level": 0.1},
        "camera": AUTOMATIC,
    },
    "H.264, 1 Mbit/s": {"video": {"bitrate_kbit_s": 1000.0}},
    "and 5 % lost": {"video": {"bitrate_kbit_s": 1000.0, "loss": 0.05}},
    "and 20 % lost": {"video": {"bitrate_kbit_s": 1000.0, "loss": 0.2}},
}
SHEET_AT_M = (3.0, 0.9)
STAMP = Stamp(MonoNs(0), MonoNs(0), 0.0, "sim")


def scenario_with(effect: dict[str, dict[str, Any]]) -> Scenario:
    """Return the base scenario with some keys of some tables replaced."""
    base = load(BASE)
    tables = {table: msgspec.structs.replace(getattr(base, table), **keys) for table, keys in effect.items()}
    return msgspec.structs.replace(base, **tables)


def descent(vessel: Vessel, scenario: Scenario, frames: int) -> list[tuple[float, Exposure, F64, float]]:
    """Return height, scene, vector from body to pad in `level` and heading against the arrow for each frame."""
    mount, shots = camera_model(scenario).T_body_cam, []
    heights = np.geomspace(HIGH_M, LOW_M, frames)
    for n, height_m in enumerate(heights):
        t = 10.0 + n / FRAMES_PER_S
        pad = vessel.pad_at(t)
        R_ned_pad = pad.rotation()
        yaw = R_ned_pad.rpy_rad[2] + 0.3
        roll, pitch = 0.03 * math.sin(2.1 * t), 0.03 * math.sin(1.7 * t + 1.0)
        R = Rotation.from_rpy(roll, pitch, yaw)
        sway = 0.1 * height_m * np.array([math.sin(1.3 * t), math.cos(0.9 * t), 0.0])
        p = pad.p_ned + sway - np.array([0.0, 0.0, height_m]) - R @ mount.t
        v = pad.v_ned + 0.1 * height_m * np.array([1.3 * math.cos(1.3 * t), -0.9 * math.sin(0.9 * t), 5.0])
        w = np.array([0.063 * math.cos(2.1 * t), 0.051 * math.cos(1.7 * t + 1.0), 0.05])
        shot = Exposure(t, R, p, R_ned_pad, pad.p_ned, v, w, pad.v_ned, pad.w)
        level = Rotation.from_rpy(0.0, 0.0, yaw).inv
        arrow = (level @ R_ned_pad).matrix[:, 0]
        shots.append((float(height_m), shot, level.matrix @ (pad.p_ned - p), -math.atan2(arrow[1], arrow[0])))
    return shots


def measured(effect: dict[str, dict[str, Any]], frames: int) -> tuple[str, list[U8]]:
    """Return the cells of the effect's row, and the frames for the sheet."""
    scenario, seeds, rng = scenario_with(effect), flight_seeds(SEED), np.random.default_rng(SEED)
    waves, vessel = sea_and_vessel(scenario, [seeds.sea])
    film = renderer(scenario, waves, vessel, seeds.camera)
    tracker, memory = TrackerConfig(camera_model(scenario), pad_model(scenario), TrackerOptions()), TrackerMemory()
    found: dict[bool, list[bool]] = {False: [], True: []}
    errors, wrong, spent, sheet, floor_ms = [], 0, [], [], math.inf
    shots = descent(vessel, scenario, frames)
    wanted = [int(np.argmin([abs(shot[0] - at) for shot in shots])) for at in SHEET_AT_M]
    for n, (height_m, shot, d_level, yaw_rad) in enumerate(shots):
        began = time.process_time_ns()
        px = film.render(shot, np.random.default_rng([SEED, n]))
        spent.append((time.process_time_ns() - began) * 1e-6)
        began = time.process_time_ns()
        cv2.inRange(cv2.cvtColor(px, cv2.COLOR_BGR2HSV), (52, 217, 38), (68, 255, 153))
        floor_ms = min(floor_ms, (time.process_time_ns() - began) * 1e-6)
        if n in wanted:
            sheet.append(px)
        at = MonoNs(round(shot.t_s * NS_PER_S))
        stamp = Stamp(at, at, 0.0, "sim")
        sigma_m = max(0.02, 0.004 * height_m)
        belief = RelativeState(
            at, "ekf", d_level + rng.normal(0.0, sigma_m, 3), np.zeros(3), yaw_rad + rng.normal(0.0, 0.02),
            np.diag([sigma_m**2] * 3 + [0.01] * 3 + [0.02**2]), at, True,
        )  # fmt: skip
        attitude = Attitude(stamp, shot.R_ned_body.without_heading(), np.eye(3) * math.radians(1.0) ** 2)
        processed, memory = track(tracker, memory, Frame(stamp, n, px), attitude, belief)
        seen = processed.selected
        sure = seen is not None and seen.confidence >= 0.5
        found[height_m > SPLIT_M].append(sure)
        if seen is not None and sure:
            errors.append(float(np.linalg.norm(seen.d_body_pad_level - d_level)) / height_m)
            wrong += errors[-1] > 0.1
    high, low = (f"{100 * np.mean(found[above]):.0f}" for above in (True, False))
    off = f"{100 * np.median(errors):.2f}" if errors else "-"
    return f"{high} | {low} | {wrong} | {off} | {np.median(spent) / floor_ms:.0f}", sheet


def contact_sheet(frames: dict[str, list[U8]]) -> U8:
    """Return a sheet with the frames of each effect one above the other, at a third of their size, with the effect's name."""
    columns, tiles = 5, []
    for name, pair in frames.items():
        tile = np.vstack([cv2.resize(px, (212, 119), interpolation=cv2.INTER_AREA) for px in pair])
        cv2.putText(tile, name, (4, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.putText(tile, name, (4, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (255, 255, 255), 1, cv2.LINE_AA)
        tiles.append(cv2.copyMakeBorder(np.asarray(tile, dtype=np.uint8), 2, 2, 2, 2, cv2.BORDER_CONSTANT))
    while len(tiles) % columns:
        tiles.append(np.zeros_like(tiles[0]))
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    return np.asarray(np.vstack(rows), dtype=np.uint8)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=90, help="frames of each descent")
    parser.add_argument("--only", nargs="*", choices=list(EFFECTS), metavar="EFFECT", help=f"of {', '.join(EFFECTS)}")
    parser.add_argument("--sheet", type=Path, metavar="FILE", help="write a contact sheet, .jpg or .png")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    print("| effect | found over 2 m, % | below, % | wrong frames | median error, % of the height | render, floors |")
    print("|---|---|---|---|---|---|")
    frames = {}
    for name in args.only or EFFECTS:
        cells, frames[name] = measured(EFFECTS[name], args.frames)
        print(f"| {name} | {cells} |", flush=True)
    if args.sheet is not None:
        cv2.imwrite(str(args.sheet), contact_sheet(frames), [cv2.IMWRITE_JPEG_QUALITY, 78])
    return 0


if __name__ == "__main__":
    sys.exit(main())
