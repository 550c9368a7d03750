"""Add a simulated deck and camera to a vehicle that another simulator flies, or that an autopilot program simulates by itself.

The vehicle's pose comes over MAVLink, from that simulator or from its autopilot. The camera renders from that pose, and the
daemon flies the landing. The deck moves, but the ground of the other simulator does not: if the deck heaves, only the horizontal
position of a touchdown counts.

A program that simulates its own vehicle reports the true state over MAVLink, and the flight's time advances with these messages:
the program is stopped while frames are made and looked at. Its own ground is the still water below the deck, so a contact is
found by the place of the feet, and the flight ends with it. The ship waits until the vehicle has taken off.
"""

import asyncio
import math
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct

from companion.base.health import Health
from companion.base.mission import FlightOutcome
from companion.base.observer import Observer
from companion.guidance.pilot import make_pilot
from companion.settings.model import Settings
from drivers.clock import SystemClock
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.requests import message_id
from drivers.mavlink.samples import LocalPosition
from drivers.mavlink.vehicle import Stack
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, GeoPoint, Rotation, moved, ned_between, wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp, seconds_between
from sitl.camera.camera import Exposure
from sitl.core.library import SIM
from sitl.emulators.autopilots.beside import FlightDaemon, beside_autopilot
from sitl.emulators.autopilots.body import Body, Settle
from sitl.emulators.autopilots.programs.program import Program
from sitl.faults.faulty_streams import FlightFaults
from sitl.scenario.scenario import Scenario, pad_model
from sitl.sensors.sensors import ORIGIN
from sitl.vehicle.airframe import Airframe, ardrone2
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.drives import Motors
from sitl.world.stage import flight_seeds, renderer, sea_and_vessel
from sitl.world.truth import RenderedFrame, Surface, Touchdown

TRUTH = {Stack.ARDUPILOT: "SIM_STATE", Stack.PLANE: "SIM_STATE", Stack.PX4: "HIL_STATE_QUATERNION"}
"""The message in which the simulator of each stack reports the true state."""
STEP_S = 0.005
"""Interval at which the true state is requested."""
_CLOCK = "ATTITUDE_QUATERNION"
"""The message that has the program's time; both stacks send it with the true state, which has none."""
_TURNING: Motors = (0.5, 0.5, 0.5, 0.5)
_PLACE_OVER_S = 1.0
"""Time over which the reported places, in steps of a centimetre, correct the integral of the reported velocity."""
_SLICE_S = 0.0002
"""Time for which the program runs before it is looked at again: less than it needs for a step."""
_AROUND_EVERY = 10
"""Steps from one report of the surroundings to the next."""


class TrueState(NamedTuple):
    """The true state that a simulator reports."""

    place_deg_m: tuple[float, float, float]
    """Latitude, longitude and altitude."""
    v_ned: tuple[float, ...]
    quat_wxyz: tuple[float, ...]
    w_body: tuple[float, ...]

    @property
    def place(self) -> GeoPoint:
        """The vehicle's place."""
        return GeoPoint.of_degrees(*self.place_deg_m)


def true_state(m: Message) -> TrueState | None:
    """Return the true state that a message reports; None if it reports none, or one that is not finite."""
    kind = m.get_type()
    if kind == "SIM_STATE":
        lat, lon = (1e-7 * m.lat_int, 1e-7 * m.lon_int) if m.lat_int or m.lon_int else (float(m.lat), float(m.lon))
        q, w = (m.q1, m.q2, m.q3, m.q4), (m.xgyro, m.ygyro, m.zgyro)
        state = TrueState((lat, lon, float(m.alt)), (m.vn, m.ve, m.vd), q, w)
    elif kind == "HIL_STATE_QUATERNION":
        v, w = (1e-2 * m.vx, 1e-2 * m.vy, 1e-2 * m.vz), (m.rollspeed, m.pitchspeed, m.yawspeed)
        state = TrueState((1e-7 * m.lat, 1e-7 * m.lon, 1e-3 * m.alt), v, tuple(m.attitude_quaternion), w)
    else:
        return None
    return state if all(map(math.isfinite, chain(*state))) else None


