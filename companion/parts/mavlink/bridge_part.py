"""The MAVLink bridge as a part of the service: its links, an observer of the drone, and a supervised body."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial

from companion.base.observer import NullObserver
from companion.base.orders import OperatorOrder
from companion.parts.mavlink.bridge import VehicleBridge
from companion.parts.mavlink.camera_component import CameraComponent, ShowCamera
from companion.parts.mavlink.refusals import link_counters
from companion.settings.mavlink import BridgeOptions
from drivers.mavlink.access import NamedSenders
from drivers.mavlink.dialect import mav
from drivers.mavlink.links import LinkOptions, Links, Tap, open_links
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Sample

_TICK_S = 0.02


class BridgePart(NullObserver):
    """The bridge and its links; see the module's docstring.

    Args:
        options: who the drone is shown as, and who may command it.
        links: the links to ground stations.
        order: gives a station's order; returns why it is refused, or None.
        tap: receives every message; None if no one listens.
        show: makes the camera's component; None if no picture is streamed.
    """

    def __init__(
        self,
        options: BridgeOptions,
        links: Sequence[LinkOptions],
        clock: Clock,
        *,
        order: Callable[[OperatorOrder], str | None],
        tap: Tap | None = None,
        show: ShowCamera | None = None,
    ) -> None:
        self._endpoints = tuple(links)
        self._system = options.system_id
        self._access = NamedSenders(options.named_operators())
        self._clock = clock
        self._order = order
        self._tap = tap
        self._show = show
        self._bridge: VehicleBridge | None = None
        self._links: Links | None = None

    def on_sample(self, sample: Sample) -> None:
        if self._bridge is not None:
            self._bridge.on_sample(sample)

    def counted(self) -> dict[str, float]:
        """Return the counters of the links since they were opened last."""
        if self._links is None or self._bridge is None:
            return {}
        return link_counters(self._links, self._bridge.refusals)

    async def run(self) -> None:
        """Serve the links until cancelled; a link that fails reconnects by itself."""
        identity = (self._system, int(mav.MAV_COMP_ID_ONBOARD_COMPUTER))
        async with open_links(self._endpoints, self._clock, identity, access=self._access) as links, asyncio.TaskGroup() as group:
            self._links, links.tap = links, self._tap
            self._bridge = bridge = VehicleBridge(links.send, self._order)
            camera = None if self._show is None else self._show(links.send)
            try:
                listening = group.create_task(self._listen(bridge, camera, links))
                while not listening.done():
                    links.contained.run("the bridge's tick", "us", lambda: bridge.tick(self._clock.now()))
                    if camera is not None:
                        links.contained.run("the camera's tick", "us", partial(camera.tick, self._clock.now()))
                    await self._clock.sleep(_TICK_S)
            finally:
                self._bridge = None

    async def _listen(self, bridge: VehicleBridge, camera: CameraComponent | None, links: Links) -> None:
        async for received in links.received:
            for part in (bridge, camera):
                if part is not None:
                    on_message = partial(part.on_message, received, self._system, self._clock.now())
                    links.contained.run(received.place, received.source_text, on_message)
