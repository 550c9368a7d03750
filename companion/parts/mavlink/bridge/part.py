"""Emulate a MAVLink vehicle for a drone that speaks no MAVLink (an AR.Drone), so that a ground station can command it.

    bridge = VehicleBridge(links.send, order)       # an observer; `on_message` takes what the links receive, `tick` the time

The bridge sends as component 1 of the links' system. Its position is the integral of the drone's own velocities since take-off:
it shows where the drone went, but it is not good enough to navigate by.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from companion.base.observer import NullObserver
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.cycle.ports import Assembly
from companion.guidance.pilot_operator import FlightWatch, PilotOperator
from companion.parts.mavlink.bridge.options import BridgeOptions
from companion.parts.mavlink.camera_component import CameraComponent, Send, ShowCamera, shown_camera
from companion.parts.mavlink.commands import ACCEPTED, CAPABILITIES, DENIED, UNSUPPORTED, Offered, Refusals, link_counters
from companion.parts.mavlink.component import MavSeverity, StatusTexts
from companion.parts.mavlink.file_server import FILE_REQUEST, FileServer
from companion.parts.mavlink.metadata import metadata_files, metadata_message
from companion.parts.mavlink.parameters import PARAMETER_REQUESTS, ParameterServer, Tunables, tunables
from companion.parts.mavlink.signed_links import signed_links
from drivers.mavlink.access import AccessLevel, NamedSenders
from drivers.mavlink.dialect import ComponentMetadata, Message, mav, ms_since_boot
from drivers.mavlink.links import LinkOptions, Links, ReceivedMessage, Tap, open_links
from drivers.mavlink.vehicle import ARMED
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, BodyVelocity, Imu, Range, Sample, VehicleStatus
from estimator.contracts.time import Clock, MonoNs, seconds_between

COMPONENT = int(mav.MAV_COMP_ID_AUTOPILOT1)
_LANDED_STATES = {"landed": 1, "taking_off": 3, "landing": 4}
_GAP_S = 0.2
"""The longest gap between two velocities that the position is integrated over, s."""
_HOLDS = frozenset({int(mav.MAV_CMD_NAV_LOITER_UNLIM), int(mav.MAV_CMD_DO_PAUSE_CONTINUE), int(mav.MAV_CMD_OVERRIDE_GOTO)})
_NO_BATTERY = -1  # charge that is not known
_TICK_S = 0.02  # interval at which messages that are due are sent


class VehicleBridge(NullObserver):
    """The emulated vehicle; see the module's docstring.

    Args:
        send: sends a message over the links.
        order: gives a person's order; returns why it is refused, or None.
        below: returns in words where a landing that is ordered now would end.
        store: the settings that it shows as the vehicle's parameters; None for none.
    """

    def __init__(
        self, send: Send, order: Callable[[OperatorOrder], str | None], below: Callable[[], str], store: Tunables | None = None
    ) -> None:
        self._send = send
        self._order = order
        self._below = below
        self._status: VehicleStatus | None = None
        self._attitude: Attitude | None = None
        self._velocity: BodyVelocity | None = None
        self._range: Range | None = None
        self._w_body: F64 = np.zeros(3)
        self._p_ned: F64 = np.zeros(3)
        self._armed = False
        self.refusals = Refusals("bridge.operators")
        self._texts = StatusTexts()
        self._parameters = None if store is None else ParameterServer(store)
        self.files = FileServer({} if store is None else metadata_files(COMPONENT))
        self._offered = Offered(
            {
                mav.MAVLINK_MSG_ID_HEARTBEAT: (self._heartbeat, 1.0),
                mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: (self._attitude_quaternion, 0.05),
                mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: (self._local_position, 0.1),
                mav.MAVLINK_MSG_ID_SYS_STATUS: (self._sys_status, 1.0),
                mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: (self._extended, 0.5),
                mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION: (self._version, 0.0),
            }
            | ({} if store is None else {ComponentMetadata.id: (partial(metadata_message, COMPONENT), 0.0)})
        )

    def on_sample(self, sample: Sample) -> None:
        """Keep the newest state of the drone, and integrate its velocity."""
        match sample:
            case VehicleStatus():
                if sample.flying and not (self._status and self._status.flying):
                    self._p_ned = np.zeros(3)
                self._status = sample
                self._armed = self._armed and sample.flying is not True
            case Attitude():
                self._attitude = sample
            case BodyVelocity():
                self._move(sample)
            case Range():
                self._range = sample
            case Imu():
                self._w_body = sample.w_body

    def tick(self, now: MonoNs) -> None:
        """Send the messages that are due."""
        parameters = [] if self._parameters is None else self._parameters.due()
        for message in (*self._offered.due(now), *parameters, *self._texts.due(now)):
            self._send(message, component=COMPONENT)
        for message, source in self.files.due(now):
            self._send(message, source, component=COMPONENT)

    def on_message(self, received: ReceivedMessage, system: int, now: MonoNs) -> None:
        """Answer commands, parameter and file requests to component 1 of our system; ignore every other message."""
        m, kind = received.message, received.message.get_type()
        if kind == FILE_REQUEST:
            self.files.on_message(received, (system, COMPONENT))
        if kind in PARAMETER_REQUESTS and self._parameters is not None:
            self._about_parameters(self._parameters, received, (system, COMPONENT), now)
        if kind not in ("COMMAND_LONG", "COMMAND_INT") or (m.target_system, m.target_component) != (system, COMPONENT):
            return
        if self.refusals.refuses(received, (system, COMPONENT)):
            self._tell(self.refusals.text_for(received), now)
            for message in self.refusals.answer(received):
                self._send(message, received.source, component=COMPONENT)
            return
        result, extra = self._do(m, now)
        ack = mav.MAVLink_command_ack_message(m.command, result, 0, 0, received.system, received.component)
        for message in (ack, *extra):
            self._send(message, received.source, component=COMPONENT)

    def _about_parameters(self, parameters: ParameterServer, received: ReceivedMessage, us: tuple[int, int], now: MonoNs) -> None:
        if self.refusals.refuses(received, us):
            self._tell(self.refusals.text_for(received), now)
            for message in parameters.in_force(received.message):
                self._send(message, received.source, component=COMPONENT)
        elif received.access_level >= AccessLevel.PEER:
            for message in parameters.on_message(received.message, us):
                self._send(message, component=COMPONENT)
            self._tell(parameters.refused, now)
            parameters.refused = None

    def _tell(self, why: str | None, now: MonoNs) -> None:
        """Say to the stations why something was refused, or where it ends."""
        if why is not None:
            self._texts.say(MavSeverity.WARNING, f"Decklander: {why}", now)

    @property
    def _flying(self) -> bool:
        return self._status is not None and self._status.flying is True

    def _do(self, m: Message, now: MonoNs) -> tuple[int, list[Message]]:
        if m.command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
            if self._flying and m.param1 != 1.0:
                return DENIED, []  # The bridge never stops the motors in flight.
            self._armed = m.param1 == 1.0
            return ACCEPTED, []
        if m.command == mav.MAV_CMD_NAV_TAKEOFF:
            if self._flying or not self._armed:
                return DENIED, []
            return self._give(OperatorOrder.TAKE_OFF), []
        if m.command == mav.MAV_CMD_NAV_LAND:
            # The person has confirmed it at the station, which does not know what lies below.
            where, result = self._below(), self._give(OperatorOrder.LAND)
            self._tell(f"lands {where}" if result == ACCEPTED else None, now)
            return result, []
        if m.command == mav.MAV_CMD_DO_PAUSE_CONTINUE and m.param1 == 1.0:
            return self._give(OperatorOrder.BEGIN), []
        if m.command in _HOLDS:
            return self._give(OperatorOrder.HOLD), []
        if m.command == mav.MAV_CMD_REQUEST_MESSAGE:
            number = int(m.param1) if math.isfinite(m.param1) else -1
            message = self._offered.make(number, now)
            if message is None:
                return UNSUPPORTED, []
            return ACCEPTED, [message]
        if m.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL and math.isfinite(m.param1):
            done = self._offered.set_interval(int(m.param1), m.param2)
            return (ACCEPTED if done else UNSUPPORTED), []
        return UNSUPPORTED, []

    def _give(self, order: OperatorOrder) -> int:
        return ACCEPTED if self._order(order) is None else int(mav.MAV_RESULT_TEMPORARILY_REJECTED)

    def _move(self, sample: BodyVelocity) -> None:
        before, self._velocity = self._velocity, sample
        if before is None or self._attitude is None or not self._flying:
            return
        dt = seconds_between(before.stamp.measured_at, sample.stamp.measured_at)
        if 0.0 < dt <= _GAP_S:
            v_ned = self._v_ned(sample)
            self._p_ned = self._p_ned + np.array([v_ned[0], v_ned[1], 0.0]) * dt

    def _v_ned(self, sample: BodyVelocity) -> F64:
        yaw_rad = 0.0 if self._attitude is None else self._attitude.R_ned_body.rpy_rad[2]
        return Rotation.from_rpy(0.0, 0.0, yaw_rad) @ sample.v_level

    def _heartbeat(self, now: MonoNs) -> Message | None:
        status = self._status
        if status is None or not status.link_ok:
            return None
        state = mav.MAV_STATE_EMERGENCY if status.emergency else mav.MAV_STATE_ACTIVE if self._flying else mav.MAV_STATE_STANDBY
        base = mav.MAV_MODE_FLAG_STABILIZE_ENABLED | mav.MAV_MODE_FLAG_GUIDED_ENABLED
        armed = ARMED if self._flying or self._armed else 0
        return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_GENERIC, base | armed, 0, int(state), 3)

    def _attitude_quaternion(self, now: MonoNs) -> Message | None:
        a = self._attitude
        if a is None:
            return None
        q = (float(v) for v in a.R_ned_body.quat_wxyz)
        return mav.MAVLink_attitude_quaternion_message(ms_since_boot(a.stamp.measured_at), *q, *(float(w) for w in self._w_body))

    def _local_position(self, now: MonoNs) -> Message | None:
        v = self._velocity
        if v is None or self._attitude is None:
            return None
        height_m = 0.0
        if self._range is not None and seconds_between(self._range.stamp.measured_at, now) < 1.0:
            height_m = self._range.range_m * float(self._attitude.R_ned_body.matrix[2, 2])
        x, y = (float(p) for p in self._p_ned[:2])
        vx, vy, vz = (float(c) for c in self._v_ned(v))
        return mav.MAVLink_local_position_ned_message(ms_since_boot(v.stamp.measured_at), x, y, -height_m, vx, vy, vz)

    def _sys_status(self, now: MonoNs) -> Message | None:
        if self._status is None:
            return None
        charge = self._status.battery_fraction
        percent = _NO_BATTERY if charge is None else round(100 * charge)
        return mav.MAVLink_sys_status_message(0, 0, 0, 0, 65535, -1, percent, 0, 0, 0, 0, 0, 0)

    def _extended(self, now: MonoNs) -> Message | None:
        if self._status is None:
            return None
        state = _LANDED_STATES.get(self._status.mode, 2 if self._flying else 1 if self._status.flying is False else 0)
        return mav.MAVLink_extended_sys_state_message(0, state)

    def _version(self, now: MonoNs) -> Message:
        capabilities = int(mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2) if self._parameters is None else CAPABILITIES
        return mav.MAVLink_autopilot_version_message(capabilities, 0, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)


class BridgePart(NullObserver):
    """The bridge as a part of the service: its links, an observer of the drone, and a supervised body.

    Args:
        options: who the drone is shown as, and who may command it.
        links: the links to ground stations.
        order: gives a station's order; returns why it is refused, or None.
        below: see `VehicleBridge`.
        tap: receives every message; None if no one listens.
        show: makes the camera's component; None if no picture is streamed.
        store: the settings that are shown as parameters; None for none.
    """

    def __init__(
        self,
        options: BridgeOptions,
        links: Sequence[LinkOptions],
        clock: Clock,
        *,
        order: Callable[[OperatorOrder], str | None],
        below: Callable[[], str],
        tap: Tap | None = None,
        show: ShowCamera | None = None,
        store: Tunables | None = None,
    ) -> None:
        self._endpoints = tuple(links)
        self._system = options.system_id
        self._access = NamedSenders(options.named_operators())
        self._clock = clock
        self._order, self._below = order, below
        self._tap = tap
        self._show = show
        self._store = store
        self._bridge: VehicleBridge | None = None
        self._links: Links | None = None

    def on_sample(self, sample: Sample) -> None:
        if self._bridge is not None:
            self._bridge.on_sample(sample)

    def counted(self) -> dict[str, float]:
        """Return the counters of the links since they were opened last."""
        if self._links is None or self._bridge is None:
            return {}
        return link_counters(self._links, self._bridge.refusals) | {"files_refused": self._bridge.files.refused.total()}

    async def run(self) -> None:
        """Serve the links until cancelled; a link that fails reconnects by itself."""
        identity = (self._system, int(mav.MAV_COMP_ID_ONBOARD_COMPUTER))
        async with open_links(self._endpoints, self._clock, identity, access=self._access) as links, asyncio.TaskGroup() as group:
            self._links, links.tap = links, self._tap
            self._bridge = bridge = VehicleBridge(links.send, self._order, self._below, self._store)
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


def join(service: Assembly) -> None:
    """Show a vehicle that speaks no MAVLink to ground stations."""
    settings, pilot, clock = service.settings, service.pilot, service.clock
    options = settings.of(BridgeOptions)
    flight = FlightWatch(pilot, clock)
    bridge = BridgePart(
        options,
        signed_links(options),
        clock,
        order=PilotOperator(pilot, OrderSender(OrderSource.MAVLINK), clock).order,
        below=lambda: flight.below(clock.now())[0],
        tap=service.tap,
        show=shown_camera(service),
        store=tunables(settings, pilot),
    )
    service.observers += [bridge, flight]
    service.add("bridge", bridge)
