"""The service's vehicle if that is an autopilot: its links, the MAVLink component on them, and the pilot's operator."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager

from companion.base.health import Health
from companion.base.missing_inputs import GIMBAL
from companion.guidance.pilot import Pilot
from companion.parts.mavlink.camera_component import ShowCamera, showing
from companion.parts.mavlink.component import Component, ComponentOptions, speaking
from companion.parts.mavlink.deck_velocity import DeckVelocity
from companion.parts.mavlink.pilot_operator import PilotTower
from companion.parts.mavlink.refusals import link_counters
from companion.parts.mavlink.signed_links import signed_links
from companion.parts.mavlink.tunables import Tunables
from companion.settings.model import Settings
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.gimbal import Gimbal, tending
from drivers.mavlink.links import Links, Tap
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.ports import Clock


class AutopilotPart:
    """Opens the autopilot with our component on its links. The component is an observer of the service.

    Args:
        recording: switches the recorder; None if there is no recorder.
        tap: receives every MAVLink message; None if no one listens.
        show: makes the camera's component; None if no picture is streamed.

    Raises:
        BadInput: a signing key that cannot be read.
    """

    def __init__(
        self,
        settings: Settings,
        vehicle: AutopilotOptions,
        pilot: Pilot,
        health: Health,
        clock: Clock,
        recording: Callable[[bool], str | None] | None = None,
        tap: Tap | None = None,
        show: ShowCamera | None = None,
    ) -> None:
        self._pilot = pilot
        self._clock = clock
        self._tap = tap
        self._show = show
        self._open: Autopilot | None = None
        self._links: Links | None = None
        self._options = vehicle
        self._endpoints = signed_links(vehicle)
        self._sample_queue_items = settings.service.sample_queue_items
        self.component = Component(
            ComponentOptions(pilot.pad.disc_radius_m, settings.guidance.stale_after_s, settings.landing_target),
            PilotTower(pilot, lambda: self.component.belief, clock, recording),
            Tunables(settings, self._apply),
            healthy=health.flight_fault,
            believe=pilot.belief,
            clock=clock,
            health=health,
        )
        pilot.engage = self._engage
        health.counters("mavlink", self._counted)
        self._gimbal = Gimbal(settings.camera.gimbal, clock) if settings.camera.gimbal.given else None
        if self._gimbal is not None:
            health.awaited |= {GIMBAL}
            health.counters("gimbal", self._gimbal.counted)

    @property
    def autopilot(self) -> Autopilot | None:
        """The autopilot whose links are open; None while they are not."""
        return self._open

    @asynccontextmanager
    async def open(self) -> AsyncIterator[Autopilot]:
        """Open the autopilot as the daemon's link."""
        opening = open_autopilot(
            self._options,
            self._clock,
            self._endpoints,
            parameters=self.component.options.parameters,
            sample_queue_items=self._sample_queue_items,
        )
        async with opening as autopilot:
            self._links, autopilot.links.tap = autopilot.links, self._tap
            autopilot.deck_velocity = DeckVelocity(self._pilot.belief, autopilot, self._pilot.landing.vessel_velocity)
            async with (
                speaking(self.component, autopilot, self._clock),
                showing(self._show, autopilot, self._clock),
                tending(self._gimbal, autopilot, self._clock),
            ):
                self._open = autopilot
                try:
                    yield autopilot
                finally:
                    self._open = None

    def _engage(self) -> None:
        if self._open is not None:
            self._open.engage()

    def _apply(self, settings: Settings) -> None:
        estimator = settings.estimator
        self._pilot.retune(
            settings.guidance,
            min_confidence=estimator.min_confidence,
            max_delay_s=estimator.max_delay_s,
        )

    def _counted(self) -> Mapping[str, float]:
        """Return the counters of the links since they were opened last, and of targets that were due but not sent."""
        component = self.component
        out: dict[str, float] = {f"withheld_{why.replace(' ', '_')}": n for why, n in component.outputs.withheld.items()}
        out |= {"targets_sent": component.outputs.sent, "sends_ranges": component.sends_ranges}
        if self._links is not None:
            out |= link_counters(self._links, component.refusals)
        if self._open is not None:
            out["implausible"] = self._open.refused
            out["out_of_order"] = self._open.out_of_order
        return out
