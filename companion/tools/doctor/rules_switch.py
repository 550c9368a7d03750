"""Rules for the switch on the transmitter: its channel arrives, has a pulse, moves, and is used by nothing of the autopilot."""

from companion.tools.doctor.finding import Row, Rule, Severity
from companion.tools.doctor.snapshot import Snapshot
from drivers.mavlink.rc_channels import POSITIONS

_STICKS = ("RCMAP_ROLL", "RCMAP_PITCH", "RCMAP_THROTTLE", "RCMAP_YAW")
_PX4_NAMES = (
    "ROLL", "PITCH", "THROTTLE", "YAW", "FLTMODE", "RETURN_SW", "LOITER_SW", "OFFB_SW", "KILL_SW", "ARM_SW", "GEAR_SW",
    "TRANS_SW", "PAY_SW", "ENG_MOT", "FLAPS", "FAILSAFE", *(f"AUX{n}" for n in range(1, 7)), *(f"PARAM{n}" for n in range(1, 4)),
)  # fmt: skip
_PX4_BUTTONS = "RC_MAP_FLTM_BTN"
_TUNED = 6
"""The channel by which ArduCopter tunes what TUNE names."""


def parameters(stack: str, channel: int) -> tuple[str, ...]:
    """Return the parameters by which an autopilot uses a channel of the transmitter for itself."""
    if stack == "PX4":
        return (*(f"RC_MAP_{name}" for name in _PX4_NAMES), _PX4_BUTTONS)
    if stack != "ArduPilot":
        return ()
    return (f"RC{channel}_OPTION", "FLTMODE_CH", *_STICKS, *(("TUNE",) if channel == _TUNED else ()))


def _stood(p: Snapshot) -> dict[str, int] | None:
    """Return the positions in which the switch stood; None without a switch, or where no rates were measured."""
    a = p.autopilot
    return a.channels.get(p.service.switch_channel, {}) if p.service.switch_channel and a is not None and a.rates_hz else None


def _arrives(p: Snapshot) -> bool:
    return p.autopilot is not None and "RC_CHANNELS" in p.autopilot.rates_hz


def _unmoved(p: Snapshot) -> tuple[int, str] | None:
    stood = _stood(p) or {}
    return (p.service.switch_channel, next(iter(stood))) if len(stood) == 1 else None


def _used(p: Snapshot) -> tuple[int, str] | None:
    """Return the channel and the parameters by which the autopilot uses it too."""
    a, channel = p.autopilot, p.service.switch_channel
    if a is None or _stood(p) is None:
        return None
    used = []
    for name in parameters(a.stack, channel):
        value = int(a.parameters.get(name, 0.0))
        by_bit = name == _PX4_BUTTONS and value >> (channel - 1) & 1
        if by_bit or (value if name.endswith("_OPTION") or name == "TUNE" else name != _PX4_BUTTONS and value == channel):
            used.append(f"{name} {value}")
    return (channel, ", ".join(used)) if used else None


def line(p: Snapshot) -> list[str]:
    """Return the switch's channel, its present position and what each position that it stood in orders."""
    stood = _stood(p)
    if not stood:
        return []
    orders = dict(zip(POSITIONS, p.service.switch, strict=True))
    *_, now = stood
    seen = ", ".join(f"{name} {stood[name]} us ({orders[name]})" for name in orders if name in stood)
    return [f"switch: channel {p.service.switch_channel} is {now}; seen: {seen}"]


RULES: tuple[Rule, ...] = (
    Row("switch-silent", Severity.ERROR, lambda p: _stood(p) is not None and not _arrives(p),
        "no RC_CHANNELS arrives: the switch on the transmitter orders nothing",
        "bind the receiver and let the autopilot see it (RC calibration of the ground station shows its channels)"),
    Row("switch-no-pulse", Severity.ERROR, lambda p: _stood(p) == {} and _arrives(p) and p.service.switch_channel,
        "channel {0} has no pulse, or the transmitter is lost",
        "switch the transmitter on, and give the switch this channel on it; decklander start shows which channel moves"),
    Row("switch-used", Severity.ERROR, _used,
        "channel {0[0]} is the autopilot's own too: {0[1]}",
        "take a free channel for operator.switch.channel, or set that parameter 0: one move would do two things"),
    Row("switch-unmoved", Severity.ADVICE, _unmoved,
        "channel {0[0]} stood still ({0[1]}) while it was examined",
        "examine again and flip the switch meanwhile: what is seen of it is listed"),
)  # fmt: skip