class OwnBody(Body):
    """A body that another simulator moves. Our physics makes the air around it and finds its contact with our deck."""

    def __init__(self, scenario: Scenario, seed: int, start: MonoNs, faults: FlightFaults) -> None:
        super().__init__(scenario, seed, STEP_S, 0.0, start, faults, stands=True)
        self.begun = False
        """False while the ship waits for the vehicle to take off."""
        self._p: F64 | None = None
        SIM.fill(self.vehicle.state, tied=0, phase=VehiclePhase.FLYING, airborne_s=1.0)

    @property
    def home(self) -> GeoPoint:
        """The place of the program's vehicle at its start: below the pad, on the still water."""
        north, east, _ = self.pad_motion().p_ned
        return moved(ORIGIN, np.array([north, east, 0.0]))

    @property
    def airframe(self) -> Airframe:
        """The scenario's vehicle as it is flown."""
        return self.vehicle.airframe

    @property
    def height_m(self) -> float:
        return super().height_m if self.begun else -float(self.vehicle.p[2])

    @property
    def v_pad_ned(self) -> F64:
        return super().v_pad_ned if self.begun else np.zeros(3)

    @property
    def air_ned(self) -> F64:
        """Velocity (3,) of the air, m/s."""
        v = self.vehicle
        return np.add(v.air_ned, v.gust) + v.extra_wind

    def move(self, state: TrueState, *, reported: bool) -> None:
        """Advance by one step to a state, unless a foot has touched the deck.

        Args:
            reported: whether the place is that of this step; else it is reckoned from the place before.
        """
        if self.landing is not None:
            return
        if self.begun:
            self.step(_TURNING)
        else:
            self.wait(STEP_S)
        self._truth, v, now_m_s, place = None, self.vehicle, np.array(state.v_ned), ned_between(ORIGIN, state.place)
        if self._p is None:
            self._p, self._v = place, now_m_s
        v.a = ((now_m_s - self._v) / STEP_S).tolist()
        self._p = self._p + 0.5 * STEP_S * (self._v + now_m_s)
        if reported:
            self._p = self._p + STEP_S / _PLACE_OVER_S * (place - self._p)
        self._v = now_m_s
        v.p, v.v, v.w, v.q = self._p.tolist(), state.v_ned, state.w_body, state.quat_wxyz


class OwnVehicle:
    """Lets a program that simulates its own vehicle go on, and advances the flight by what it reports.

    Args:
        stepped: called after each step.
        settle: awaited while the program stands still.
        around: returns what the program gets from the surroundings of its vehicle.
    """

    def __init__(
        self, body: OwnBody, stepped: Callable[[Body], None], settle: Settle, around: Callable[[OwnBody], list[Message]]
    ) -> None:
        self._body, self._stepped, self._settle, self._around = body, stepped, settle, around
        self._began, self._first_s, self._now_s = asyncio.Event(), math.nan, math.nan
        self._steps = 0
        self._reported = deque[tuple[int, TrueState]]()
        self._codec, self._sent_s = Codec(0, 0, datagrams=True), 0.0

    def on_message(self, message: Message, stack: Stack) -> list[Message]:
        """Process any message of the program, and return the requests for the true state until it comes."""
        state, kind = true_state(message), message.get_type()
        if kind == _CLOCK:
            self._now_s = 1e-3 * message.time_boot_ms
        elif state is not None and not math.isnan(self._now_s):
            if not self._began.is_set():
                self._began.set()
                self._first_s = self._now_s - STEP_S
            self._reported.append((round((self._now_s - self._first_s) / STEP_S), state))
        elif kind == "HEARTBEAT" and not self._began.is_set():
            interval, each_us = mav.MAV_CMD_SET_MESSAGE_INTERVAL, round(1e6 * STEP_S)
            ids = [message_id(name) for name in (_CLOCK, TRUTH[stack])]
            return [mav.MAVLink_command_long_message(1, 1, interval, 0, n, each_us, 0, 0, 0, 0, 0) for n in ids]
        return []

    def ahead_s(self, data: bytes) -> float:
        """Return the time by which the program was ahead of the flight when it sent a datagram, by the newest stamp so far, s."""
        for m in self._codec.feed(data):
            stamps = (1e-3 * getattr(m, "time_boot_ms", 0), 1e-6 * getattr(m, "time_usec", 0), 1e-9 * getattr(m, "tc1", 0))
            self._sent_s = max(self._sent_s, *stamps)
        ahead_s = self._sent_s - self._first_s - STEP_S * self._steps
        return max(ahead_s, 0.0) if math.isfinite(ahead_s) else 0.0

    async def run(self, program: Program, send: Callable[[Message], object]) -> None:
        """Go on until the flight ends."""
        await self._began.wait()
        program.run_for(0.0)
        while True:
            if not self._reported:
                program.run_for(_SLICE_S)
                await self._settle()
                continue
            due, state = self._reported.popleft()
            while self._steps < due:
                self._steps += 1
                self._body.move(state, reported=self._steps == due)
                self._stepped(self._body)
                if self._steps % _AROUND_EVERY == 0:
                    for message in self._around(self._body):
                        send(message)
                await self._settle()


