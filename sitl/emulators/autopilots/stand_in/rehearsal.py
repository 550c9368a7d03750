"""An autopilot in miniature in real time: sea, ship, vehicle and camera on this machine, and its MAVLink on sockets.

The service that flies it is the real one, in the same process: its link is a UDP port of this machine, and it gets the frames of
the simulated camera beside that link, as from a camera of its own. Another link goes to ground stations, the doctor and whoever
else listens there, and stays up until the rehearsal ends.

A scenario that starts in the air begins where a pilot has brought the vehicle; he stays over that place, with the ship, until the
service takes the vehicle or somebody else its mode. One that starts on the pad begins disarmed.
"""

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from functools import partial

import cv2

from companion.base.health import Health
from companion.base.mission import State
from companion.base.observer import Decision, NullObserver, Observer
from companion.guidance.pilot import Pilot
from companion.service.daemon import Daemon
from companion.settings.model import Settings
from drivers.camera.exposure import ExposureSetting
from drivers.clock import SetClock, SystemClock
from drivers.endpoint import parse_endpoint
from drivers.mavlink.access import NamedSenders
from drivers.mavlink.links import LinkOptions, open_links
from drivers.mavlink.vehicle import VELOCITY_MODE
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Frame
from estimator.contracts.time import Stamp, after, seconds_between
from sitl.camera.film import SimulatedExposure
from sitl.camera.render_worker import RenderWorker, render_worker
from sitl.emulators.autopilots.beside import beside_autopilot, driven_exposure, exposure_beside, offer, report
from sitl.emulators.autopilots.body import Body, view_of
from sitl.emulators.autopilots.conduct import STATION_S, begun_in_air, take_off_m
from sitl.emulators.autopilots.lock_step import STAMP_SIGMA_S, CameraTiming
from sitl.emulators.autopilots.programs.arducopter import CURVE
from sitl.emulators.autopilots.programs.program import reserved_port
from sitl.emulators.autopilots.stand_in.base import STEP_S, GimbalLink
from sitl.emulators.autopilots.stand_in.flight import StackName, make_stand_in
from sitl.emulators.autopilots.station import STATION, GroundStation
from sitl.flight.vessel_reports import VesselReporter
from sitl.scenario.scenario import Scenario
from sitl.world.truth import RenderedFrame, Truth

CATCH_UP_MAX_S = 0.25
"""Longest standstill of this machine that is caught up; the world then goes on where it stood."""
_TRUTH_EACH, _STATION_EACH = round(0.04 / STEP_S), round(STATION_S / STEP_S)
"""Steps between two true states that are kept, and between two acts of the pilot."""
_TRUTHS_MAX = round(3600.0 / (_TRUTH_EACH * STEP_S))
"""Most true states that are kept: the last hour's, however long a page is left open."""
_WAITS = frozenset(state.value for state in (State.STANDBY, State.WAIT, State.READY))
"""Phases of guidance before the first order."""
_FRAMES_MAX_HZ = 60.0
"""Highest rate of the simulated camera."""


