"""The service falls silent at each phase of a flight, in virtual time: helm, sender's logic, drone, physics; no vision."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from msgspec import Struct

from drivers.ardrone import at
from drivers.ardrone.arbiter import CommandArbiter
from drivers.ardrone.custody import CommandStreamer
from drivers.ardrone.navdata_channel import NavdataSampler
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.setup import configuration_commands
from estimator.contracts.commands import Command, Hover, Land, TakeOff, Velocity
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between
from sitl.ardrone.drone import TICK_S, Drone, DroneClock
from sitl.scenario.scenario import Start, load
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.world import World

OPTIONS = ArDroneOptions()
PERIOD_TICKS = 6
CYCLE_TICKS = 4


def go(forward: float, down: float = 0.0) -> Velocity:
    return Velocity(np.array([forward, 0.0, down]), 0.0)


class Bench:
    """A drone over the demo's sea, a service that steers it, and a sender; each can be silent."""

    def __init__(self, height_m: float, seed: int) -> None:
        place = Start(where="pad") if height_m == 0.0 else Start(height_m=height_m)
        self.world = World(msgspec.structs.replace(load("demo"), start=place, faults=()), seed)
        self.drone = Drone(self.world, DroneClock(self.world.now))
        self.sequence, self.ticks = 0, 0
        self.moves: list[tuple[float, bool]] = []
        self.refs: list[int] = []
        self.service()
        self.arbiter = CommandArbiter(OPTIONS.hold_s, OPTIONS.vz_max_m_s)
        for _, commands in configuration_commands(OPTIONS):
            self.tell([*commands, at.Ctrl(at.CTRL_ACK)])

    def service(self) -> None:
        """Start a new process of the service, which knows nothing."""
        self.streamer, self.sampler = CommandStreamer(OPTIONS), NavdataSampler(OPTIONS)

    @property
    def now(self) -> MonoNs:
        return self.world.now

    @property
    def height_m(self) -> float:
        return float(self.world.truth().d_body_pad_level[2])

    def tell(self, commands: list[at.AtCommand]) -> None:
        for command in commands:
            self.sequence += 1
            self.drone.take(at.encode(self.sequence, command), self.now)
            if isinstance(command, at.Pcmd):
                self.moves.append((self.now * 1e-9, bool(command.flags) and command.gaz < 1.0))
            elif isinstance(command, at.Ref):
                self.refs.append(command.bits)

    def run(
        self, seconds: float, guidance: Callable[[], Command] | None = None, *, service: bool = True, sender: bool = True
    ) -> None:
        """Let time pass with guidance saying this in each cycle; None is a guidance, or a whole service, that says nothing."""
        for _ in range(round(seconds / TICK_S)):
            now = after(self.now, TICK_S)
            self.drone.tick(now)
            self.ticks += 1
            navdata = self.drone.navdata()
            received_at = after(now, 0.004)
            if service:
                self.streamer.on_navdata(navdata, received_at)
                for sample in self.sampler.samples(navdata, Stamp(now, received_at, 0.002, "sim")):
                    self.streamer.on_sample(sample)
                if guidance is not None and self.ticks % CYCLE_TICKS == 0:
                    self.streamer.take(guidance(), received_at)
            elif sender and self.arbiter.silent_s(now) > 0.0:
                self.arbiter.on_report(navdata, received_at)
            if self.ticks % PERIOD_TICKS == 0:
                if service:
                    self.arbiter.take(self.streamer.command(received_at))
                if sender:
                    self.tell(self.arbiter.commands(received_at))

    def hover_after_s(self, instant: MonoNs) -> float:
        return max((t - instant * 1e-9 for t, moves in self.moves if moves and t > instant * 1e-9), default=0.0)


class Moment(Struct, frozen=True):
    """A phase of the flight: from which height, what guidance says, for how long."""

    height_m: float
    command: Command
    seconds: float
    ends: VehiclePhase = VehiclePhase.HOVERING


MOMENTS = {
    "before take-off": Moment(0.0, Hover(), 1.0, VehiclePhase.LANDED),
    "taking off": Moment(0.0, TakeOff(), 0.5),
    "waiting": Moment(2.0, Hover(), 1.0),
    "approach": Moment(3.0, go(0.4), 1.0),
    "descend": Moment(2.2, go(0.1, 0.3), 1.5),
    "last half metre": Moment(0.8, go(0.05, 0.2), 1.5),
    "landing ordered high": Moment(1.8, Land(), 0.5),
    "landing ordered low": Moment(0.35, Land(), 0.2, VehiclePhase.LANDED),
    "lost": Moment(1.5, Hover(), 1.0),
    "climb": Moment(1.0, go(0.0, -0.3), 1.0),
    "after landing": Moment(0.3, Land(), 2.5, VehiclePhase.LANDED),
}


