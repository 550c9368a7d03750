"""The settings of people's commands: who may give them, how fast manual flight is, and the limits of every command."""

from typing import Annotated, Literal

from estimator.contracts.keys import CheckedOptions, choice, number, text, tuning


class ManualOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Manual flight: the velocities that full sticks command."""

    speed_max_m_s: Annotated[float, tuning("horizontal velocity at full stick", "m/s", 0.05, 10.0)] = 1.0
    climb_max_m_s: Annotated[float, tuning("climb and descent rate at full stick", "m/s", 0.05, 3.0)] = 0.5
    turn_max_deg_s: Annotated[float, tuning("turn rate at full stick", "deg/s", 5.0, 200.0)] = 45.0
    silence_s: Annotated[
        float, number("silence of the sender that has the hand after which the vehicle holds", "s", 0.1, 0.5)
    ] = 0.5


SwitchOrder = Literal["none", "begin", "stay", "hold", "abort"]


class SwitchOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """A switch of two or three positions on the transmitter, read from the autopilot's RC_CHANNELS.

    Raises:
        ValueError: a channel of the sticks.
    """

    channel: Annotated[int, number("its channel, 5 to 18; 0 for no switch", "1", 0, 18, public=True)] = 0
    low: Annotated[SwitchOrder, choice("order when it is moved to its low position, 800 to 1300 us")] = "hold"
    middle: Annotated[SwitchOrder, choice("the same of the middle position, 1400 to 1600 us, if it has one")] = "stay"
    high: Annotated[SwitchOrder, choice("the same of the high position, 1700 to 2200 us")] = "begin"

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0 < self.channel < 5:
            raise ValueError(f"channel must be 5 to 18, or 0 for no switch, got {self.channel}: 1 to 4 are the sticks")


class HandoverOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """A landing that is begun by the autopilot's own flight, once the pad is in sight below (docs/operator.md)."""

    after: Annotated[
        Literal["nothing", "mission", "return", "mission or return"],
        choice("flight of the autopilot's own after which the landing begins by itself", public=True),
    ] = "nothing"
    failsafe: Annotated[bool, choice("whether that is so of a return, or a mission's end, with a failsafe in force too")] = False

    @property
    def mission(self) -> bool:
        """True if a landing begins at a mission's end."""
        return self.after in ("mission", "mission or return")

    @property
    def returns(self) -> bool:
        """True if a landing begins from a return over the pad."""
        return self.after in ("return", "mission or return")


class OperatorOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The commands of people on this computer: the terminal (`decklander fly`).

    Raises:
        ValueError: the socket is neither a word nor an absolute path.
    """

    socket: Annotated[
        str,
        text(
            'path of the local socket of `decklander fly`; "auto" for one in the service\'s runtime folder, named after the '
            'vehicle; "off" for none',
            200,
            public=True,
        ),
    ] = "auto"
    manual: ManualOptions = ManualOptions()
    switch: SwitchOptions = SwitchOptions()
    handover: HandoverOptions = HandoverOptions()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.socket not in ("auto", "off") and not self.socket.startswith("/"):
            raise ValueError(f'socket must be "auto", "off" or an absolute path, got {self.socket!r}')


class LimitOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Limits of every command to the vehicle, of guidance and of manual flight. None of them ever makes the vehicle descend.

    Raises:
        ValueError: a number outside its range, or a polygon that cannot be read.
    """

    fence: Annotated[
        Literal["off", "start", "ship"],
        choice(
            "centre of the geofence: the place where the vehicle began to fly, by its positions or else by its velocity, less "
            "what that may be off; "
            "or the pad, while its position is known to 5 m",
            public=True,
        ),
    ] = "off"
    fence_radius_m: Annotated[
        float, number("radius of the geofence, unless there is a polygon", "m", 2.0, 10_000.0, public=True)
    ] = 50.0
    fence_polygon: Annotated[
        str,
        text(
            "corners of the geofence instead of a circle, metres, as `x y, x y, x y`: north and east of the start, or on a ship "
            "along the arrow and to its right",
            2000,
            shortest=0,
            public=True,
        ),
    ] = ""
    fence_brake_s: Annotated[
        float, number("the velocity towards the fence is at most the distance to it divided by this time", "s", 0.5, 20.0)
    ] = 2.0
    fence_ends_s: Annotated[
        float, number("time for which the fence may hold guidance back before it ends the landing and holds", "s", 0.5, 60.0)
    ] = 3.0
    height_max_m: Annotated[
        float, number("height above the start to which commands climb at most", "m", 2.0, 500.0, public=True)
    ] = 50.0
    manual_height_min_m: Annotated[
        float, number("height above what is below, under which manual flight does not descend", "m", 0.0, 10.0)
    ] = 0.5
    take_off_charge_min: Annotated[
        float, number("charge of the battery below which a take-off is refused", "1", 0.0, 1.0, public=True)
    ] = 0.2
    return_charge: Annotated[
        float,
        number(
            "charge below which manual flight goes no farther from the pad, or the start without one", "1", 0.0, 1.0, public=True
        ),
    ] = 0.15

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fence_polygon and len(self.corners()) < 3:
            raise ValueError(f"fence_polygon needs three corners or more, got {self.fence_polygon!r}")

    def corners(self) -> tuple[tuple[float, float], ...]:
        """Return the corners of the polygon, metres; empty for a circle.

        Raises:
            ValueError: the text is not a list of corners.
        """
        found = []
        for part in self.fence_polygon.split(",") if self.fence_polygon.strip() else ():
            words = part.split()
            try:
                x, y = (float(word) for word in words)
            except ValueError:
                raise ValueError(f"fence_polygon: {part.strip()!r} is not a corner such as 30 -12.5") from None
            if not (abs(x) <= 1e5 and abs(y) <= 1e5):
                raise ValueError(f"fence_polygon: the corner {part.strip()!r} is too far away")
            found.append((x, y))
        return tuple(found)