_ASK_S = 5.0
"""Time for which an answer is awaited to the request for the true state."""
_ASKS = 3
"""Requests after which the simulator has none."""
_EACH_US = 20_000
"""Interval in which the true state is requested."""
_TRUTH_LAST_S = 1.0
"""Time for which a reported true state counts: fifty of its intervals."""
_GAP_S = 0.2
"""Longest time over which the newest position is carried on to the attitude's instant."""
_MEAN_S = 3.0
"""Time over which the distance between truth and estimate is averaged."""


class AutopilotPose(Struct, frozen=True, eq=False):
    """The body at one instant."""

    at: MonoNs
    p_ned: F64
    """(3,) position from the source's origin, m."""
    v_ned: F64
    """(3,) velocity, m/s."""
    R_ned_body: Rotation
    w_body: F64
    """(3,) angular velocity, rad/s; zeros if no source reports it."""
    is_truth: bool
    """True if the position is the simulator's true one; otherwise it is the autopilot's estimate."""


class PoseSource:
    """Estimate the vehicle's pose from all its messages.

    The pose is the autopilot's own, which is smooth and stamped. If the simulator reports the true position, the pose is shifted
    by the mean difference of the two, because the true position comes in steps of a centimetre and without a stamp of the
    autopilot's clock.
    """

    def __init__(self) -> None:
        self._origin: GeoPoint | None = None
        self._truth_at: MonoNs | None = None
        self._w_body = np.zeros(3)
        self._apart = np.zeros(3)
        """(3,) mean of the true position minus the autopilot's, m."""
        self._known_s = 0.0
        self._asked: MonoNs | None = None
        self._asks = 0

    def ask(self, stack: Stack, target: tuple[int, int], now: MonoNs) -> list[Message]:
        """Return the request for the true state when it is due, or nothing; a simulator without one ignores it."""
        waits = self._asked is not None and seconds_between(self._asked, now) < _ASK_S
        if stack not in TRUTH or self.truthful(now) or waits or self._asks >= _ASKS:
            return []
        self._asked, self._asks = now, self._asks + 1
        number, every = message_id(TRUTH[stack]), mav.MAV_CMD_SET_MESSAGE_INTERVAL
        return [mav.MAVLink_command_long_message(*target, every, 0, number, _EACH_US, 0, 0, 0, 0, 0)]

    def truthful(self, now: MonoNs) -> bool:
        """Return whether the simulator reported the true position recently."""
        return self._truth_at is not None and seconds_between(self._truth_at, now) < _TRUTH_LAST_S

    def on_message(self, message: Message, now: MonoNs, positions: tuple[LocalPosition, ...]) -> None:
        """Process any message of the vehicle.

        Args:
            positions: the autopilot's own positions at that time, the newest last.
        """
        state = true_state(message)
        if state is not None and positions:
            self._tell(now, state, positions)

    def newest(
        self, now: MonoNs, positions: tuple[LocalPosition, ...], attitude: Attitude | None, *, by_truth: bool = True
    ) -> AutopilotPose | None:
        """Return the pose at the newest attitude, or None before the autopilot has reported its position.

        Args:
            positions: the autopilot's own positions, the newest last.
            attitude: the autopilot's newest attitude.
            by_truth: shift the pose to the true position if it is reported.
        """
        if not positions or attitude is None:
            return None
        last, at = positions[-1], attitude.stamp.measured_at
        since_s = seconds_between(last.stamp.measured_at, at)
        if abs(since_s) > _GAP_S:
            return None
        truthful = by_truth and self.truthful(now)
        p = last.p_body_ned + since_s * last.v_body_ned
        if truthful:
            p = p + self._apart
        return AutopilotPose(at, p, last.v_body_ned, attitude.R_ned_body, self._w_body if truthful else np.zeros(3), truthful)

    def _tell(self, now: MonoNs, state: TrueState, positions: tuple[LocalPosition, ...]) -> None:
        self._origin, last = self._origin or state.place, positions[-1]
        there = last.p_body_ned + seconds_between(last.stamp.measured_at, now) * last.v_body_ned
        apart = ned_between(self._origin, state.place) - there
        since_s = 0.0 if self._truth_at is None else min(max(seconds_between(self._truth_at, now), 1e-3), _TRUTH_LAST_S)
        self._known_s += since_s
        share = 1.0 if self._truth_at is None else since_s / min(max(self._known_s, since_s), _MEAN_S)
        self._apart = self._apart + share * (apart - self._apart)
        self._truth_at, self._w_body = now, np.array(state.w_body, dtype=float)