@pytest.mark.hazard("H5")
@pytest.mark.parametrize(
    ("name", "silence"),
    [(name, "killed") for name in MOMENTS]
    + [(name, silence) for name in ("approach", "descend", "landing ordered high") for silence in ("stopped", "guidance stuck")],
)
def test_nothing_we_sent_outlives_us(name: str, silence: str) -> None:
    moment, bench = MOMENTS[name], Bench(MOMENTS[name].height_m, seed=3)
    bench.run(moment.seconds, lambda: moment.command)
    before, height_m = bench.now, bench.height_m
    p = np.array(bench.world.truth().d_body_pad_level)
    refs = len(bench.refs)
    if silence == "killed":
        bench.arbiter.lost(bench.now)
    bench.run(5.0, service=silence == "guidance stuck")
    assert bench.hover_after_s(before) <= 0.15
    truth = bench.world.truth()
    assert bench.world.phase is moment.ends, "the drone does not land by itself while the sender holds it"
    assert not any(ref & at.REF_EMERGENCY for ref in bench.refs)
    if moment.ends is VehiclePhase.LANDED:
        assert at.REF_BASE | at.REF_TAKE_OFF not in bench.refs[refs:], "the wish to fly would start its motors"
        assert not truth.contacts or truth.contacts[-1].on_pad
        return
    assert truth.contacts == ()
    assert bench.height_m > height_m - 0.45, "never sent lower"
    if silence != "guidance stuck":
        assert bench.height_m > 1.5, "a deck in waves comes up to one that stays low"
    assert np.hypot(*(np.array(truth.d_body_pad_level) - p)[:2]) < 1.0
    if name == "last half metre":  # a new service finds the drone where it hovers, and lands it
        bench.service()
        bench.run(0.2, Hover)
        bench.run(8.0, Land)
        assert bench.world.phase is VehiclePhase.LANDED


def test_a_landing_for_silence_is_called_off_by_whoever_comes_back() -> None:
    """Service and sender are both gone for five seconds, as is the radio: the firmware hovers, then lands."""
    bench = Bench(2.5, seed=1)
    bench.run(1.0, lambda: go(0.3))
    bench.run(5.0, service=False, sender=False)
    assert bench.world.phase is VehiclePhase.LANDING
    height_m = bench.height_m
    assert height_m > 1.0
    bench.service()
    bench.arbiter = CommandArbiter(OPTIONS.hold_s, OPTIONS.vz_max_m_s)
    bench.run(2.0, Hover)
    assert bench.world.phase is VehiclePhase.HOVERING
    assert bench.height_m > height_m - 0.5
    assert bench.drone.counters["stay_up"] == 1


def test_a_landing_by_a_low_battery_is_left_alone() -> None:
    bench = Bench(2.5, seed=1)
    bench.run(0.5, Hover)
    bench.world.vehicle.land()  # as the firmware does by itself, or another's remote control
    bench.run(3.0, Hover)
    assert bench.world.phase in (VehiclePhase.LANDING, VehiclePhase.LANDED)
    assert bench.drone.counters["stay_up"] == 0


def test_the_sender_gives_up_in_the_end_and_the_drone_lands_by_its_own_rules() -> None:
    bench = Bench(2.0, seed=2)
    bench.arbiter = CommandArbiter(3.0, OPTIONS.vz_max_m_s)
    bench.run(1.0, Hover)
    quiet = bench.now
    bench.run(8.5, service=False)
    assert seconds_between(quiet, bench.now) > 3.0 + 2 * OPTIONS.com_watchdog_s
    assert bench.world.phase in (VehiclePhase.LANDING, VehiclePhase.LANDED)


def test_a_stick_of_before_presses_no_take_off_down() -> None:
    """WHY: after a landing that was pressed on the deck, each take-off fell back onto it and stood there with turning motors."""
    bench = Bench(1.0, 5)
    bench.run(2.5, lambda: go(0.0, 1.5))
    bench.run(6.0, Land)
    assert bench.world.phase is VehiclePhase.LANDED
    bench.run(3.0, TakeOff)
    bench.run(4.0, Hover)
    assert bench.height_m > 0.5
