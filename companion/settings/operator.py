"""The options of people's commands: who may give them, and how fast manual flight is."""

import math
from typing import Annotated

from msgspec import Struct

from estimator.contracts.keys import check_ranges, number, text


class ManualOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """Manual flight: the velocities that full sticks command.

    Raises:
        ValueError: a number outside its range.
    """

    speed_max_m_s: Annotated[float, number("horizontal velocity at full stick", "m/s", 0.05, 10.0)] = 1.0
    climb_max_m_s: Annotated[float, number("climb and descent rate at full stick", "m/s", 0.05, 3.0)] = 0.5
    turn_max_deg_s: Annotated[float, number("turn rate at full stick", "deg/s", 5.0, 200.0)] = 45.0
    silence_s: Annotated[
        float, number("silence of the sender that has the hand after which the vehicle holds", "s", 0.1, 0.5)
    ] = 0.5

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def turn_max_rad_s(self) -> float:
        """The turn rate at full stick, rad/s."""
        return math.radians(self.turn_max_deg_s)


class OperatorOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """The commands of people on this computer: the terminal (`decklander fly`) and the gamepad.

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
    gamepad: Annotated[
        str,
        text(
            'mapping of the gamepad: the name of a shipped file, or a path from the working directory; "off" for no gamepad',
            4096,
            public=True,
        ),
    ] = "off"
    gamepad_device: Annotated[
        str, text('a part of the gamepad\'s name, or its path; "any" for the first one that is found', 256, public=True)
    ] = "any"
    manual: ManualOptions = ManualOptions()

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.socket not in ("auto", "off") and not self.socket.startswith("/"):
            raise ValueError(f'socket must be "auto", "off" or an absolute path, got {self.socket!r}')