PERIOD_S = 0.04
"""Interval between two frames, at the fastest."""
_STAMP_SIGMA_S = 0.002
"""Standard deviation of a frame's stamp."""
_OLD_S = 0.3
"""Age of a pose that is shown no more, and the longest wait for vision to be free."""
_TRUTH_S = 3.0
"""Time after the first reported position for which the simulator's truth is awaited."""
_MEET_S = 30.0
"""Longest wait for an autopilot."""
_PLACE_S = 180.0
"""Longest wait for its position: its filter needs a minute after the start."""
_CLEAR_M = 0.15
"""Height over the pad, m, above which the vehicle is not down yet: the last descent rate above it is that of the touchdown."""


class FollowEnd(Struct, frozen=True):
    """The result of the flight."""

    outcome: FlightOutcome | None
    landing: Touchdown | None
    duration_s: float
    """Time since the vehicle was first seen flying, s."""
    health: Health
    by_truth: bool
    """True if the simulator reported the true position; otherwise it is the autopilot's estimate."""
    failure: str
    started: MonoNs


class DeckUnder:
    """The scenario's sea and vessel under a vehicle whose position has another origin.

    Args:
        first: the vehicle's first pose; the pad lies relative to it as at the scenario's start.
        on_ground: the vehicle stands on the ground, so the pad is placed at the height of its feet.
    """

    def __init__(self, scenario: Scenario, seed: int, first: AutopilotPose, on_ground: bool) -> None:
        seeds = flight_seeds(seed)
        self._waves, self._vessel = sea_and_vessel(scenario, [seeds.sea])
        self._renderer = renderer(scenario, self._waves, self._vessel, seeds.camera)
        self._camera_seed = seeds.camera
        self._exposure_s = scenario.camera.exposure_s
        self._began, self._images = first.at, 0
        start, pad = scenario.start, self._vessel.pad_at(0.0)
        below_m = ardrone2().feet.below_m if on_ground else start.height_m
        # The arrow keeps the scenario's heading and the vehicle its own.
        heading = first.R_ned_body.rpy_rad[2]
        to_pad = Rotation.from_rpy(0.0, 0.0, heading) @ np.array([start.pad_forward_m, start.pad_right_m, below_m])
        self._shift = pad.p_ned - (first.p_ned + to_pad)
        self.pad_radius_m = pad_model(scenario).disc_radius_m

    def _deck(self, at: MonoNs) -> tuple[float, F64, F64, F64, F64]:
        t_s = max(seconds_between(self._began, at), 0.0)
        pad = self._vessel.pad_at(t_s)
        return t_s, pad.p_ned, pad.v_ned, pad.R_ned, pad.w

    def frame_at(self, pose: AutopilotPose) -> Callable[[], RenderedFrame]:
        """Return a function that renders the frame from this pose."""
        t_s, p, v, R, w = self._deck(pose.at)
        shot = Exposure(
            t_s=t_s, R_ned_body=pose.R_ned_body, p_body_ned=pose.p_ned + self._shift, R_ned_pad=Rotation(R), p_pad_ned=p,
            v_body_ned=pose.v_ned, w_body=pose.w_body, v_pad_ned=v, w_pad=w,
        )  # fmt: skip
        self._images += 1
        rng = np.random.default_rng([self._camera_seed, self._images])
        return lambda: RenderedFrame(self._renderer.render(shot, rng), pose.at, self._exposure_s)

    def height_m(self, pose: AutopilotPose) -> float:
        """Return the body's height over the pad's centre, metres."""
        return float((self._deck(pose.at)[1] - pose.p_ned - self._shift)[2])

    def landing(self, pose: AutopilotPose, descent_rate_m_s: float) -> Touchdown:
        """Return the landing that this pose would be if the body were on the deck there.

        Args:
            descent_rate_m_s: the descent rate before the contact.
        """
        t_s, p, v, R, _ = self._deck(pose.at)
        d = R.T @ (pose.p_ned + self._shift - p)
        lateral_m = float(np.hypot(d[0], d[1]))
        yaw = wrap_pi(pose.R_ned_body.rpy_rad[2] - Rotation(R).rpy_rad[2])
        slide = pose.v_ned - v
        surface: Surface = "pad" if lateral_m <= self.pad_radius_m else "deck"
        slide_m_s = math.hypot(slide[0], slide[1])
        at = MonoNs(round(t_s * NS_PER_S))
        return Touchdown(at, surface, d, lateral_m, yaw, descent_rate_m_s, slide_m_s, None, None)