class Rehearsal(NullObserver):
    """One rehearsal. It is an observer of the service that flies, and opened once.

    Args:
        settings: of an autopilot in a simulated world (`sitl.scenario.settings.rig_for` with `by_autopilot`).
        station: link to ground stations.

    Raises:
        BadInput: the scenario has faults, which act in virtual time (`decklander simulate --config`).
    """

    def __init__(self, scenario: Scenario, seed: int, settings: Settings, autopilot: StackName, station: str) -> None:
        if scenario.faults:
            raise BadInput("its faults act in virtual time alone: decklander simulate --autopilot, with --config too")
        cv2.setNumThreads(1)  # threads of OpenCV do not survive in the process that renders
        self._clock, self._station_url = SystemClock(), station
        self.stands = scenario.start.where == "pad"
        """True if the vehicle stands on the pad at first, disarmed."""
        self.scenario = scenario = begun_in_air(scenario, seed)
        self.autopilot: StackName = autopilot
        curve, now = CURVE if autopilot == "arducopter" else 0.0, self._clock.now()
        self.body = Body(scenario, seed, STEP_S, curve, now, stands=self.stands)
        self._time = SetClock(now)
        """Time of the world, which follows this machine's."""
        self.stand_in = make_stand_in(autopilot, self._time, scenario)
        self.body.on_failsafe = self.stand_in.acts_by_failsafe
        if self.body.gimbal is not None:
            self.stand_in.gimbal = GimbalLink(self.body.gimbal, self.stand_in.system)
        self.settings, self._reporter = settings, VesselReporter(self.body)
        self._pilot = None if self.stands else GroundStation(self.stand_in.stack, height_m=take_off_m(scenario))
        self._delay_s, self._period_s = CameraTiming().delay_s, 1.0 / min(settings.camera.rate_hz, _FRAMES_MAX_HZ)
        self._drive = driven_exposure(settings)
        if self._drive is not None:
            held, white_k = ExposureSetting(scenario.camera.exposure_s, 1.0), settings.camera.exposure.white_balance_k
            self.body.exposure = SimulatedExposure(self._drive, held, self._period_s, white_k, lambda: self.frames_sent)
        self._daemon: Daemon | None = None
        """The service that gets frames and reports; None while there is none."""
        self._worker: RenderWorker | None = None
        """Renders frames in a process of its own; None renders them in a thread."""
        self._truths = deque[Truth](maxlen=_TRUTHS_MAX)
        self.frames_due = self.frames_sent = 0
        """Frames that a machine that is fast enough would have rendered, and those that it did."""
        self.stood_still_s = 0.0
        """Total time in which this machine kept the world from going on."""
        self._steps = 0

    @contextmanager
    def rendering(self) -> Iterator[None]:
        """Render frames beside this process while the context is open; enter it before any thread is started."""
        self.body.render()  # the first frame takes longest: before the world has to keep time
        if self._drive is not None:
            yield
            return
        with render_worker(self.body.renderer) as self._worker:
            yield

    @asynccontextmanager
    async def flying(self) -> AsyncIterator[Settings]:
        """Let the world go on while the context is open; give the settings of a service that flies in it.

        Raises:
            Recoverable: this machine has no free port.
        """
        with reserved_port() as port:
            options = [LinkOptions(parse_endpoint(url)) for url in (f"udpout://127.0.0.1:{port}", self._station_url)]
            senders = NamedSenders(everybody=True)
            async with open_links(options, self._clock, (self.stand_in.system, 1), senders) as links:
                self.stand_in.links = links
                self._wait(seconds_between(self.body.at, self._clock.now()))
                self.body.begin()
                if not self.stands:
                    self.stand_in.begin_in_air(self.body.state())
                with ThreadPoolExecutor(1, "camera") as pool:
                    async with asyncio.TaskGroup() as group:
                        tasks = [group.create_task(self._fly()), group.create_task(self._film(pool))]
                        response = "px4" if self.autopilot == "px4" else None
                        yield beside_autopilot(self.settings, f"udpin://127.0.0.1:{port}", response=response)
                        for task in tasks:
                            task.cancel()

    def serve(self, daemon: Daemon) -> None:
        """Give frames and the ship's reports to this service."""
        self._daemon = daemon

    def truth(self) -> Sequence[Truth]:
        """Return the true states that a recording keeps, in order of time, and the newest."""
        last = self.body.truth()
        return (*(one for one in self._truths if one.at < last.at), last)

    def observers(self, pilot: Pilot, health: Health) -> tuple[Observer, ...]:
        """Return the observers by which the service is followed, and drives the exposure where its settings say so."""
        return (self, *exposure_beside(self.settings, pilot, health, self._drive)[1])

    def on_decision(self, decision: Decision) -> None:
        """Let the pilot who brought the vehicle go once the service does anything with it."""
        self.body.guidance_phase = decision.phase
        if decision.phase not in _WAITS:
            self._pilot = None

    async def _fly(self) -> None:
        while True:
            behind_s = seconds_between(self._time.t, self._clock.now())
            if behind_s > CATCH_UP_MAX_S:
                self.stood_still_s += behind_s if self._daemon is not None else 0.0  # it is being made until then
                self._wait(behind_s)
            elif behind_s < STEP_S:
                await self._clock.sleep(STEP_S - behind_s)
                continue
            self._step()
            await self._clock.sleep(0.0)

    def _wait(self, seconds: float) -> None:
        self.body.wait(seconds)
        self._time.t = self.body.at

    def _step(self) -> None:
        program, body = self.stand_in, self.body
        program.read()
        motors = program.step(body.state())
        program.report()
        body.step(motors)
        now = self._time.t = body.at
        self._steps += 1
        if self._pilot is not None and self._steps % _STATION_EACH == 0:
            if program.mode == VELOCITY_MODE[program.stack]:
                program.take(self._pilot.to_start(now, view_of(body)), STATION)
            else:  # somebody has chosen another one
                self._pilot = None
        if self._steps % _TRUTH_EACH == 0:
            self._truths.append(body.truth())
        if (daemon := self._daemon) is not None:
            for sample in self._reporter.reports(now):
                report(daemon, sample)

    async def _film(self, pool: ThreadPoolExecutor) -> None:
        loop, due = asyncio.get_running_loop(), self._clock.now()
        while True:
            await self._clock.sleep(max(0.0, seconds_between(self._clock.now(), due)))
            # A machine too slow to render them all films fewer.
            before, due = due, max(after(due, self._period_s), after(self._clock.now(), -self._period_s))
            self.frames_due += round(seconds_between(before, due) / self._period_s)
            image = await loop.run_in_executor(pool, self.body.expose(self._worker))
            wait_s = self._delay_s - seconds_between(image.exposed_at, self._clock.now())
            loop.call_later(max(0.0, wait_s), partial(self._arrive, image))

    def _arrive(self, image: RenderedFrame) -> None:
        self.frames_sent += 1
        stamp = Stamp(image.exposed_at, max(image.exposed_at, self._clock.now()), STAMP_SIGMA_S, "sim")
        if self._daemon is not None:
            offer(self._daemon, Frame(stamp, self.frames_sent, image.px, image.exposure_s, image.gain))
