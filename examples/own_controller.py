"""Land the simulated drone with a controller of one's own: `python -m examples.own_controller [SEED]`.

There is no daemon, no socket and no asyncio: the loop steps the world, feeds tracker and estimator, and moves the stick.
"""

import math
import sys

import msgspec
import numpy as np

from decklander import Attitude, Imu, PadTracker, RelativeEstimator, RelativeState, Rotation, Stamp
from sitl.scenario.scenario import load
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.world import Stick, World

STEP_S, FRAME_STEPS = 0.01, 5  # IMU at 100 Hz, camera at 20 Hz
LEVEL_SIGMA_RAD = math.radians(0.5)


def control(state: RelativeState | None) -> Stick:
    """Fly towards the pad, and descend while over it. Without an estimate, hover."""
    if state is None or not state.consistent:
        return Stick()
    d, v = state.d_body_pad_level, state.v_pad_level
    forward, right = (np.clip(0.25 * d[i] + 0.35 * v[i], -0.4, 0.4) for i in range(2))
    descend = 0.5 if state.lateral_m < 0.1 + 0.1 * state.height_m else 0.0
    return Stick(roll=float(right), pitch=-float(forward), gaz=-descend, progressive=True)


def main(seed: int) -> bool:
    """Fly once; return whether the drone stands on the pad."""
    calm = load("calm")
    nearer = msgspec.structs.replace(calm.start, height_m=1.5, pad_forward_m=0.3, pad_right_m=0.2)
    world = World(msgspec.structs.replace(calm, start=nearer), seed)
    tracker, estimator = PadTracker(world.camera, world.pad, colours="simulator"), RelativeEstimator()
    start = world.now
    for step in range(1, round(60.0 / STEP_S)):
        world.advance(type(start)(start + round(step * STEP_S * 1e9)))
        readings = world.readings()
        stamp = Stamp(readings.at, readings.at, 0.001, "sim")
        estimator.on_imu(Imu(stamp, readings.w_body, readings.f_body))
        estimator.on_attitude(Attitude(stamp, Rotation.from_rpy(*readings.rpy_rad), np.eye(3) * LEVEL_SIGMA_RAD**2))
        if step % FRAME_STEPS == 0:
            sighting = tracker.track(
                world.render().px, stamp=stamp, attitude=estimator.attitude_at(stamp), expected=estimator.at(stamp.measured_at)
            )
            if sighting is not None:
                estimator.on_sighting(sighting)
        state = estimator.state
        if state is not None and state.height_m < 0.35 and state.lateral_m < 0.15:
            world.vehicle.land()
        elif world.phase is not VehiclePhase.LANDING:
            world.stick(control(state))
        if world.phase is VehiclePhase.LANDED:
            break
    touchdown = world.truth().touchdown
    if touchdown is None:
        print("no landing in 60 s")
        return False
    print(f"landed on the {touchdown.surface} after {step * STEP_S:.1f} s, {touchdown.lateral_m * 100:.1f} cm from the centre")
    return touchdown.on_pad


if __name__ == "__main__":
    seed = (sys.argv[1:] or ["3"])[0]
    sys.exit(int(not main(int(seed))) if seed.isdecimal() else __doc__)
