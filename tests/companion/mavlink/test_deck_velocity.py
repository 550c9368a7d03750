"""The pad's own velocity over the ground: found under a moving pad, none under a still one, held without sight, forgotten."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from companion.parts.mavlink.make import FORGET_S, KEEP_S, DeckVelocity
from drivers.clock import SystemClock
from drivers.mavlink.autopilot import open_autopilot
from drivers.mavlink.dialect import Message
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.samples import LocalPosition
from drivers.mavlink.setpoint import Rested
from drivers.mavlink.vehicle import Stack
from estimator.contracts.commands import Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.support.waiting import until

HOST = "127.0.0.1"
YAW = math.radians(130.0)


@dataclass
class Scene:
    """A body with its nose to the south-east over a pad that is believed in with some noise."""

    v_pad_ned: F64
    v_body_ned: F64 = field(default_factory=lambda: np.array([0.4, -0.3, 0.2]))
    t_s: float = 1.0
    sighted_s: float | None = None
    """Time when the pad was last seen; None for just now."""
    rested: Rested | None = None
    steered: bool = False
    sigma_m_s: float = 0.1
    p_body_ned: F64 = field(default_factory=lambda: np.zeros(3))
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(4))

    @property
    def now(self) -> MonoNs:
        return MonoNs(round(self.t_s * NS_PER_S))

    @property
    def attitude(self) -> Attitude | None:
        return Attitude(Stamp(self.now, self.now, 0.0, "synced"), Rotation.from_rpy(0.05, -0.1, YAW), np.eye(3) * 1e-4)

    @property
    def positions(self) -> tuple[LocalPosition, ...]:
        return (LocalPosition(Stamp(self.now, self.now, 0.0, "synced"), self.p_body_ned, self.v_body_ned),)

    def believe(self, now: MonoNs) -> RelativeState | None:
        v = Rotation.from_rpy(0.0, 0.0, YAW).inv @ (self.v_pad_ned - self.v_body_ned + self.rng.normal(0.0, 0.1, 3))
        sighted = now if self.sighted_s is None else MonoNs(round(self.sighted_s * NS_PER_S))
        return RelativeState(now, "ekf", np.array([0.1, 0.2, 3.0]), v, 0.3, np.eye(7) * self.sigma_m_s**2, sighted, True)


def run_for(way: DeckVelocity, scene: Scene, seconds: float) -> F64:
    found = np.zeros(3)
    for _ in range(round(50 * seconds)):
        scene.t_s += 0.02
        found = way(scene.now)
    return found


def test_a_ship_under_way_is_found_whatever_the_body_does_and_her_heave_is_followed_in_sight() -> None:
    scene = Scene(np.array([1.2, -0.9, 0.0]))
    way = DeckVelocity(scene.believe, scene)
    assert run_for(way, scene, 3.0)[:2] == pytest.approx([1.2, -0.9], abs=0.06)
    scene.v_body_ned = np.array([-2.0, 1.0, 0.5])
    assert run_for(way, scene, 0.1)[:2] == pytest.approx([1.2, -0.9], abs=0.06)
    scene.v_pad_ned = np.array([1.2, -0.9, -0.8])
    assert run_for(way, scene, 0.6)[2] == pytest.approx(-0.8, abs=0.12)
    scene.sighted_s = scene.t_s
    assert run_for(way, scene, 1.0) == pytest.approx([1.2, -0.9, 0.0], abs=0.06)


def test_a_velocity_that_is_hardly_known_is_nobodys_way() -> None:
    """WHY: a hold that goes with a velocity known to 1 m/s leaves the deck."""
    scene = Scene(np.array([1.2, -0.9, 0.0]), sigma_m_s=1.0)
    way = DeckVelocity(scene.believe, scene)
    assert run_for(way, scene, 3.0).tolist() == [0.0, 0.0, 0.0]


def test_it_is_held_without_sight_then_kept_as_the_ship_s_way_and_forgotten_in_the_end() -> None:
    """A vehicle that gave up must not stay over the ground while the ship sails away from under it."""
    scene = Scene(np.array([1.5, 0.0, 0.0]))
    way = DeckVelocity(scene.believe, scene)
    run_for(way, scene, 3.0)
    scene.sighted_s = scene.t_s
    held = run_for(way, scene, 5.0)
    assert held == pytest.approx([1.5, 0.0, 0.0], abs=0.06)
    assert run_for(way, scene, FORGET_S) == pytest.approx([1.5, 0.0, 0.0], abs=0.06)
    scene.t_s += KEEP_S - FORGET_S - 6.0
    assert run_for(way, scene, 0.1)[0] == pytest.approx(1.5, abs=0.06)
    assert np.all(run_for(way, scene, 2.0) == 0.0)


def test_waves_are_averaged() -> None:
    scene = Scene(np.zeros(3))
    way = DeckVelocity(scene.believe, scene)
    found = []
    for n in range(1000):
        scene.v_pad_ned = np.array([1.5 + 0.6 * math.sin(math.tau * n / 400), 0.0, 0.0])
        scene.t_s += 0.02
        found.append(way(scene.now)[0])
    assert np.mean(found[400:]) == pytest.approx(1.5, abs=0.05)
    assert np.ptp(found[400:]) < 0.75, "of 1.2 m/s"


async def test_velocities_go_to_the_autopilot_with_the_decks_way_on_top() -> None:
    clock = SystemClock()
    fake = MiniatureAutopilot(Stack.ARDUPILOT, mode="guided")
    fake.armed, fake.landed_state = True, 2
    fake.rpy = lambda t: (0.0, 0.0, YAW)
    options = AutopilotOptions(f"udpin://{HOST}:0", command_period_s=0.02)

    def told() -> list[Message]:
        return fake.of("SET_POSITION_TARGET_LOCAL_NED")

    async with open_autopilot(options, clock) as autopilot:
        await until(lambda: autopilot.links.all[0].local is not None)
        host, port = autopilot.links.all[0].local or ("", 0)
        async with fake.talking_to(f"udpout://{host}:{port}"):
            await until(lambda: autopilot.attitude is not None)
            autopilot.deck_velocity = lambda now: np.array([1.5, -0.5, 0.0])
            forward = Rotation.from_rpy(0.0, 0.0, YAW) @ np.array([0.3, 0.0, 0.0])

            def arrived() -> bool:
                autopilot.command(Velocity(np.array([0.3, 0.0, 0.2]), 0.0))
                return bool(told()) and told()[-1].vz > 0.1

            await until(arrived)
    last = next(m for m in reversed(told()) if m.vz > 0.1)
    assert (last.vx, last.vy, last.vz) == pytest.approx((forward[0] + 1.5, forward[1] - 0.5, 0.2), abs=1e-3)


def test_the_ship_s_report_stands_for_it_where_the_pad_was_never_seen_and_gives_way_to_sight() -> None:
    scene = Scene(np.array([1.2, -0.9, 0.0]))
    seen = False
    way = DeckVelocity(lambda now: scene.believe(now) if seen else None, scene, lambda now: np.array([3.0, 1.0]))
    assert run_for(way, scene, 1.0) == pytest.approx([3.0, 1.0, 0.0])
    seen = True
    assert run_for(way, scene, 3.0)[:2] == pytest.approx([1.2, -0.9], abs=0.06)
    seen = False
    assert run_for(way, scene, 5.0)[:2] == pytest.approx([1.2, -0.9], abs=0.06)
    assert run_for(way, scene, FORGET_S) == pytest.approx([3.0, 1.0, 0.0])


def test_the_way_of_the_deck_from_which_it_took_off_is_kept_until_the_pad_is_seen() -> None:
    scene, seen = Scene(np.array([1.2, -0.9, 0.0])), False
    scene.rested = Rested(scene.now, np.array([1.1, -0.8, 0.0]), np.zeros(3))
    way = DeckVelocity(lambda now: scene.believe(now) if seen else None, scene)
    assert run_for(way, scene, 0.9 * KEEP_S) == pytest.approx([1.1, -0.8, 0.0])
    seen = True
    assert run_for(way, scene, 3.0)[:2] == pytest.approx([1.2, -0.9], abs=0.06)


@pytest.mark.parametrize(("beside_m", "found"), [(2.0, [1.25, -0.9, 0.0]), (40.0, [1.5, -0.6, 0.0])])
def test_the_way_since_the_take_off_is_the_ship_s_for_a_vehicle_back_over_her(beside_m: float, found: list[float]) -> None:
    """WHY: the deck's velocity over 3 s before it took off was that of a wave as well, and a search left the pad by 0.25 m/s."""
    scene = Scene(np.zeros(3))
    scene.rested = Rested(scene.now, np.array([1.5, -0.6, 0.0]), np.array([5.0, 6.0, 0.0]))
    way = DeckVelocity(lambda now: None, scene)
    for n in range(800):
        scene.t_s += 0.05
        scene.p_body_ned = np.array([5.0 + beside_m, 6.0, -7.0]) + 0.05 * (n + 1) * np.array([1.2, -0.9, 0.0])
        known = way(scene.now)
    assert known == pytest.approx(found, abs=0.01)
    scene.steered = True
    scene.p_body_ned = scene.p_body_ned + 10.0
    assert run_for(way, scene, 5.0) == pytest.approx(found, abs=0.01), "its own search says nothing of the ship"
