"""The facts that are reported of a flight, one type each. A recording of them can be plotted, and replayed bit for bit.

Vectors and matrices (row by row) are lists of numbers in SI units and radians, named as in `estimator.contracts`; instants are
whole nanoseconds of the recording host's monotonic clock. Unknown values are left out.
"""

from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

from msgspec import NODEFAULT, Meta, Struct, defstruct, structs

from companion.base.health import FARTHEST_NS, Count, FlowRecord, PartRecord
from companion.base.observer import ResponseState
from companion.base.orders import OperatorOrder, OrderSource
from estimator.contracts.estimates import SOURCES, Method, PathName, Source, Verdict
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, GeoFix, Sample, VehicleStatus
from estimator.contracts.time import Stamp, StampSource

Instant = Annotated[int, Meta(ge=-FARTHEST_NS, le=FARTHEST_NS)]
"""An instant, ns."""
Vector2 = Annotated[list[float], Meta(min_length=2, max_length=2)]
Vector3 = Annotated[list[float], Meta(min_length=3, max_length=3)]
Pixels = Annotated[int, Meta(ge=1, le=65_535)]


class StampRecord(Struct, frozen=True):
    """Time of measurement, time of reception, and the uncertainty of the former."""

    measured_at_ns: Instant
    received_at_ns: Instant
    sigma_s: float
    source: StampSource


class AttitudeRecord(Struct, frozen=True):
    """An attitude as a matrix (9,), its covariance (9,), and the same angles in degrees for the viewer."""

    stamp: StampRecord
    R_ned_body: list[float]
    cov_body: list[float]
    roll_deg: float
    pitch_deg: float
    yaw_deg: float


class FixRecord(Struct, frozen=True, omit_defaults=True):
    """The place of the vehicle or of the vessel in WGS-84, and its velocity (3,) in `ned`, m/s; what is unknown is left out."""

    stamp: StampRecord
    whose: Literal["vehicle", "vessel"]
    latitude_deg: float
    longitude_deg: float
    sigma_m: float
    height_m: float | None = None
    v_ned: Vector3 | None = None


class StatusRecord(Struct, frozen=True, omit_defaults=True):
    """The vehicle's status: mode, emergency, link, whether it flies, and the battery's charge, 0 to 1."""

    stamp: StampRecord
    mode: str
    emergency: bool
    link_ok: bool
    flying: bool | None = None
    battery_fraction: float | None = None
    taken: str | None = None
    """Holder of the vehicle, if it was taken from the service."""
    jerk_max_m_s3: float | None = None
    """The vehicle's own limit of the jerk along the ground."""
    tilt_max_deg: float | None = None
    """The vehicle's own limit of its tilt."""
    others_at: int | None = None
    """Newest time at which somebody else chose for the vehicle, as in `stamp`, ns; orders from before it are not followed."""


class Pose6Record(Struct, frozen=True):
    """A pose in six degrees of freedom: vector (3,), rotation (9,) and covariance (36,)."""

    d_body_pad_level: Vector3
    R_level_pad: list[float]
    cov: list[float]


class SightingRecord(Struct, frozen=True, omit_defaults=True):
    """The sighting of one method; its stamp and number are those of the detection that contains it."""

    method: Method
    d_body_pad_level: Vector3
    cov: list[float]
    confidence: float
    yaw_ambiguous: bool
    yaw_rad: float | None = None
    pose6: Pose6Record | None = None


class FrameTimesRecord(Struct, frozen=True):
    """Duration of each stage of one frame, s."""

    decode_s: float
    wait_s: float
    look_s: float
    filter_s: float


class PadCheckRecord(Struct, frozen=True, omit_defaults=True):
    """State of the pad's surface."""

    at_ns: Instant
    """Exposure of the newest frame that was read."""
    seen: float
    """Share of the pad's known surface that was read lately, 0..1."""
    thing: Vector3 | None = None
    """Width of the largest thing on the pad, m, and its place along the arrow and to starboard of it; left out without one."""
    near: Vector3 | None = None
    """Place of the nearest thing about the pad along the arrow and to starboard of it, m, and its height over the deck, 0 for
    what moves; left out without one."""
    glare: float = 0.0
    """Share of the pad in glare where it may hide something, 0..1."""