async def follow(scenario: Scenario, seed: int, settings: Settings, url: str, observers: Sequence[Observer] = ()) -> FollowEnd:
    """Run the daemon until its flight has ended or the scenario's time is over.

    Raises:
        BadInput: the URL is not valid, or the scenario's camera hangs on a gimbal.
    """
    if scenario.gimbal.given:
        raise BadInput("gimbal: only an autopilot in miniature (--autopilot) has a simulated one")
    cv2.setNumThreads(1)
    clock = SystemClock()
    settings = beside_autopilot(settings, url, "automatic")
    pilot = make_pilot(settings)
    side = FlightDaemon(settings, pilot, clock, observers)
    watcher = _Watcher(scenario, seed, side, clock)
    with ThreadPoolExecutor(1, thread_name_prefix="camera") as pool:
        async with asyncio.TaskGroup() as group:
            daemon = group.create_task(side.daemon.run())
            failure = await watcher.film(pool, daemon)
            side.daemon.stop()
            await daemon
    on_ground = pilot.outcome in (FlightOutcome.LANDED, FlightOutcome.LANDED_BY_OTHERS)
    landing, started = watcher.landing if on_ground else None, watcher.flew or MonoNs(0)
    return FollowEnd(pilot.outcome, landing, watcher.flown_s, side.daemon.health, watcher.by_truth, failure, started)


