"""Add a simulated deck and camera to a vehicle that another simulator flies.

The vehicle's pose comes over MAVLink, from that simulator or from its autopilot. The camera renders from that pose, and the
daemon flies the landing. The deck moves, but the ground of the other simulator does not: if the deck heaves, only the horizontal
position of a touchdown counts.
"""

import asyncio
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from msgspec import Struct

from companion.base.health import Health
from companion.base.mission import FlightOutcome
from companion.base.observer import Observer
from companion.guidance.pilot import make_pilot
from companion.settings.model import Settings
from drivers.clock import SystemClock
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.requests import message_id
from drivers.mavlink.samples import LocalPosition
from drivers.mavlink.vehicle import Stack
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, GeoPoint, Rotation, ned_between, wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp, seconds_between
from sitl.camera.camera import Exposure
from sitl.emulators.autopilots.beside import FlightDaemon, beside_autopilot
from sitl.emulators.autopilots.own import TRUTH, TrueState, true_state
from sitl.scenario.scenario import Scenario, pad_model
from sitl.vehicle.airframe import Airframe
from sitl.world.stage import flight_seeds, renderer, sea_and_vessel
from sitl.world.truth import RenderedFrame, Surface, Touchdown

_ASK_S, _ASKS = 5.0, 3
_EACH_US = 20_000
"""Interval in which the true state is requested."""
_TRUTH_LAST_S = 1.0
_GAP_S = 0.2
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
_STAMP_SIGMA_S = 0.002
_OLD_S = 0.3
_TRUTH_S = 3.0
"""Time after the first reported position for which the simulator's truth is awaited."""
_MEET_S, _PLACE_S = 30.0, 180.0
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
    failure: str = ""


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
        below_m = Airframe().feet.below_m if on_ground else start.height_m
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
        raise BadInput("gimbal: only the stand-in for an autopilot (--autopilot, --binary stand-in) has a simulated one")
    cv2.setNumThreads(1)
    clock = SystemClock()
    settings = beside_autopilot(settings, url, start=settings.guidance.start)
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
    return FollowEnd(
        pilot.outcome, watcher.landing if on_ground else None, watcher.flown_s, side.daemon.health, watcher.by_truth, failure
    )


class _Watcher:
    """Receives poses, makes frames and records the touchdown."""

    def __init__(self, scenario: Scenario, seed: int, side: FlightDaemon, clock: SystemClock) -> None:
        self._scenario, self._seed, self._side, self._clock = scenario, seed, side, clock
        self._source = PoseSource()
        self._deck: DeckUnder | None = None
        self._flew: MonoNs | None = None
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
        return 0.0 if self._flew is None else seconds_between(self._flew, self._clock.now())

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
        if flying and self._flew is None:
            self._flew = now
        if self._deck.height_m(pose) > _CLEAR_M:
            self._descent_rate_m_s = float(pose.v_ned[2])
        self._last = pose
        return pose

    def _on_message(self, received: ReceivedMessage) -> None:
        autopilot = self._side.autopilot
        if autopilot is None or autopilot.identity is None or received.system != autopilot.identity.system:
            return
        self._source.on_message(received.message, received.received_at, autopilot.positions)