class DetectionRecord(Struct, frozen=True, omit_defaults=True):
    """One frame: its stamp, the sighting of every method, and the verdict."""

    stamp: StampRecord
    seq: Count
    exposure_s: float
    width: Pixels
    height: Pixels
    verdict: Verdict
    began_ns: Instant
    done_ns: Instant
    attitude: AttitudeRecord | None = None
    """The vehicle's attitude at the exposure."""
    tried: list[Method] | None = None
    """Methods that were tried; left out if vision did not run."""
    chosen: Method | None = None
    selected: SightingRecord | None = None
    ellipse: SightingRecord | None = None
    arrow: SightingRecord | None = None
    corners: SightingRecord | None = None
    registration: SightingRecord | None = None
    lamps: SightingRecord | None = None
    fused: SightingRecord | None = None
    elsewhere: SightingRecord | None = None
    """Detection that is surer than the selected one, at a place that the estimate excluded; left out if there is none."""
    times: FrameTimesRecord | None = None
    """Left out if vision did not search the frame, and in virtual time."""
    R_body_cam: list[float] | None = None
    """The rotation (9,) of a camera on the body as its gimbal held it; left out for one that is fixed, or if it is not known."""
    gain: float = 0.0
    """Amplification of a camera whose exposure is driven; left out if unknown."""
    coded: bool = False
    """True if a codec predicted the frame from others before it came; left out if none did."""
    on_pad: PadCheckRecord | None = None
    """Known things on the pad; left out before its surface was read."""
    unfinished: bool = False
    """True if the frame's budget of work ended its search, which goes on with the next frame; left out if not."""


class NamedNumber(Struct, frozen=True):
    """A detail of an estimate."""

    name: str
    value: float


class BeliefRecord(Struct, frozen=True, omit_defaults=True):
    """An estimate of one path."""

    at_ns: Instant
    path: PathName
    d_body_pad_level: Vector3
    v_pad_level: Vector3
    cov: Annotated[list[float], Meta(min_length=49, max_length=49)]
    """Covariance (7, 7) row by row, of the two vectors and the yaw."""
    sighted_ns: Instant
    consistent: bool
    height_m: float
    lateral_m: float
    details: list[NamedNumber]
    yaw_rad: float | None = None
    track: int = 0
    """Number of the tracked pad; it increases at each jump of the position that motion does not explain."""
    alerts: list[str] = []
    """Names of the checks that doubted the estimate."""
    lost: list[str] = []
    """Sensors that the estimate does without, and what each does, in words."""


class FusionRecord(Struct, frozen=True, omit_defaults=True):
    """The result of one measurement on one path of the estimator; figures are left out if nothing was compared."""

    at_ns: Instant
    """Instant at which the service processed the measurement."""
    path: PathName
    source: Source
    verdict: Verdict
    measured_at_ns: Instant
    received_at_ns: Instant
    components: list[str] = []
    """Names of the innovation's components, each with its unit."""
    innovation: list[float] | None = None
    innovation_cov: list[float] | None = None
    nis: float | None = None
    test_ratio: float | None = None
    """NIS divided by the gate's limit; the gate refuses a value above 1."""


class TransitionRecord(Struct, frozen=True, omit_defaults=True):
    """One change of the mission's state, with its reason."""

    at_ns: Instant
    source: str
    event: str
    target: str
    cause: str
    """Name of the cause; `text` says it with its numbers."""
    measured: float | None = None
    limit: float | None = None
    detail: str | None = None
    """Name of the alert or verdict that the cause is about."""
    text: str = ""


class ResponseRecord(Struct, frozen=True, omit_defaults=True):
    """The vehicle's response as a flight has come to know it."""

    state: ResponseState
    """assumed, known, or identified where the flight contradicts the response file."""
    delay_s: float
    sigma_s: float | None = None
    longer_s: float = 0.0
    """Excess of the delay over the response file, s."""
    frequency: float = 1.0
    damping: float = 1.0
    """Factors on frequency and damping of the response file."""
    softer: float = 1.0
    """Factor by which the place weighs less for it."""
    sigma: float = 0.0
    """Standard deviation of the frequency's logarithm."""


class DeckRecord(Struct, frozen=True):
    """The deck's height and tilt some seconds ahead, each with its standard deviation; one number for each horizon."""

    horizons_s: list[float]
    height_m: list[float]
    sigma_height_m: list[float]
    roll_rad: list[float]
    sigma_roll_rad: list[float]
    pitch_rad: list[float]
    sigma_pitch_rad: list[float]


class DecisionRecord(Struct, frozen=True, omit_defaults=True):
    """One guidance cycle; the estimates that it used are the messages of the same instant that precede it."""

    at_ns: Instant
    phase: str
    steering: str | None = None
    """Path of the estimate that steered; left out if there was none."""
    command: str | None = None
    """velocity, tilt, hover, take_off, land, cut_motors or leave_emergency; left out if no command was sent."""
    v_level: Vector3 | None = None
    yaw_rate_rad_s: float | None = None
    reason: str = ""
    """Reason for anything other than a plain descent."""
    a_level: Vector2 | None = None
    """Acceleration of a tilt, m/s^2 forward and right."""
    trim_level: Vector2 | None = None
    """Acceleration that a tilt adds against wind and drag, m/s^2 forward and right."""
    transitions: list[TransitionRecord] = []
    """State changes since the previous decision, in order."""
    response: ResponseRecord | None = None
    """The vehicle's response, where this cycle has come to know it otherwise than before."""
    deck: DeckRecord | None = None
    """The deck's forecast, where this cycle made one."""