class _Watcher:
    """Receives poses, makes frames and records the touchdown."""

    def __init__(self, scenario: Scenario, seed: int, side: FlightDaemon, clock: SystemClock) -> None:
        self._scenario, self._seed, self._side, self._clock = scenario, seed, side, clock
        self._source = PoseSource()
        self._deck: DeckUnder | None = None
        self.flew: MonoNs | None = None
        self._newest: AutopilotPose | None = None
        self._placed: MonoNs | None = None
        """Instant of the first pose with a position."""
        self._descent_rate_m_s = 0.0
        self._listening: object = None
        self._last: AutopilotPose | None = None
        self.by_truth = False
        self.frames = 0

    @property
    def landing(self) -> Touchdown | None:
        """The landing by the last received pose; None if none was received."""
        if self._deck is None or self._last is None:
            return None
        return self._deck.landing(self._last, self._descent_rate_m_s)

    @property
    def flown_s(self) -> float:
        return 0.0 if self.flew is None else seconds_between(self.flew, self._clock.now())

    async def film(self, pool: ThreadPoolExecutor, daemon: asyncio.Task[FlightOutcome | None]) -> str:
        """Make frames, one a period, and return the reason why there was no flight, or an empty text."""
        loop, began = asyncio.get_running_loop(), self._clock.now()
        while not daemon.done():
            turn = self._clock.now()
            pose = self._next_pose(turn)
            if pose is None:
                met = self._side.autopilot is not None and self._side.autopilot.identity is not None
                limit_s = _PLACE_S if met else _MEET_S
                if self._deck is None and seconds_between(began, turn) > limit_s:
                    return f"{'it reported no position' if met else 'no autopilot was found'} within {limit_s:.0f} s"
            elif self._ready_for(pose):
                assert self._deck is not None
                self._newest = pose
                image = await loop.run_in_executor(pool, self._deck.frame_at(pose))
                self.frames += 1
                stamp = Stamp(pose.at, max(self._clock.now(), pose.at), _STAMP_SIGMA_S, "sim")
                self._side.offer(Frame(stamp, self.frames, image.px, image.exposure_s))
            if self.flown_s > self._scenario.duration_limit_s:
                return ""
            await self._clock.sleep(max(PERIOD_S - seconds_between(turn, self._clock.now()), 0.002))
        return ""

    def _ready_for(self, pose: AutopilotPose) -> bool:
        """Return whether a new frame can be made and vision is free: a slow machine gets fewer frames, not later ones."""
        if self._deck is None or (self._newest is not None and pose.at <= self._newest.at):
            return False
        waited_s = _OLD_S if self._newest is None else seconds_between(self._newest.at, pose.at)
        return self._side.concluded() >= self.frames or waited_s >= _OLD_S

    def _next_pose(self, now: MonoNs) -> AutopilotPose | None:
        autopilot = self._side.autopilot
        if autopilot is None or autopilot.identity is None:
            return None
        if autopilot is not self._listening:
            self._listening = autopilot
            autopilot.add_listener(self._on_message)
        late = self._deck is not None and not self.by_truth
        if autopilot.streams is not None and autopilot.streams.settled and not late:
            for message in self._source.ask(autopilot.identity.stack, autopilot.identity.address, now):
                autopilot.send(message)
        pose = self._source.newest(now, autopilot.positions, autopilot.attitude, by_truth=not late)
        flying = autopilot.condition.flying
        if pose is None or flying is None or abs(seconds_between(pose.at, now)) > _OLD_S:
            return None
        if self._deck is None:
            self._placed = self._placed or now
            if not pose.is_truth and seconds_between(self._placed, now) < _TRUTH_S:
                return None  # the simulator may still report the true position, which has another origin
            self._deck, self.by_truth = DeckUnder(self._scenario, self._seed, pose, not flying), pose.is_truth
        if pose.is_truth is not self.by_truth:
            return None
        if flying and self.flew is None:
            self.flew = now
        if self._deck.height_m(pose) > _CLEAR_M:
            self._descent_rate_m_s = float(pose.v_ned[2])
        self._last = pose
        return pose

    def _on_message(self, received: ReceivedMessage) -> None:
        autopilot = self._side.autopilot
        if autopilot is None or autopilot.identity is None or received.system != autopilot.identity.system:
            return
        self._source.on_message(received.message, received.received_at, autopilot.positions)
