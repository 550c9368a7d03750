"""The people of a flight with an autopilot, and its end: the operator at the ground station, a person beside it, the referee.

Programs behind sockets and the stand-ins in virtual time are flown by the same rules; only time and wires differ.
"""

import math
from collections.abc import Callable
from typing import Literal, Protocol

from msgspec import Struct, structs

from companion.base.health import Health
from companion.base.mission import REFUSALS, FlightOutcome
from companion.guidance.pilot import Pilot
from companion.settings.model import Settings
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.joined_texts import ARMING_REFUSAL
from drivers.mavlink.vehicle import LAND_MODE, TARGET_MODE, Stack
from estimator.contracts.geometry import ned_between
from estimator.contracts.time import MonoNs, seconds_between
from sitl.emulators.autopilots.body import Body, Silence, view_of
from sitl.emulators.autopilots.lock_step import START
from sitl.emulators.autopilots.programs import arducopter, px4
from sitl.emulators.autopilots.station import GroundStation, Task
from sitl.emulators.autopilots.watch import FlightWatch
from sitl.faults.faulty_streams import FlightFaults
from sitl.flight.ending import Ending
from sitl.flight.person import SimulatedPerson
from sitl.scenario.scenario import Scenario
from sitl.sensors.sensors import ORIGIN

Name = Literal["arducopter", "arduplane", "px4"]
STACKS: dict[Name, Stack] = {"arducopter": Stack.ARDUPILOT, "arduplane": Stack.PLANE, "px4": Stack.PX4}
COM_WATCHDOG_S: dict[Name, float] = {
    "arducopter": arducopter.PARAMETERS["GUID_TIMEOUT"],
    "arduplane": 0.5,
    "px4": px4.PARAMETERS["COM_OF_LOSS_T"],
}
"""Time for which each program flies on with the last setpoint."""
STATION_S = 0.05
"""Time between two looks of the people, s."""


class FlightEnd(Struct, frozen=True):
    """The result of the flight."""

    ending: Ending
    """The end of the flight, judged from the order to land on."""
    health: Health
    texts: tuple[tuple[float, int, str], ...]
    """Status texts of autopilot and companion: s since the program's start, component, text."""
    failure: str = ""
    """The reason why no landing took place."""
    armed_after_contact_s: float | None = None
    """Time for which the motors turned after the newest contact; None if they never stopped, or there was none."""
    silences: tuple[Silence, ...] = ()
    """Flight of the vehicle while the service was killed."""
    tracking_m: float | None = None
    """Distance from the pad on the way down (`FlightWatch.tracking_m`); None for a flight that did not come so far."""
    elsewhere_m: float | None = None
    """Horizontal distance in which a refused vehicle ended from the place at which it was to land; None for another end."""

    def as_json(self) -> dict[str, object]:
        """Return plain values: the ending's, and what there is of an autopilot's flight alone."""
        return {
            **self.ending.as_json(),
            "failure": self.failure or None,
            "armed_after_contact_s": None if self.armed_after_contact_s is None else round(self.armed_after_contact_s, 2),
            "failsafes": list(self.failsafes),
            "tracking_m": None if self.tracking_m is None else round(self.tracking_m, 3),
            "elsewhere_m": None if self.elsewhere_m is None else round(self.elsewhere_m, 2),
            "silences": [silence.as_json() for silence in self.silences],
        }

    @property
    def failsafes(self) -> tuple[str, ...]:
        """Texts of the autopilot about failsafes, each once. A refusal to arm for one is repeated until it arms, and is none."""
        own = int(mav.MAV_COMP_ID_AUTOPILOT1)
        said = dict.fromkeys(text for _, component, text in self.texts if component == own and "failsafe" in text.lower())
        return tuple(text for text in said if ARMING_REFUSAL.match(text) is None)


class Served(Protocol):
    """The service of a flight, one process of it after the other."""

    gone: bool
    """True if it was killed and no new one runs."""

    @property
    def pilot(self) -> Pilot:
        """The newest process's."""
        ...

    @property
    def health(self) -> Health: ...

    def ended(self, ordered: bool) -> bool:
        """Return whether the newest process ended its flight by itself; `ordered`: it was ordered to land."""
        ...


