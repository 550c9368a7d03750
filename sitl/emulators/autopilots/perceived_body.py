"""A body that an autopilot flies, as the levels of perception see a world."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from sitl.camera.camera import Exposure
from sitl.camera.render_worker import RenderWorker
from sitl.emulators.autopilots.body import Body
from sitl.faults.picture import LightFalls
from sitl.faults.timer import FaultTimer
from sitl.scenario.scenario import Scenario
from sitl.vehicle.vehicle import VehiclePhase
from sitl.vessel.vessel import Mounted, Vessel
from sitl.world.truth import RenderedFrame, Truth


class PerceivedBody:
    """The world of one body.

    Args:
        faults: the faults that are active now.
    """

    def __init__(self, body: Body, seed: int, clock: Clock, faults: FaultTimer) -> None:
        self._body, self._clock = body, clock
        self.seed, self.faults = seed, faults
        self._motion: tuple[float, Mounted] | None = None
        self._truth: tuple[float, Truth] | None = None

    @property
    def scenario(self) -> Scenario:
        return self._body.scenario

    @property
    def pad(self) -> Pad:
        return self._body.pad

    @property
    def camera(self) -> Camera:
        return self._body.camera

    @property
    def vessel(self) -> Vessel:
        return self._body.vessel

    def pad_motion(self) -> Mounted:
        """Return the pad's true motion at the newest step, with shapes (3,) and (3, 3)."""
        t_s = self._body.t_s
        if self._motion is None or self._motion[0] != t_s:
            self._motion = t_s, self._body.vessel.pad_at(t_s)
        return self._motion[1]

    def pad_ahead(self, ahead_s: F64) -> Mounted:
        """Return the pad's true motion at (H,) s after the newest step."""
        return self._body.vessel.pad(self._body.t_s + ahead_s)

    def truth(self) -> Truth:
        """Return the true state at the newest step; contacts are not noted here."""
        t_s = self._body.t_s
        if self._truth is None or self._truth[0] != t_s:
            self._truth = t_s, self._true_state()
        return self._truth[1]

    def _true_state(self) -> Truth:
        body, s, pad = self._body, self._body.state(), self.pad_motion()
        phase = VehiclePhase.FLYING if body.flying else VehiclePhase.LANDED if body.upright else VehiclePhase.EMERGENCY
        gravity = np.array([0.0, 0.0, G_M_S2])
        return Truth(
            self._clock.now(), s.p_ned, s.v_ned, s.R_ned_body, pad.p_ned, pad.v_ned, Rotation(pad.R_ned), phase, None,
            a_body_ned=s.R_ned_body @ s.f_body + gravity, w_body=s.w_body,
        )  # fmt: skip

    def expose(
        self, worker: RenderWorker | None = None, camera: Callable[[Exposure | None, int], NDArray[np.uint8]] | None = None
    ) -> Callable[[], RenderedFrame]:
        """Fix the scene now, and return the call that makes the frame; `camera` replaces the renderer.

        The frames of one body are rendered in this process: `worker` is not used.
        """
        at: MonoNs = self._clock.now()
        exposure_s = self.scenario.camera.exposure_s
        if camera is None:
            return self._body.expose(math.prod(fault.fraction for fault, _ in self.faults.on(LightFalls)))
        covered = self.faults.active("lens_covered")
        px = camera(None if covered else self._body.shot(), self._body.tick)
        return lambda: RenderedFrame(px, at, exposure_s)
