"""History of an autopilot's flight log beside its samples: parameters, texts, and events that can spoil a landing."""

from msgspec import Struct, field

VIBRATION_LIMIT_M_S2 = {"ArduPilot": 30.0, "PX4": 9.81}
"""The vibration that each stack's documentation calls too much. Sources: ArduPilot, "Measuring vibration" (VIBE); PX4, "Log
analysis using Flight Review" (accel_vibration_metric)."""


class LoggedMoment(Struct, frozen=True):
    """Something that happened once."""

    at_s: float
    """Time since the log began, seconds."""
    what: str


class Excess(Struct, frozen=True):
    """Excess of a value over its limit while the vehicle was armed, and its duration."""

    worst: float
    at_s: float
    """Time of the worst, since the log began, seconds."""
    over_s: float
    """Time above the limit, in all, seconds."""


class LoggedLanding(Struct, frozen=True):
    """One landing as the autopilot's own detector saw it."""

    at_s: float
    lost: int
    """Number of times that the detector took it back."""
    armed_s: float
    """Time from the last detection until the motors were off, or the log ended, seconds."""


class LogHistory(Struct, frozen=True):
    """Events of one log."""

    lasted_s: float
    failsafes: tuple[LoggedMoment, ...] = ()
    ratios: dict[str, Excess] = field(default_factory=dict)
    """Test ratios of the estimator's innovations, by what was measured: velocity, position, height, compass."""
    vibration_m_s2: Excess | None = None
    clipped: int = 0
    """Number of accelerometer readings at the end of the range, while armed."""
    landings: tuple[LoggedLanding, ...] = ()
    targets_lost: int = 0
    """Number of times that the autopilot's precision landing lost its target while armed."""
    dropouts_s: float = 0.0
    """Time that the log lost, seconds."""
    notes: tuple[str, ...] = ()
    """Notes on data that the reader left out, and on steps of the clock."""


class AutopilotLog(Struct, frozen=True):
    """A log's content apart from its samples."""

    stack: str
    vehicle: str | None
    """Name of the firmware, such as "ArduCopter", if the log has it."""
    firmware: tuple[int, int, int] | None
    parameters: dict[str, float]
    """The last value of each."""
    texts: tuple[str, ...]
    events: tuple[int, ...]
    """Numbers of PX4's EVENTs."""
    history: LogHistory
    text_times_s: tuple[float, ...] = ()
    """Times of the texts since the log began, s."""
    defaults: dict[str, float] = field(default_factory=dict)
    """The firmware's own default of each parameter that has one in the log."""
    precision_landing: bool = False
    """True if PX4 flew AUTO.PRECLAND."""