class Conduct:
    """Acts as the people do, and knows when the flight is over and how.

    Args:
        scenario: of the flight, whose start is in the air: there the order to land comes.
        watch: watches the flight for its grader.
        own: whether the program simulates the vehicle by itself, and knows nothing of our deck.
        unaided: whether the autopilot lands by its own mode.
    """

    def __init__(
        self,
        autopilot: Name,
        scenario: Scenario,
        settings: Settings,
        faults: FlightFaults,
        watch: FlightWatch,
        *,
        own: bool = False,
        unaided: bool = False,
    ) -> None:
        self._scenario, self._settings, self._faults, self.watch = scenario, settings, faults, watch
        self._stack, self._own, self._unaided = STACKS[autopilot], own, unaided
        self.send: Callable[[Message], object] = lambda message: None
        """Sends a message of the ground station."""
        self.station = self.new_station()
        self.silences: list[Silence] = []
        self._silence: Silence | None = None
        """The one that goes on; None while the service is there."""
        self._person = SimulatedPerson(faults, by_remote=self._by_remote)
        self._stopped: MonoNs | None = None
        """Instant when the motors stopped."""

    def new_station(self, ground_m: float = 0.0) -> GroundStation:
        """Return a ground station; `ground_m`: height of the deck over what the vehicle takes for its ground."""
        guidance, lands_by = self._settings.guidance, LAND_MODE[self._stack] if self._unaided else None
        led = guidance.mission == "targets"
        if led and not guidance.mode_changes and lands_by is None:
            lands_by = TARGET_MODE[self._stack]
        height_m = take_off_m(self._scenario) + ground_m
        return GroundStation(self._stack, height_m=height_m, lands_by=lands_by, steers_on=led)

    def on_step(self, body: Body) -> None:
        """Note a step of the physics, and what the vehicle does without a service."""
        if body.flying:
            self._stopped = None
        elif self._stopped is None:
            self._stopped = body.at
        if self.kills:
            now_s, height_m = seconds_between(body.started, body.at), body.over_deck_m
            if self._silence is None:
                self._silence = Silence(now_s, body.guidance_phase, height_m)
                self.silences.append(self._silence)
            silence = self._silence
            silence.step(now_s - silence.at_s, body.state(), height_m, self.station.mode, len(body.contacts))
        else:
            self._silence = None
        if self.station.began is not None:
            self.watch.stepped(body)

    @property
    def kills(self) -> bool:
        """True while the scenario has the service killed."""
        return self._faults.service_gone

    @property
    def meets(self) -> bool:
        """True before the vehicle is about to fly: nobody looks at the pad yet."""
        return self.station.task in (Task.MEET, Task.ARM)

    @property
    def mutes(self) -> bool:
        """True from the order on to an autopilot that is to land unaided."""
        return self._unaided and self.station.task is Task.ORDER

    def period(self, body: Body) -> None:
        """Act as the operator at the ground station; call it every `STATION_S`."""
        for message in self.station.period(body.at, view_of(body)):
            self.send(message)

    def act(self, service: Served, now: MonoNs) -> None:
        """Act as the person beside the flight does."""
        if self.station.began is not None and not service.gone:
            self._person.act(service.pilot.operator, now)

    def back(self, body: Body) -> None:
        """Note that a new process of the service runs; one that was not ordered to land yet is brought back to the start."""
        if self.station.began is None:  # else the new service goes on with the landing that was ordered
            self.station.again(body.at, body.over_deck_m)

    def over(self, body: Body, service: Served) -> bool:
        """Return whether the flight is over; call it after the people have acted."""
        station, lost = self.station, not body.upright
        if station.task is Task.FAILED:
            return True
        if station.began is not None:
            flown_s = seconds_between(station.began, body.at)
            done = self._flown(body, service) and not self._person.gives_back
            return done or self.touched(body) or flown_s > self._scenario.duration_limit_s or lost
        if lost or service.ended(ordered=False):
            station.failure = "it turned over or fell into the water before the landing was ordered"
            return True
        return False

    def touched(self, body: Body) -> bool:
        """Return whether a vehicle that the program simulates by itself has touched our deck, which the program does not know."""
        return self._own and body.landing is not None

    def result(self, body: Body, service: Served) -> Ending:
        """Return how the flight ended, or the result so far."""
        return self.watch.ending(body, self._outcome(body, service), service.pilot, service.health)

    def end(self, ending: Ending, body: Body, service: Served) -> FlightEnd:
        """Return the result of the flight with this ending."""
        landing = None if self.station.began is None else body.landing
        stopped = None if landing is None or self._stopped is None else max(seconds_between(landing.at, self._stopped), 0.0)
        texts = tuple((seconds_between(START, at), component, text) for at, component, text in self.station.texts)
        return FlightEnd(
            ending,
            service.health,
            texts,
            self.station.failure,
            stopped,
            tuple(self.silences),
            self.watch.tracking_m,
            self._from_elsewhere_m(body, service),
        )

    def _outcome(self, body: Body, service: Served) -> FlightOutcome | None:
        """Return the pilot's outcome, and of a program that nobody tells of our deck or of the pad its landing."""
        if self.touched(body):
            return FlightOutcome.LANDED
        if self._unaided:
            stands = body.upright and not body.flying and body.landing is not None
            return FlightOutcome.LANDED if stands else None
        return service.pilot.outcome

    def _flown(self, body: Body, service: Served) -> bool:
        """Return whether the landing that was ordered has ended by itself."""
        if self._unaided or self._refused(service):
            return not body.flying
        return service.ended(self.station.task is Task.WATCH)

    def _refused(self, service: Served) -> bool:
        """Return whether the service has refused and the vehicle leaves the pad."""
        return self._settings.guidance.refused != "hold" and service.pilot.outcome in REFUSALS

    def _from_elsewhere_m(self, body: Body, service: Served) -> float | None:
        of = self._settings.guidance
        if of.refused != "land elsewhere" or not self._refused(service):
            return None
        there = ned_between(ORIGIN, of.elsewhere.landing_place.place)
        return math.hypot(*(body.state().p_ned - there)[:2])

    def _by_remote(self, act: str) -> None:
        """Act as a pilot with a remote control does: choose the autopilot's mode that holds, or stop the motors."""
        self.send(self.station.holds() if act == "mode" else self.station.disarms())
        self.watch.on_remote(act)


def begun_in_air(scenario: Scenario, seed: int) -> Scenario:
    """Return the scenario of a flight by autopilot: the order to land comes in the air, wherever the vehicle starts."""
    start, wrong = structs.replace(scenario.start, where="air"), scenario.wrong_model.drawn(seed)
    return structs.replace(scenario, start=start, wrong_model=wrong)


def take_off_m(scenario: Scenario) -> float:
    """Return the height of a take-off."""
    return max(scenario.start.height_m, 2.0)