class OrderRecord(Struct, frozen=True, omit_defaults=True):
    """An order of a person and its answer."""

    at_ns: Instant
    source: OrderSource
    """Way on which it arrived: gamepad, terminal, mavlink, mqtt, signal; or limits."""
    sender: str
    order: OperatorOrder
    accepted: bool
    refusal: str | None = None
    detail: str = ""


class ContactRecord(Struct, frozen=True, omit_defaults=True):
    """The first contact with a surface after flight."""

    at_ns: Instant
    surface: str
    on_pad: bool
    lateral_m: float | None = None
    yaw_rad: float | None = None
    vertical_speed_m_s: float | None = None
    lateral_speed_m_s: float | None = None


class TruthRecord(Struct, frozen=True, omit_defaults=True):
    """The true pose of the pad, known only to a simulator or motion capture."""

    at_ns: Instant
    d_body_pad_level: Vector3
    v_pad_level: Vector3
    yaw_rad: float
    phase: str | None = None
    """Phase of the flight as the simulated vehicle knows it."""
    touchdown: ContactRecord | None = None
    R_ned_body: list[float] | None = None
    """True attitude of the vehicle, (3, 3) row by row."""
    R_ned_pad: list[float] | None = None
    """True attitude of the pad, (3, 3) row by row."""
    p_pad_ned: Vector3 | None = None
    """True place of the pad's centre, (3,) m from the simulator's origin."""


class LinkRecord(Struct, frozen=True, omit_defaults=True):
    """One message of a link, with the bytes as they were on the wire."""

    at_ns: Instant
    link: str
    direction: str
    """Direction of the message: `in` or `out`."""
    data: bytes
    name: str | None = None


class TallyRecord(Struct, frozen=True):
    """The number of inputs of one kind that ended in one verdict."""

    kind: str
    verdict: str
    count: Count


class StageRecord(Struct, frozen=True, omit_defaults=True):
    """Median and 99th percentile of the time of one stage, seconds."""

    name: str
    count: Count
    p50_s: float | None = None
    p99_s: float | None = None


class CounterRecord(Struct, frozen=True):
    """One counter of one part."""

    part: str
    name: str
    value: float


class HealthRecord(Struct, frozen=True):
    """Health of the service (`companion.base.health.HealthSnapshot`), recorded once a second."""

    at_ns: Instant
    parts: list[PartRecord]
    flows: list[FlowRecord]
    tallies: list[TallyRecord]
    stages: list[StageRecord]
    counters: list[CounterRecord]
    all_up: bool = True
    """True if every part of the service is up."""
    flight_up: bool = True
    """True if the parts that the flight needs are up."""
    too_slow: str = ""
    """Sign that this computer does not keep up, with the cure; empty while it does."""


_LISTS = {Stamp: StampRecord, Rotation: list[float], F64: list[float]}
"""The types of fields of samples that are lists in a record."""
_FOUND_LATER = "gyro_lost_s", "accel_lost_s"
"""Fields that the estimator fills, and no driver."""


def _record_of(sample: type[Sample], name: str) -> type[Struct]:
    """Return the record of a kind of sample, with the sample's own fields; one that may be None is left out then."""
    members: list[tuple[str, Any] | tuple[str, Any, Any]] = []
    for one in structs.fields(sample):
        optional = None in get_args(one.type) or NoneType in get_args(one.type)
        given = next((kind for kind in get_args(one.type) if kind is not NoneType), one.type) if optional else one.type
        kind = _LISTS.get(given, str if get_origin(given) is Literal else given)
        if optional:
            members.append((one.name, kind | None, None))
        elif one.default is NODEFAULT or kind is not given:
            members.append((one.name, kind))
        elif one.name not in _FOUND_LATER:
            members.append((one.name, kind, one.default))
    return defstruct(f"{name.capitalize()}Record", members, frozen=True, omit_defaults=True, module=__name__)


_OTHERWISE: dict[type[Sample], type[Struct]] = {Attitude: AttitudeRecord, GeoFix: FixRecord, VehicleStatus: StatusRecord}
"""Kinds of samples that viewers read in other units or another order."""
SAMPLES: dict[type[Sample], type[Struct]] = {
    kind: _OTHERWISE.get(kind) or _record_of(kind, SOURCES[kind]) for kind in get_args(Sample)
}
"""The record of each kind of sample."""
