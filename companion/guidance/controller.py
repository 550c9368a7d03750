"""The port between the mission and the control law: knowledge, target, and the command that gets there.

The mission decides on the target. A controller decides on the command, and nothing else: it never ends a descent, never decides
whether the pad may be landed on, and holds what it is given. Controllers are pure: a step takes a frozen memory and returns the
next one.
"""

import math
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from msgspec import Struct, field
from msgspec.structs import force_setattr

from companion.base.observer import ResponseInUse
from companion.settings.guidance import ClimbResponse
from estimator.contracts.commands import Command
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import checked_vector
from estimator.contracts.time import MonoNs
from estimator.ekf import Forecast

SWELL_RAD_S = math.tau / 12.0
"""Circular frequency of a swell that is not known yet: a long one asks for the most height."""


class FieldOfView(NamedTuple):
    """The camera's field, in the body's axes."""

    forward_m: float
    """The camera ahead of the body's origin."""
    right_m: float
    half_forward_rad: float
    """Half the field ahead and astern."""
    half_right_rad: float


HORIZONS_S = (0.0, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
"""Horizons of the forecast that guidance requests, s."""


class Impact(Struct, frozen=True):
    """A contact with the deck, as an event; no height ever makes one."""

    at: MonoNs
    by: str
    """Source of the contact.

    It is `accelerometer` (a step that no flight makes), `velocity` (held up against all commands) or `gyro` (a foot is held).
    """
    size_m_s2: float = math.nan
    """The step of the acceleration; nan if the contact came from another source."""
    held_m_s: float = math.nan
    """Excess of the upward speed over the command; nan if the contact came from another source."""
    turned_rad_s: float = math.nan
    """The step of the turn rate; nan if the contact came from another source."""
    doubtful: bool = False
    """True if it may be a spike of the sensor: harder than any landing, or one of several in a row."""


class AtContact(Struct, frozen=True):
    """Predicted place of the vehicle when its feet meet the deck, without new disturbances."""

    error_m: float
    """Distance of the pad's centre from where it is wanted."""
    speed_m_s: float
    """Speed along the deck."""
    sigma_m: float
    """Standard deviation of the place, one axis: what the filter does not know, and the gusts until then."""
    gust_m_s: float = 0.0
    """Difference of the air's present speed from its mean."""
    gust_most_m_s: float = math.inf
    """The largest such difference that the gusts before explain."""


class Knowledge(Struct, frozen=True):
    """Inputs of guidance in one cycle. `level` is the body's own at `at` throughout."""

    at: MonoNs
    relative: RelativeState | None
    """Relative state of the pad; None while no pad is tracked.

    It continues without sight: check its age, `consistent` and `cov`.
    """
    body: BodyMotion | None = None
    """None from an estimator path that does not estimate it."""
    deck: DeckMotion | None = None
    """None from an estimator path that does not estimate it."""
    forecast: Forecast | None = None
    """The deck at `HORIZONS_S` after `forecast.at`, which may be some cycles before `at`."""
    impact: Impact | None = None
    """The newest contact since take-off; None while there was none."""
    response: ResponseInUse | None = None
    """The vehicle's response as this flight knows it; None if it is not identified: the response file holds."""
    climb_max_m_s: float | None = None
    """The fastest climb that the controller requests; None if it does not say."""
    climb: ClimbResponse | None = None
    """Response of the vehicle's climb, by its file; None where it has none."""
    jerk_max_m_s3: float | None = None
    """The vehicle's own limit of the jerk; None leaves it at its response file's."""
    tilt_max_deg: float | None = None
    """The largest tilt to ask for, by the vehicle's own limit; None leaves it at its response file's."""
    trusts_velocity: bool = True
    """False while the integrity guard refuses the measured velocity: no loop is closed on it."""
    unfelt: bool = False
    """True if the body's acceleration comes from its tilt, as its accelerometer is lost: it says nothing of the air's push."""
    swell_rad_s: float = SWELL_RAD_S
    """Circular frequency of the deck's heave."""
    swell_watched_s: float = 0.0
    """Time for which the deck's heave has been watched."""
    outrun_m: float = 0.0
    """Height by which such a swell, at twice its standard deviation, rises above a drone that climbs as fast as it can."""
    aim_level: tuple[float, float] = (0.0, 0.0)
    """Wanted place of the pad's centre at the contact, forward and right, m: a tilted vehicle comes to stand to lee of it."""
    rim_m: float = math.inf
    """Distance from the wanted place up to which the vehicle has all feet on the pad; the gate's own limit on a smaller pad."""
    confirmed: bool = False
    """True while a motion sensor of the ship and the camera agree on the deck."""
    at_contact: AtContact | None = None
    """None from a controller that does not look ahead, and far from the deck."""


class Target(Struct, frozen=True, eq=False):
    """Target of the vehicle relative to the deck."""

    d_body_pad_level: F64
    """Wanted vector from the body to the pad, (3,) m: (0, 0, 2) is two metres above its centre."""
    descent_rate_m_s: float | None = None
    """The wanted rate against the deck, down positive. With a rate the wanted height is not looked at: 0.4 goes down to the deck
    and presses on there, -0.5 climbs. None flies to the wanted height and holds it."""
    v_body_level: F64 = field(default_factory=lambda: np.zeros(3))
    """Velocity of the target itself against the pad, (3,) m/s: for one that is moved along a way."""
    vertical_rate_max_m_s: float = 1.0
    """Largest rate against the deck with which a wanted height is flown to."""
    speed_max_m_s: float = 1.5
    """Largest horizontal speed against the deck with which a wanted place is flown to."""
    yaw_rad: float | None = None
    """The wanted heading against the pad's arrow, rad; None keeps the heading."""
    lean_max_rad: float | None = None
    """Largest tilt that may be requested; None leaves it at the controller's own limit."""

    def __post_init__(self) -> None:
        force_setattr(self, "d_body_pad_level", checked_vector("Target.d_body_pad_level", self.d_body_pad_level))
        force_setattr(self, "v_body_level", checked_vector("Target.v_body_level", self.v_body_level))
        numbers = (self.descent_rate_m_s, self.vertical_rate_max_m_s, self.speed_max_m_s, self.yaw_rad, self.lean_max_rad)
        if not all(x is None or math.isfinite(x) for x in numbers):
            raise ValueError(f"a target needs finite numbers, got {numbers}")


Memory = TypeVar("Memory")


class Controller(Protocol[Memory]):
    """A control law.

    `step` runs in every guidance cycle. With a target it returns the command that goes there; a target needs
    `knowledge.relative`, and it is the mission's to say for how long an estimate without sight will do. Without a target
    somebody else commands (hover, the vehicle's own landing, a person's hand): the law then only keeps what it has learned of
    wind and trim up to date, so that it takes over without a bump, and returns `Hover`. A memory outlives a change of the options
    in flight: it goes on to a controller of the same class.
    """

    @property
    def name(self) -> str:
        """The name by which settings choose it."""
        ...

    @property
    def climb_max_m_s(self) -> float | None:
        """The fastest climb that it requests, m/s; None where somebody else limits it.

        Where the deck is about to rise faster, the mission keeps the drone higher.
        """
        ...

    def start(self) -> Memory: ...

    def ahead(self, memory: Memory, knowledge: Knowledge, seconds: float) -> tuple[float, float] | None:
        """Return the distance from `knowledge.aim_level`, m, and the speed along the deck, m/s, after so many seconds.

        None from a controller that does not know.
        """
        ...

    def step(self, memory: Memory, now: MonoNs, knowledge: Knowledge, target: Target | None) -> tuple[Memory, Command]: ...
