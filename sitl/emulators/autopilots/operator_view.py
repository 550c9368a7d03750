"""What the operator at the ground station sees of a simulated body and ship."""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.geometry import Rotation, wrap_pi
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.station import OperatorView


def view_of(body: Body) -> OperatorView:
    """Return the view at the newest step; the landing begins where the scenario's `start` says."""
    state, start = body.state(), body.scenario.start
    yaw = state.R_ned_body.rpy_rad[2]
    heading = body.R_ned_pad.rpy_rad[2] + math.radians(start.heading_deg)
    to_pad = Rotation.from_rpy(0.0, 0.0, heading) @ np.array([start.pad_forward_m, start.pad_right_m, start.height_m])
    level = Rotation.from_rpy(0.0, 0.0, yaw).inv
    # The ship's steady velocity, without the motion of the pad on the waves.
    v_start = body.vessel.way_at(body.t_s)
    return OperatorView(
        level @ (body.p_pad_ned - to_pad - state.p_ned),
        level @ v_start,
        level @ (v_start - state.v_ned),
        yaw,
        wrap_pi(heading - yaw),
        float(body.p_pad_ned[2] - state.p_ned[2]),
        level @ body.v_pad_ned,
        not start.with_vessel,
    )
